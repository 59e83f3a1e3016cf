"""The grasping task solved exactly: what every object is worth, by component, if the best choices follow.

With the objects known, the task is a small Markov decision process: which object next. A cube that is lifted is gone; a
bowl pays its color and stays. So values follow by backward induction over the cubes that are left (value iteration that
needs one sweep), and a choice that changes nothing is worth its reward for ever, r / (1 − γ). The limit of attempts is
left out, as it is for the agent.

Run as a module (``-m``), it prints for which discounts the best choice is also the one with the highest reward.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np

from .tabletop import COLORS, RANK

SHAPE, COLOR = 0, 1
# Values closer than this are equal: of equal choices the oracle takes the one that brings the end nearer, then the
# first.
EQUAL = 1e-9


@dataclass(frozen=True)
class Item:
    """What an object pays: its color's rank always, and 1 for shape where it can be lifted, after which it is gone."""

    rank: float
    liftable: bool

    @property
    def reward(self) -> np.ndarray:
        """``[2]``: the sub-rewards shape and color."""
        return np.array([float(self.liftable), self.rank])


def component_values(items: Sequence[Item], weights: Sequence[float], gamma: float) -> np.ndarray:
    """Q*_k(s, o) ``[objects, 2]`` of every object: shape and color, if the best choices follow.

    Args:
        items: the objects that are there; a state without a liftable one is an end.
        weights: w_k of shape and color.
        gamma: discount per choice, below 1.

    Raises:
        ValueError: if γ is not in [0, 1): a bowl pays for ever.
    """
    if not 0 <= gamma < 1:
        raise ValueError(f"gamma must be at least 0 and below 1 (a bowl pays its color for ever), not {gamma}")
    weight = np.asarray(weights, dtype=float)
    ranks = sorted({item.rank for item in items if item.liftable})
    staying = [item for item in items if not item.liftable]

    def without(left: tuple[int, ...], rank: float) -> tuple[int, ...]:
        return tuple(count - (other == rank) for other, count in zip(ranks, left, strict=True))

    @cache
    def state_value(left: tuple[int, ...]) -> tuple[float, float]:
        """V*_k of the state with ``left`` liftable objects of each rank."""
        if not any(left):
            return 0.0, 0.0
        options = [
            Item(rank, True).reward + gamma * np.array(state_value(without(left, rank)))
            for rank, count in zip(ranks, left, strict=True)
            if count
        ]
        options += [item.reward / (1 - gamma) for item in staying]
        best = options[_first_best(np.array(options) @ weight)]
        return float(best[SHAPE]), float(best[COLOR])

    now = tuple(sum(item.liftable and item.rank == rank for item in items) for rank in ranks)
    values = [
        item.reward + gamma * np.array(state_value(without(now, item.rank) if item.liftable else now)) * any(now)
        for item in items
    ]
    return np.array(values).reshape(-1, 2)


def best(items: Sequence[Item], weights: Sequence[float], gamma: float) -> int:
    """The place of the best object in ``items``; of equal ones a liftable one, then the first."""
    values = component_values(items, weights, gamma) @ np.asarray(weights, dtype=float)
    order = sorted(range(len(items)), key=lambda i: not items[i].liftable)
    return order[_first_best(values[order])]


def _first_best(values: np.ndarray) -> int:
    return int(np.flatnonzero(values >= values.max() - EQUAL)[0])


class Agreement(NamedTuple):
    """Over the optimal policy's choices the share with the highest reward; over scenes the share that was cleared of
    liftable objects.
    """

    highest: float
    cleared: float


def agreement(gamma: float, scenes: int, objects: tuple[int, int], attempts: int, seed: int = 0) -> Agreement:
    """How far the policy that is optimal for γ also takes the highest reward at each choice, and how often it finishes.

    Args:
        gamma: discount per choice.
        scenes: how many random scenes are played to their end.
        objects: fewest and most objects.
        attempts: choices after which a scene is over.
        seed: of the scenes.
    """
    rng, highest, choices, cleared = np.random.RandomState(seed), 0, 0, 0
    for _ in range(scenes):
        items = [
            Item(RANK[str(rng.choice(list(COLORS)))], bool(rng.rand() < 0.5))
            for _ in range(rng.randint(objects[0], objects[1] + 1))
        ]
        if not any(item.liftable for item in items):
            items[0] = Item(items[0].rank, True)
        for _ in range(attempts):
            chosen = items[best(items, (1.0, 1.0), gamma)]
            choices += 1
            highest += chosen.reward.sum() >= max(item.reward.sum() for item in items) - EQUAL
            if chosen.liftable:
                items.remove(chosen)
            if not any(item.liftable for item in items):
                cleared += 1
                break
    return Agreement(highest / choices, cleared / scenes)


if __name__ == "__main__":
    print(
        "500 scenes of 7 to 10 objects, 30 attempts each\n    γ  optimal choice has the highest reward  scene cleared"
    )
    for gamma in (0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.5, 0.9):
        row = agreement(gamma, 500, (7, 10), 30)
        print(f"{gamma:>5}  {row.highest:>37.1%}  {row.cleared:>13.1%}")
