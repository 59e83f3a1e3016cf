"""Is every number, component and object that an answer names really in the decision?"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterable
from functools import cache

from xqmap.config import plugins
from xqmap.explanations import contrast
from xqmap.explanations.decision import Decision
from xqmap.explanations.dialogue.language import determiners
from xqmap.explanations.views import sentences
from xqmap.explanations.views.words import number

_NUMBER = re.compile(r"(?<![\w.])[+−-]?\d+(?:[.,]\d+)?%?")
_LABEL = re.compile(r"\b(?:[Cc]andidate|[Pp]ixel|[Oo]ption)\s+([A-Z]{1,2})\b")
_NOUNS = ("patch", "object")
# Words that stand before a thing without describing it.
_NO_COLOR = re.compile(
    r"the|an?|this|that|these|those|another|other|same|chosen|selected|best|any|each|every|which|my|your|its|no|not"
    r"|one|two|only|both|of|than|to|on|or|and|with|as|by|for|is|was|i|see|like|three|four|five|six|seven|eight|nine|ten"
)


@cache
def _known(*lists: str) -> list[str]:
    """What an answer may make up: the words that these lists hold in the wordings of all tasks."""
    words = [sentences.wording_for(task) for task in plugins.stems("explain", "wording")]
    return sorted({str(name) for wording in words for names in lists for name in wording[names]})


def numbers_of(decision: Decision) -> set[str]:
    """Every number a view may show, without its sign and as printed (two decimals)."""
    values: list[float] = []
    things = [(c.overall, c.values) for c in (*decision.candidates, *decision.objects)]
    for overall, components in things:
        values += [overall, *components.values()]
    for (_, first), (_, second) in itertools.permutations(things, 2):
        delta = contrast.rdx(first, second)
        values += [
            *delta.values(),
            sum(delta.values()),
            *contrast.flip_points(delta).values(),
            contrast.flip_distance(delta),
        ]
    pool = [*decision.candidates, *decision.objects]
    for shares in ([c.now for c in pool if c.now is not None], [c.later for c in pool if c.later is not None]):
        deltas = [contrast.rdx(first, second) for first, second in itertools.combinations(shares, 2)]
        values += [value for part in (*shares, *deltas) for value in (*part.values(), sum(part.values()))]
    values += [*decision.noise.values(), decision.error, *(decision.robustness() or ())[:1]]
    return {number(abs(value)) for value in values if math.isfinite(value)}


def ungrounded(answer: str, decision: Decision, question: str = "", extra: Iterable[float] = ()) -> list[str]:
    """What an answer says that is not in the decision.

    Args:
        answer: the text to check.
        decision: what it may speak of.
        question: its own numbers and things may be repeated.
        extra: further numbers that were computed for this answer (values under other weights).

    Returns:
        The numbers, labels, objects and properties, as they stand in the answer, that were not found.
    """
    known = numbers_of(decision) | {number(abs(value)) for value in extra}
    asked = {_bare(found) for found in _NUMBER.findall(question)}
    found = []
    for text in _NUMBER.findall(answer):
        bare = _bare(text)
        # A bare small whole number counts things ("two components", "the 3 candidates").
        counts = re.fullmatch(r"\d", bare) is not None
        if not (counts or bare in asked or _is_one_of(bare, known)):
            found.append(text)
    labels = {candidate.label for candidate in decision.candidates}
    found += [
        match.group(0)
        for match in _LABEL.finditer(answer)
        if match.group(1) not in labels and match.group(0) not in question
    ]
    names = {candidate.object.lower().strip("»«") for candidate in (*decision.candidates, *decision.objects)}
    things = {*_NOUNS, *_known("other_things"), *(name.split()[-1] for name in names)}
    nouns = "|".join(re.escape(noun) for noun in sorted(things))
    described_by = [set(name.split()) for name in names]
    described = {word for name in described_by for word in name} | {*_known("other_looks")}
    for match in re.finditer(rf"\b((?:[a-z]+ ){{1,2}}(?:{nouns}))s?\b", answer, re.IGNORECASE):
        words = match.group(1).lower().split()
        # What stands before the last article, or describes nothing that is known here, belongs to the sentence.
        articles = [i for i, word in enumerate(words[:-1]) if _NO_COLOR.fullmatch(word) or word in determiners()]
        words = words[articles[-1] + 1 :] if articles else words
        words = words[1:] if len(words) == 3 and words[0] not in described else words
        if (
            len(words) > 1
            and not any(set(words) <= name for name in described_by)
            and " ".join(words) not in question.lower()
        ):
            found.append(" ".join(words))
    own = " ".join([*decision.components, *names, question]).lower()
    found += [
        word
        for word in _known("components", "other_properties")
        if word.lower() not in own and re.search(rf"\b{re.escape(word)}\b", answer, re.IGNORECASE)
    ]
    return found


def _bare(text: str) -> str:
    return text.lstrip("+-−").rstrip("%").replace(",", ".")


def _is_one_of(bare: str, known: set[str]) -> bool:
    """Whether a number is a known one, possibly rounded further."""
    if bare in known:
        return True
    decimals = len(bare.partition(".")[2])
    return decimals < 2 and any(f"{float(value):.{decimals}f}" == bare for value in known)
