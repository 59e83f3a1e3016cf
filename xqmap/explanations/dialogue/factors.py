"""Which components a text names, and how many times as much each counts in what it supposes."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from xqmap.explanations.decision import Decision

NUMBERS = ["zero", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten"]
_FACTORS = {
    r"n[o']t\b|n't\b|\b(do|does|did|is|was|were)nt\b|\bnothing\b|\bno longer\b"
    r"|\bignor|\bwithout\b|\bremove|\bdrop|\bzero\b|\boff\b|\birrelevant": 0.0,
    r"\bhalf\b|\bhalv": 0.5,
    r"\bthird\b": 1 / 3,
    r"\bquarter\b": 0.25,
    r"\btwice\b|\bdoubl": 2.0,
    r"\btripl|\bthrice\b": 3.0,
    r"\bless\b|\bleast\b|\blower\b": 0.5,
    r"\bmore\b|\bmost\b|\bhigher\b": 2.0,
    r"\bsame\b|\bequal|\bas now\b": 1.0,
}
_WEIGHED = r"\bcount|\bmatter|\bweigh|\bimport|\bcare|\brelevan|\bvalue"


def components_in(said: str, components: Any, words: Mapping[str, Any]) -> list[str]:
    """Those of the components that a plain text names, by their names or synonyms."""

    def calls(name: str) -> list[str]:
        return [name, str(words["components"].get(name, name)), *words["synonyms"].get(name, [])]

    return [
        str(name)
        for name in components
        if any(re.search(rf"\b{re.escape(call.lower())}\b", said) for call in calls(name))
    ]


def factors_in(said: str, decision: Decision, words: Mapping[str, Any]) -> dict[str, float]:
    """How many times as much each component counts in a supposition: one clause at a time, so that two can change."""
    factors: dict[str, float] = {}
    for clause in re.split(r",(?!\d)|\band\b|\bbut\b|\bwhile\b", said):
        name = next(iter(components_in(clause, decision.components, words)), None)
        if name is None:
            continue
        if re.search(r"\b(only|just|nothing but|alone)\b", clause):
            return {other: 0.0 for other in decision.components if other != name}
        factor = factor_in(clause)
        if factor is None and re.search(_WEIGHED, clause):
            continue
        if factor is not None:
            factors[name] = factor
    if (
        not factors
        and (names := components_in(said, decision.components, words))
        and (factor := factor_in(said)) is not None
    ):
        factors[names[0]] = factor
    return factors


def factor_in(said: str) -> float | None:
    """How many times as much something counts: "twice", "half", "20% less", "3 times", "not"; None if nothing does."""
    if share := re.search(r"(\d+(?:[.,]\d+)?)\s*(?:%|percent)\s*(more|less)?", said):
        amount = float(share.group(1).replace(",", ".")) / 100
        return {"more": 1 + amount, "less": max(0.0, 1 - amount)}.get(share.group(2), amount)
    number = re.search(r"(-?\d+(?:[.,]\d+)?)\s*(?:times|x\b|as much)", said)
    number = number or re.search(r"\b(?:weight|factor|count|weigh)\w*\b\D*?(-?\d+(?:[.,]\d+)?)", said)
    if number:
        return float(number.group(1).replace(",", "."))
    if word := re.search(rf"\b({'|'.join(NUMBERS)}) times\b", said):
        return float(NUMBERS.index(word.group(1)))
    return next((factor for pattern, factor in _FACTORS.items() if re.search(pattern, said)), None)
