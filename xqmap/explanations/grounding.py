"""Is every number, component and object that an answer names really in the decision?"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterable

from xqmap.explanations import contrast
from xqmap.explanations.decision import Decision
from xqmap.explanations.sentences import number

_NUMBER = re.compile(r"(?<![\w.])[+−-]?\d+(?:[.,]\d+)?%?")
_OBJECT = re.compile(r"\b((?:[a-z]+ )?[a-z]+ (?:cube|bowl|block|patch|object))s?\b", re.IGNORECASE)
# Words that stand before a thing without describing it.
_NOT_COLORS = frozenset(
    (
        "the",
        "a",
        "an",
        "this",
        "that",
        "another",
        "other",
        "same",
        "chosen",
        "selected",
        "any",
        "each",
        "every",
        "which",
        "my",
        "your",
        "no",
        "one",
        "of",
        "than",
        "to",
        "on",
        "or",
        "and",
        "with",
        "as",
        "by",
        "for",
        "is",
        "was",
    )
)


def numbers_of(decision: Decision) -> set[str]:
    """Every number a view may show, without its sign and as printed (two decimals)."""
    values: list[float] = []
    things = [(c.overall, c.values) for c in decision.candidates] + [(o.overall, o.values) for o in decision.objects]
    for overall, components in things:
        values += [overall, *components.values()]
    for (_, first), (_, second) in itertools.permutations(things, 2):
        delta = contrast.rdx(first, second)
        values += [*delta.values(), sum(delta.values()), *contrast.flip_points(delta).values(), contrast.flip_distance(delta)]
    values += [*decision.noise.values(), math.hypot(*decision.noise.values())]
    return {number(abs(value)) for value in values if math.isfinite(value)}


def ungrounded(answer: str, decision: Decision, question: str = "", extra: Iterable[float] = ()) -> list[str]:
    """What an answer says that is not in the decision.

    Args:
        answer: the text to check.
        decision: what it may speak of.
        question: its own numbers and things may be repeated.
        extra: further numbers that were computed for this answer (values under other weights).

    Returns:
        The numbers and the objects, as they stand in the answer, that were not found.
    """
    known = numbers_of(decision) | {number(abs(value)) for value in extra}
    asked = {_bare(found) for found in _NUMBER.findall(question)}
    found = []
    for text in _NUMBER.findall(answer):
        bare = _bare(text)
        # A bare small whole number counts things ("two components", "the 3 candidates").
        counts = re.fullmatch(r"\d", bare) is not None
        if not (counts or bare in asked or _known(bare, known)):
            found.append(text)
    names = {c.object.lower() for c in decision.candidates} | {o.object.lower() for o in decision.objects}
    for match in _OBJECT.finditer(answer):
        words = match.group(1).lower().split()
        while words and words[0] in _NOT_COLORS:
            words = words[1:]
        phrase = " ".join(words)
        if len(words) > 1 and not any(phrase in name for name in names) and phrase not in question.lower():
            found.append(match.group(1))
    return found


def _bare(text: str) -> str:
    return text.lstrip("+-−").rstrip("%").replace(",", ".")


def _known(bare: str, known: set[str]) -> bool:
    """Whether a number is a known one, possibly rounded further."""
    if bare in known:
        return True
    decimals = len(bare.partition(".")[2])
    return decimals < 2 and any(f"{float(value):.{decimals}f}" == bare for value in known)
