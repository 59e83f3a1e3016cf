"""Who a text speaks of: labels ("B", "pixel B"), objects ("the red flat block"), parts of names ("the red one"), things
not there.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Mapping, Set
from dataclasses import dataclass
from typing import Any

from xqmap.explanations.candidate import SELECTED, Candidate
from xqmap.explanations.decision import Decision

# Words that describe no thing.
_PLAIN = frozenset(
    "other chosen selected best next first second same right left which one another any only least most worst highest "
    "lowest better".split()
)
_SUPERLATIVES = frozenset("least most best worst highest lowest".split())
_VERBS = r"vs|versus|or|and|is|was|has|instead|rather|better|over"
# What a thing is called that was chosen, and words after which something else is meant.
_CHOSEN = (
    r"\bselected\b|\byours\b|\byour (choice|pick|spot|target|object|<things>|one)\b|\bthe (chosen|picked) \w+"
    r"|\b(the|that) (\w+ ){0,2}(that |which )?you(('| ha)ve)? (chose|chosen|picked|took|selected|went for)\b"
)
_TURN = re.compile(
    r"(?<!could )(?<!can "
    r")\bnot\b|\b(instead|rather|than|over|versus|vs|compare|difference|against|wrong|other|another)\b"
    r"|\bwhy \w+n['’]?t\b"
)
# A misspelled word is at least this long, and this like the right one.
_SHORTEST, _LIKENESS = 4, 0.75


@dataclass(frozen=True)
class Vocabulary:
    """Words for the things of a decision, and for those that its task's wording knows besides.

    Attributes:
        nouns: what a thing is called, the last word of its name.
        looks: what describes a thing, the words before.
    """

    nouns: frozenset[str]
    looks: frozenset[str]

    @classmethod
    def of(cls, decision: Decision, words: Mapping[str, Any]) -> Vocabulary:
        """The words in the names of the decision's candidates and objects, and the wording's ``other_things`` and
        ``other_looks``.
        """
        names = [candidate.object.lower().split() for candidate in (*decision.candidates, *decision.objects)]
        return cls(
            frozenset((*(name[-1] for name in names), *words["other_things"])),
            frozenset((*(word for name in names for word in name[:-1]), *words["other_looks"])),
        )

    def within(self, pattern: str) -> str:
        """A pattern in which ``<things>`` stands for any of the nouns."""
        return pattern.replace("<things>", "|".join(re.escape(noun) for noun in sorted(self.nouns)))


def plain(text: str) -> str:
    """Lower case, without signs that carry no meaning in a question."""
    return " ".join(re.sub(r"[^\w\s.,%'-]", " ", text.lower().replace("’", "'")).split()).rstrip(" .,")


def respelled(text: str, vocabulary: Iterable[str]) -> str:
    """A plain text with its misspelled words replaced by what they are most like in a vocabulary."""
    words = sorted({word for known in vocabulary for word in known.lower().split()})

    def likely(match: re.Match[str]) -> str:
        word = match.group()
        alike = (
            []
            if len(word) < _SHORTEST or _singular(word) in words
            else difflib.get_close_matches(word, words, 1, _LIKENESS)
        )
        return alike[0] if alike else word

    return re.sub(r"[a-z]+", likely, plain(text))


def named(text: str, decision: Decision, vocabulary: Vocabulary) -> list[Candidate]:
    """The candidates and objects that a text names, in the decision's order.

    Where the chosen one and others answer to a name, the chosen one is meant, but after "not", "rather than" and their
    like another.
    """
    lowered = text.lower()
    turn = found.start() if (found := _TURN.search(lowered)) else len(lowered)
    chosen = vocabulary.within(_CHOSEN)
    labels = [candidate for candidate in decision.candidates if _says_label(text, candidate.label, chosen)]
    pool = [*decision.candidates, *decision.objects]
    # The longest names first, so that "red cube" is not looked for within "dark red cube".
    rest, matching = re.sub(chosen, lambda match: ";" * len(match.group()), lowered), []
    for name in sorted({candidate.object.lower() for candidate in pool}, key=len, reverse=True):
        for match in re.finditer(rf"(?<!\w){re.escape(name)}s?(?!\w)", rest):
            matching.append(_meant([c for c in pool if c.object.lower() == name], decision, match.start() < turn))
        rest = rest.replace(name, ";" * len(name))
    nouns = {candidate.object.lower().split()[-1] for candidate in pool} | {"one"}
    # Where things are called so, left and right are names.
    plain_words = _PLAIN - {word for c in pool for word in c.object.lower().split() if word in ("left", "right")}
    for start, words in _phrases(rest, nouns, plain_words) if missing(text, decision, vocabulary) is None else []:
        # "The red one", "the cube": the objects whose names hold most of these words.
        scores = [len(words & set(candidate.object.lower().split())) for candidate in pool]
        if best := [c for c, score in zip(pool, scores, strict=True) if score == max(scores) > 0]:
            matching.append(_meant(best, decision, start < turn))
    those = list(labels)
    for candidate in matching:
        if not any(candidate is known or _one(candidate, known) for known in those):
            those.append(candidate)
    return sorted(those, key=lambda candidate: next((i for i, c in enumerate(pool) if c is candidate), 0))


def missing(text: str, decision: Decision, vocabulary: Vocabulary) -> str | None:
    """A thing the text names that is not in the scene ("the green cube" where no cube is green); None where there is
    none.
    """
    names = [candidate.object.lower().split() for candidate in (*decision.candidates, *decision.objects)]
    nouns = vocabulary.nouns | {"one"}
    lowered = text.lower()
    letter = re.search(
        r"\b(?:not|than|candidate|pixel|option|versus|vs|or|and|of|about|with|is)\s+([B-HJ-Z])\b(?!['’])", text
    )
    if letter and letter.group(1) not in {candidate.label for candidate in decision.candidates}:
        return f"candidate {letter.group(1)}"
    own = decision.selected.object.lower()
    if re.search(rf"\b(?:an)?other {re.escape(own)}\b", lowered):
        apart = [
            c
            for c in (*decision.candidates, *decision.objects)
            if c.object.lower() == own and not _one(c, decision.selected)
        ]
        return None if apart else f"other {own}"
    if any(" ".join(name) in lowered for name in names):
        return None
    for match in re.finditer(
        rf"\b(?:the|a|an|that)\s+((?:[a-z]+\s+){{0,2}})({'|'.join(sorted(map(re.escape, nouns)))})\b", lowered
    ):
        described = [word for word in match.group(1).split() if word not in _PLAIN]
        thing = [*described, *([match.group(2)] if match.group(2) != "one" else [])]
        if thing and not any(set(thing) <= set(name) for name in names):
            return " ".join([*described, match.group(2)])
    if (
        (bare := re.search(r"\bnot ([a-z]+)\W*$", lowered))
        and bare.group(1) in vocabulary.looks
        and not any(bare.group(1) in name for name in names)
    ):
        return f"{bare.group(1)} thing"
    return None


def _phrases(text: str, nouns: set[str], plain_words: Set[str]) -> list[tuple[int, set[str]]]:
    """The words between a determiner and the noun it belongs to, or the sentence's end, and where: {red, block}, {red},
    {bowl}.
    """
    found = []
    # Looked at ahead, so that "of the" in "the values of the red block" begins another.
    for match in re.finditer(
        r"\b(?:the|that|an?|another|other|any|no|not|than|over|about|versus|or|and|with)\s+"
        r"(?=((?:[a-z]+[\s?.!,]*){1,4}))",
        text,
    ):
        words: set[str] = set()
        for word in re.findall(r"[a-z]+", match.group(1)):
            words.add(_singular(word))
            if _singular(word) in nouns:
                break
        else:
            # Without a noun it is a description only where nothing else follows: "why not red?"
            words = words if len(words) == 1 and match.end(1) >= len(text.rstrip()) else set()
        # "The worst bowl" is asked for, not named.
        if words - plain_words and not words & _SUPERLATIVES:
            found.append((match.start(), words - plain_words))
    return found


def _says_label(text: str, label: str, chosen: str) -> bool:
    if label == SELECTED:
        return re.search(chosen, text.lower()) is not None
    own, small = re.escape(label), re.escape(label.lower())
    if re.search(rf"\b(?:pixel|candidate|option|spot|point|label|action)\s+{small}(?!\w)", text.lower()):
        return True
    if label == "I":
        return False
    if re.search(rf"(?<![\w'’]){own}['’]s\b", text):
        return True
    # In small letters only where no article can stand: at the end, before a sign, or before "or", "instead", …
    if re.search(rf"(?<![\w'’])(?i:{small})(?=\s*(?:[?.,!)]|$|(?:{_VERBS})\b))", text):
        return True
    if text.isupper():
        return False
    # At the beginning of a sentence, "A" may be the article too.
    return re.search(rf"(?<![\w'’]){own}(?![\w'’])(?!\s+[a-z]+\s+[a-z]+)|(?<=\w\s){own}(?![\w'’])", text) is not None


def _meant(same: list[Candidate], decision: Decision, own: bool) -> Candidate:
    """Of things that answer to one name: the selected one if ``own``, or if it is the only one, else the best that was
    not chosen.
    """
    chosen = [c for c in same if c.label == SELECTED] if own else []
    apart = [c for c in same if c.label != SELECTED and not _one(c, decision.selected)]
    candidates = [c for c in apart if c in decision.candidates]
    return (chosen or candidates or sorted(apart, key=lambda c: -c.overall) or same)[0]


def _one(first: Candidate, second: Candidate) -> bool:
    """Whether two entries are the same thing, as a candidate and as an object."""
    return first.object == second.object and first.object_index == second.object_index


def _singular(word: str) -> str:
    return word[:-1] if word.endswith("s") and len(word) > 3 else word
