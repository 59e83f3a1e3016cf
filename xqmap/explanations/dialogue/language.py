"""A person's language: the words that stand for the concepts a question is made of (``conf/explain/language``)."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

from rapidfuzz import process
from rapidfuzz.distance import OSA

from xqmap.config import plain, plugins

_TOKEN = re.compile(r"[^\W\d_]+(?:['’-][^\W\d_]+)*|[+-]?\d+(?:[.,]\d+)?%?|[?!.;](?=\s|$)|[^\s.!;]")
# A misspelled word has at least so many letters for one slip, and for a second.
_ONE_SLIP, _TWO_SLIPS = 4, 8
_FOLDED = str.maketrans({"ä": "a", "ö": "o", "ü": "u", "ß": "s", "é": "e"})
# What intents.yaml holds beside the languages.
INTENTS = "intents"
# What the names of things, and the wording of a task without more ado, are in.
ENGLISH = "en"


@dataclass(frozen=True)
class Token:
    """A word, number or sign as it was typed, and in small letters."""

    text: str
    word: str

    @property
    def is_word(self) -> bool:
        """Whether it is neither number nor sign."""
        return self.word[0].isalpha()

    @property
    def number(self) -> float | None:
        """What it counts, if it is a number."""
        bare = self.word.rstrip("%").replace(",", ".")
        return float(bare) if re.fullmatch(r"[+-]?\d+(\.\d+)?", bare) else None


@dataclass(frozen=True)
class Span:
    """Where in a question a concept was found: tokens ``start`` to ``end`` (exclusive)."""

    concept: str
    start: int
    end: int


class Language:
    """The words of one language.

    Args:
        content: of its file.
    """

    def __init__(self, content: Mapping[str, Any]) -> None:
        self.content = content
        self._spelled = [(re.compile(pattern, re.IGNORECASE), by) for pattern, by in content["spelled"]]
        self.fillers = frozenset(content["fillers"].split())
        self.endings = sorted(content["endings"], key=len, reverse=True)
        lists = {name: words for name, words in content.items() if name not in _NO_CONCEPTS and name != "concepts"}
        self._asked = {name: _phrases(words) for name, words in content["concepts"].items()}
        self._lists = self._asked | {name: _phrases(words) for name, words in lists.items()}
        self._factors = {float(value): _phrases(words) for value, words in content["factors"].items()}

    def tokens(self, text: str) -> list[Token]:
        """The words, numbers and signs of a text, short forms written out."""
        text = text.replace("’", "'")
        for pattern, by in self._spelled:
            text = pattern.sub(by, text)
        return [Token(found, found.lower()) for found in _TOKEN.findall(text)]

    def mended(self, tokens: Sequence[Token], names: Iterable[str]) -> list[Token]:
        """The tokens with those words corrected that nothing knows and that are a slip away from a known one.

        Args:
            tokens: of a question.
            names: words that are known beside the language's own.
        """
        own = {word.lower() for word in names}
        # "Pilot" is no "plot": short words of the language are too much like others.
        known = sorted(word for word in own | self._single if len(word) >= _ONE_SLIP + (word not in own))

        def mend(token: Token) -> Token:
            if not token.is_word or len(token.word) < _ONE_SLIP or self.knows(token.word) or self.stem(token.word, own):
                return token
            slips = 2 if len(token.word) >= _TWO_SLIPS else 1
            alike = [word for word in known if word[0] == token.word[0]]
            found = process.extractOne(token.word, alike, scorer=OSA.distance, score_cutoff=slips)
            return Token(found[0], found[0]) if found else token

        return [mend(token) for token in tokens]

    def knows(self, word: str) -> bool:
        """Whether a word belongs to the language's lists."""
        return word in self.fillers or word in self._within or any(word.startswith(stem) for stem in self._stems)

    def concepts(self, tokens: Sequence[Token]) -> list[Span]:
        """All concepts in a question; of several words that stand for one, the parts stand for nothing else."""
        found = [
            Span(name, start, end) for name, phrases in self._lists.items() for start, end in _found(phrases, tokens)
        ]
        return [
            span
            for span in found
            if not any(
                other.start <= span.start
                and span.end <= other.end
                and other.end - other.start > span.end - span.start
                and (other.concept in self._asked) == (span.concept in self._asked)
                for other in found
            )
        ]

    @property
    def asked(self) -> frozenset[str]:
        """The concepts that intents are made of."""
        return frozenset(self._asked)

    def factors(self, tokens: Sequence[Token]) -> list[tuple[float, int]]:
        """How many times as much something counts by the words for it, and where; in the order of the file."""
        return [
            (value, start) for value, phrases in self._factors.items() for start, _ in sorted(_found(phrases, tokens))
        ]

    def stem(self, word: str, names: Iterable[str]) -> str | None:
        """Which of the names a word is, whatever its ending; None if it is none of them."""
        forms = set(self.stems(word))
        return next((name for name in sorted(names, key=len, reverse=True) if forms & set(self.stems(name))), None)

    def stems(self, word: str) -> list[str]:
        """A word without endings that it may have, and as it is."""
        folded = word.lower().translate(_FOLDED)
        cut = [folded[: -len(end)] for end in self.endings if folded.endswith(end) and len(folded) - len(end) >= 3]
        # "Flatness" is no plural.
        return [folded, *(stem for stem in cut if not stem.endswith("s"))]

    @cached_property
    def _within(self) -> frozenset[str]:
        """Every word that a phrase holds."""
        every = [phrase for phrases in (*self._lists.values(), *self._factors.values()) for phrase in phrases]
        return frozenset(word for phrase in every for word in phrase if not word.endswith("*"))

    @cached_property
    def _single(self) -> frozenset[str]:
        """Words that a slip may be mended to: those that stand for a concept alone."""
        return frozenset(
            phrase[0].rstrip("*") for phrases in self._asked.values() for phrase in phrases if len(phrase) == 1
        )

    @cached_property
    def _stems(self) -> tuple[str, ...]:
        every = [phrase for phrases in (*self._lists.values(), *self._factors.values()) for phrase in phrases]
        return tuple({word[:-1] for phrase in every for word in phrase if word.endswith("*")})


# Entries of a language's file that are no lists of words.
_NO_CONCEPTS = frozenset(
    "spelled endings fillers factors ordinals numbers clauses examples asks goes_on properties "
    "unlettered of_look of_other generic_plural degrees".split()
)


def _phrases(words: Iterable[Any]) -> list[list[str]]:
    return [str(phrase).lower().replace("’", "'").split() for phrase in words]


def _found(phrases: Iterable[Sequence[str]], tokens: Sequence[Token]) -> Iterator[tuple[int, int]]:
    for phrase in phrases:
        for start in range(len(tokens) - len(phrase) + 1):
            if all(_fits(word, token.word) for word, token in zip(phrase, tokens[start:], strict=False)):
                yield start, start + len(phrase)


def _fits(word: str, typed: str) -> bool:
    return typed.startswith(word[:-1]) if word.endswith("*") else typed == word


@cache
def language(name: str) -> Language:
    """A language by the name of its file."""
    return Language(_read(name))


@cache
def languages() -> list[str]:
    """The languages that there are."""
    return [name for name in plugins.stems("explain", "language") if name != INTENTS]


@cache
def determiners() -> frozenset[str]:
    """Words of all languages that may stand before a description."""
    lists = ("definite", "indefinite", "of_all", "other", "numbers")
    return frozenset(word for name in languages() for key in lists for word in language(name).content[key])


@cache
def intents() -> Mapping[str, Any]:
    """The intents and what their lines ask for."""
    return _read(INTENTS)


def _read(name: str) -> Any:
    found = plugins.find("explain", "language", f"{name}.yaml")
    assert found is not None, name
    return plain.read(found, texts=True)
