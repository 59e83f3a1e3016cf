"""Numbers that compare two actions by their component values: differences, minimal sufficient explanations, flip
points.

Everything here takes component values by name, in component order, and returns values by name. Definitions: RDX and MSX
after Juozapaitis et al. 2019; Q = Σ_k Q_k.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

Values = Mapping[str, float]


def rdx(first: Values, second: Values) -> dict[str, float]:
    """Reward difference explanation: Δ_k = Q_k(s, first) − Q_k(s, second). Its sum is the gap of the overall values."""
    return {name: first[name] - second[name] for name in first}


def msx(delta: Values) -> tuple[list[str], list[str]]:
    """Minimal sufficient explanations of a preference Σ_k Δ_k > 0.

    MSX⁺ is the smallest set of reasons for the preferred action that outweighs all reasons against it (the largest
    first, which is exact); MSX⁻ the smallest set of reasons against it that makes every member of MSX⁺ needed. Ties go
    by component order.

    Args:
        delta: RDX of the preferred action against the other, by component.

    Returns:
        ``(MSX⁺, MSX⁻)``, names by falling weight; both empty where no component speaks for the preferred action.
    """
    reasons = sorted((name for name in delta if delta[name] > 0), key=lambda name: -delta[name])
    objections = sorted((name for name in delta if delta[name] < 0), key=lambda name: delta[name])
    against = -sum(delta[name] for name in objections)
    plus = _smallest(reasons, delta, against, strict=True)
    if not plus or not objections:
        return plus, []
    needed = sum(delta[name] for name in plus) - min(delta[name] for name in plus)
    return plus, _smallest(objections, delta, needed, strict=False)


def _smallest(ordered: list[str], delta: Values, target: float, strict: bool) -> list[str]:
    total, taken = 0.0, []
    for name in ordered:
        if total > target or (not strict and total >= target):
            break
        taken.append(name)
        total += abs(delta[name])
    return taken


def flip_points(delta: Values) -> dict[str, float]:
    """The weight w_k at which the preference Σ_k Δ_k is just even, all other weights staying 1: w_k = 1 − S / Δ_k.

    Returns:
        By component; only those that a non-negative weight can reach.
    """
    total = sum(delta.values())
    weights = {name: 1 - total / value for name, value in delta.items() if value != 0 and math.isfinite(total / value)}
    return {name: weight for name, weight in weights.items() if weight >= 0}


def nearest_flip(delta: Values) -> tuple[str, float] | None:
    """The component whose weight has to change least to make the preference even, and that weight; None where none
    can.
    """
    points = flip_points(delta)
    return min(points.items(), key=lambda item: abs(item[1] - 1)) if points else None


def flip_distance(delta: Values) -> float:
    """The smallest joint change of all weights (Euclidean) that makes the preference even: S / ‖Δ‖. Infinite where Δ is
    0.
    """
    norm = math.hypot(*delta.values())
    return sum(delta.values()) / norm if norm > 0 else math.inf
