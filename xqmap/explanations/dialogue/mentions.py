"""Words that speak of things: those that name one without describing it (a letter, a cell, "it"), and what is needed to
read the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from xqmap.explanations.candidate import SELECTED, Candidate
from xqmap.explanations.dialogue.language import Language, Span, Token
from xqmap.explanations.dialogue.places import Places


@dataclass
class Mention:
    """Words that speak of a thing, or of several.

    Attributes:
        start: first token.
        end: token after the last.
        sort: ``one`` (a certain thing), ``some`` ("a cube"), ``many`` ("the cubes", "which block"), ``it``.
        things: what they fit; none where nothing does, several of ``one`` where it is not clear which.
        said: the description, as typed.
        words: what it says of a thing's name.
        letter: whether a letter named it.
        places: place words in it.
        unknown: whether it has words that nothing knows.
        head: the token after its articles.
        asked: tokens within that name a property: "the least flat block".
    """

    start: int
    end: int
    sort: str
    things: list[Candidate] = field(default_factory=list)
    said: str = ""
    words: list[str] = field(default_factory=list)
    letter: bool = False
    places: list[str] = field(default_factory=list)
    unknown: bool = False
    head: int = 0
    asked: list[int] = field(default_factory=list)


class Pointing:
    """Finds what names a thing without describing it.

    Args:
        tokens: of the question.
        spans: its concepts.
        places: the things there are.
        language: of the question.
        others: words for things and looks that the scene has none of.
        before: what the question before was about: "it".
        pool: the several things it spoke of: "them".
    """

    def __init__(
        self,
        tokens: Sequence[Token],
        spans: Sequence[Span],
        places: Places,
        language: Language,
        others: Any,
        before: Sequence[Candidate],
        pool: Sequence[Candidate] = (),
    ) -> None:
        self.tokens, self.places, self.language, self.before = tokens, places, language, list(before)
        self.pool = list(pool)
        self._at: list[dict[str, int]] = [{} for _ in tokens]
        for span in spans:
            self._at[span.start][span.concept] = max(span.end - span.start, self._at[span.start].get(span.concept, 0))
        names = [words_of(thing) for thing in places.things]
        self.nouns = {name[-1] for name in names} | {word.lower() for word in others["other_things"]}
        self.looks = {word for name in names for word in name[:-1]} | {word.lower() for word in others["other_looks"]}

    def _is(self, at: int, *concepts: str) -> bool:
        return at < len(self.tokens) and any(concept in self._at[at] for concept in concepts)

    def _past(self, at: int, *concepts: str) -> int:
        """The token after the longest of these concepts that begins here, or ``at``."""
        return at + max((self._at[at].get(c, 0) for c in concepts), default=0) if at < len(self.tokens) else at

    def _property(self, at: int) -> bool:
        return any(name.startswith("component:") for name in self._at[at])

    def _number(self, at: int) -> float | None:
        return self.tokens[at].number if at < len(self.tokens) else None

    def _ends(self, at: int) -> bool:
        return at >= len(self.tokens) or not (self.tokens[at].is_word or self.tokens[at].number is not None)

    def _stem(self, at: int, names: set[str]) -> str | None:
        if at >= len(self.tokens) or not self.tokens[at].is_word:
            return None
        return self.language.stem(self.tokens[at].word, names)

    def _strange(self, at: int) -> bool:
        token = self.tokens[at]
        return token.is_word and len(token.text) > 1 and not self._at[at] and not self.language.knows(token.word)

    def _is_plural(self, typed: str, noun: str) -> bool:
        if not noun:
            return typed in self.language.content["generic_plural"]
        return self.language.stems(typed)[0] != self.language.stems(noun)[0]

    def _cell(self, at: int) -> Mention | None:
        """A cell of the map: "row 3, column 5", "(3, 5)"."""
        decision, end = self.places.decision, at
        values: list[int] = []
        opened = self.tokens[at].word in "([" or self._is(at, "row")
        while opened and end < len(self.tokens) and len(values) < 2:
            number = self._number(end)
            if number is not None and number == int(number) and "%" not in self.tokens[end].word:
                values.append(int(number))
            elif self.tokens[end].word not in "([,:" and not self._is(end, "row", "column", "at"):
                break
            end += 1
        if len(values) < 2 or decision.maps is None:
            return None
        end += end < len(self.tokens) and self.tokens[end].word in ")]"
        said = " ".join(token.text for token in self.tokens[at:end])
        rows, columns = decision.maps.shape[1:]
        if not (0 <= values[0] < rows and 0 <= values[1] < columns):
            return Mention(at, end, "one", [], said, unknown=True)
        pixel = values[0], values[1]
        return Mention(at, end, "one", [decision.at(pixel, "")], said)

    def _own(self, at: int) -> Mention | None:
        end = self._past(at, "own")
        if end == at or self._stem(end, self.nouns | self.looks) or self._is(end, "generic"):
            # "The selected block": its head follows.
            return None
        return Mention(at, end, "one", [self.places.decision.selected], "", ["own"])

    def _letter(self, at: int) -> Mention | None:
        token = self.tokens[at]
        if len(token.text) > 2 or not token.is_word or self._is(at, "value"):
            return None
        found = {c.label.lower(): c for c in self.places.decision.candidates}.get(token.word)
        alone = len([t for t in self.tokens if t.is_word]) == 1
        ends = self._ends(at + 1) or self._is(at + 1, "than", "or", "instead", "better", "worse", "is", "compare")
        if at and self._is(at - 1, "lettered"):
            fits = found is not None or token.text.isupper()
        elif token.text.islower():
            # Where no article can stand.
            fits = found is not None and ends and (at > 0 or alone) and token.word != "i"
        else:
            shouted = not alone and all(t.text.isupper() for t in self.tokens if t.is_word)
            # At the beginning, "A" may be the article.
            fits = token.text not in ("I", "") and not shouted and (ends or (at > 0 and len(token.text) == 1))
            fits = fits and (found is not None or (at > 0 and len(token.text) == 1))
        if not fits:
            return None
        said = "" if found else str(self.language.content["unlettered"]).format(letter=token.text)
        return Mention(at, at + 1, "one", [found] if found else [], said, letter=True, unknown=found is None)

    def _pronoun(self, at: int) -> Mention | None:
        end = self._past(at, "it")
        if end == at or self._is(at, "exists"):
            return None
        if self._is(at, "them") and self.pool:
            return Mention(at, end, "many", self.pool)
        pointing = self._is(at, "definite")
        if pointing and not (self._ends(end) or self._is(end, "is", "than", "better", "mean", "or")):
            return None
        return Mention(at, end, "it", self.before or [self.places.decision.selected])


def words_of(thing: Candidate) -> list[str]:
    """The words of a thing's name."""
    return thing.object.lower().strip("»«").split()


def is_own(thing: Candidate) -> bool:
    """Whether a thing is the chosen one."""
    return thing.label == SELECTED


def separately(mention: Mention) -> list[Mention]:
    """Two things that are named together, each by itself."""
    if mention.sort != "many" or len(mention.things) != 2:
        return [mention]
    return [replace(mention, sort="one", things=[thing]) for thing in mention.things]
