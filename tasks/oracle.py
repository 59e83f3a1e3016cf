"""The grasping task solved exactly: what every object is worth, by component, if the best choices follow.

With the objects known, the task is a small Markov decision process: which object next. A cube that is lifted is gone,
and what it stood on lies open; what becomes of an attempt that lifts nothing, ``failure`` says. Values follow by
backward induction over what is left (value iteration that needs one sweep). The limit of attempts is left out, as it is
for the agent.

Run as a module (``-m``), it prints how far the highest reward, and the best order that looks at one object at a time,
are from the optimum.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Literal, NamedTuple

import numpy as np

from .tabletop import COLORS, RANK

SHAPE, COLOR = 0, 1
# Values closer than this are equal: of equal choices the oracle takes the one that brings the end nearer, then the
# first.
EQUAL = 1e-9

# What follows an attempt that lifts nothing: the end of the episode; nothing, the object can be tried again; or the
# object, if it is a bowl, is taken away.
Failure = Literal["ends", "stays", "removed"]
Stacks = tuple[tuple[float, ...], ...]
Bowls = tuple[float, ...]


@dataclass(frozen=True)
class Item:
    """What an object pays: its color's rank always, and 1 for shape where it can be lifted, after which it is gone.

    Attributes:
        rank: of its color.
        liftable: whether it is lifted, once nothing stands on it.
        on: the place, among the items, of the one that it stands on.
    """

    rank: float
    liftable: bool
    on: int | None = None

    @property
    def reward(self) -> np.ndarray:
        """``[2]``: the sub-rewards shape and color."""
        return np.array([float(self.liftable), self.rank])


class Values(NamedTuple):
    """Of every object ``[objects, 2]``: what it pays now, and what follows; Q*_k = now_k + γ · later_k."""

    now: np.ndarray
    later: np.ndarray


class Solver:
    """What states are worth under the same rules.

    Args:
        weights: w_k of shape and color.
        gamma: discount per choice.
        failure: what follows an attempt that lifts nothing.

    Raises:
        ValueError: if γ is not in [0, 1], or 1 where a bowl pays for ever.
    """

    def __init__(self, weights: Sequence[float], gamma: float, failure: Failure) -> None:
        if not 0 <= gamma <= 1 or (gamma == 1 and failure == "stays"):
            most = "below 1 (a bowl pays its color for ever)" if failure == "stays" else "at most 1"
            raise ValueError(f"gamma must be at least 0 and {most}, not {gamma}")
        self.weights, self.gamma, self.failure = np.asarray(weights, dtype=float), gamma, failure
        self.state_value = cache(self._state_value)

    def values(self, items: Sequence[Item]) -> Values:
        """Q*_k of every object, in two parts. One that another stands on can be neither lifted nor touched: it is worth
        nothing, and nothing follows that would be better than before.
        """
        stacks, bowls = state_of(items)
        carrying = {item.on for item in items}
        now, later = np.zeros((len(items), 2)), np.zeros((len(items), 2))
        for i, item in enumerate(items):
            if i in carrying:
                continue
            now[i] = item.reward
            if self.gamma == 0:
                continue
            if item.liftable:
                later[i] = self.state_value(_lifted(stacks, _stack_of(items, i)), bowls)
            elif stacks and self.failure != "ends":
                later[i] = self.state_value(stacks, _without(bowls, item.rank) if self.failure == "removed" else bowls)
        return Values(now, later)

    def component_values(self, items: Sequence[Item]) -> np.ndarray:
        """``[objects, 2]``: Q*_k of every object, if the best choices follow."""
        now, later = self.values(items)
        return now + self.gamma * later

    def worth(self, items: Sequence[Item]) -> np.ndarray:
        """``[objects]``: Σ_k w_k Q*_k."""
        return self.component_values(items) @ self.weights

    def _state_value(self, stacks: Stacks, bowls: Bowls) -> np.ndarray:
        """V*_k ``[2]`` of a state; one without a cube that can be lifted is an end."""
        if not stacks:
            return np.zeros(2)
        options = [
            np.array([1.0, stack[-1]]) + self.gamma * self.state_value(_lifted(stacks, stack), bowls)
            for stack in sorted(set(stacks))
        ]
        for rank in sorted(set(bowls)):
            paid = np.array([0.0, rank])
            if self.failure == "stays":
                paid = paid / (1 - self.gamma)
            elif self.failure == "removed":
                paid = paid + self.gamma * self.state_value(stacks, _without(bowls, rank))
            options.append(paid)
        return np.array(options[_first_best(np.array(options) @ self.weights)])


def state_of(items: Sequence[Item]) -> tuple[Stacks, Bowls]:
    """What can be lifted, as ranks from the bottom of each stack to its top, and the ranks of what cannot."""
    tops = set(range(len(items))) - {item.on for item in items}
    stacks = [_stack_of(items, i) for i in sorted(tops) if items[i].liftable]
    return tuple(sorted(stacks)), tuple(sorted(items[i].rank for i in tops if not items[i].liftable))


def _stack_of(items: Sequence[Item], top: int) -> tuple[float, ...]:
    ranks, place = [], top
    while place is not None and items[place].liftable:
        ranks.append(items[place].rank)
        below = items[place].on
        if below is None:
            break
        place = below
    return tuple(reversed(ranks))


def _lifted(stacks: Stacks, stack: tuple[float, ...]) -> Stacks:
    left = list(stacks)
    left.remove(stack)
    return tuple(sorted([*left, stack[:-1]] if len(stack) > 1 else left))


def _without(bowls: Bowls, rank: float) -> Bowls:
    left = list(bowls)
    left.remove(rank)
    return tuple(left)


def best_of(items: Sequence[Item], values: np.ndarray) -> int:
    """The place of the object of the highest value; of equal ones a liftable one, then the first."""
    order = sorted(range(len(items)), key=lambda i: not items[i].liftable)
    return order[_first_best(np.asarray(values)[order])]


def _first_best(values: np.ndarray) -> int:
    return int(np.flatnonzero(values >= values.max() - EQUAL)[0])


# -- how much a future is worth ----------------------------------------------------------------------------------------

Choose = Callable[[Sequence[Item]], int]
# What a bowl counts less than it pays, in the fixed orders that are tried.
_OFFSETS = (-9.0, -1.0, -0.6, -0.2, 0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 1.4, 2.0, 9.0)


def optimal(solver: Solver) -> Choose:
    """The best by Q*."""
    return lambda items: best_of(items, solver.worth(items))


def myopic(solver: Solver) -> Choose:
    """The highest reward now; of equal ones the one that is worth the most."""

    def choose(items: Sequence[Item]) -> int:
        reward, value = solver.values(items).now @ solver.weights, solver.worth(items)
        return int(np.where(reward >= reward.max() - EQUAL, value, -np.inf).argmax())

    return choose


def blind(solver: Solver, scenes: Sequence[Sequence[Item]]) -> Choose:
    """The best fixed order of kinds, over these scenes: the most that can be had by looking at one object at a time."""

    def ordered(offset: float) -> Choose:
        def choose(items: Sequence[Item]) -> int:
            carrying = {item.on for item in items}
            worth = [float(item.reward @ solver.weights) - (0 if item.liftable else offset) for item in items]
            return max(range(len(items)), key=lambda i: (i not in carrying, worth[i]))

        return choose

    return max(map(ordered, _OFFSETS), key=lambda choose: played(scenes, solver, choose).got)


def sampled(scenes: int, objects: tuple[int, int], seed: int = 0) -> list[list[Item]]:
    """Objects of random scenes, as :func:`.layouts.sample_layout` draws kinds and colors."""
    rng = np.random.RandomState(seed)
    found = []
    for _ in range(scenes):
        count = rng.randint(objects[0], objects[1] + 1)
        items = [Item(RANK[str(rng.choice(list(COLORS)))], bool(rng.rand() < 0.5)) for _ in range(count)]
        if not any(item.liftable for item in items):
            items[0] = Item(items[0].rank, True)
        found.append(items)
    return found


class Played(NamedTuple):
    """Over scenes: the return that was got, the most that could be, the share of choices that are optimal and of those
    that had the highest reward, and the share of scenes that were cleared.
    """

    got: float
    optimum: float
    optimal: float
    highest: float
    cleared: float


def played(scenes: Sequence[Sequence[Item]], solver: Solver, choose: Choose, attempts: int = 30) -> Played:
    """Plays scenes to their end.

    Args:
        scenes: objects, of which none stands on another.
        solver: the rules.
        choose: the place of the object to try next.
        attempts: choices after which a scene is over.
    """
    got, optimum = 0.0, 0.0
    best = highest = choices = cleared = 0
    for scene in scenes:
        items, discount = list(scene), 1.0
        for attempt in range(attempts):
            reward, value = solver.values(items).now @ solver.weights, solver.worth(items)
            optimum += float(value.max()) if attempt == 0 else 0.0
            chosen = choose(items)
            item, choices = items[chosen], choices + 1
            best += int(value[chosen] >= value.max() - EQUAL)
            highest += int(reward[chosen] >= reward.max() - EQUAL)
            got, discount = got + discount * float(reward[chosen]), discount * solver.gamma
            if item.liftable or solver.failure == "removed":
                del items[chosen]
            cleared += (clear := not any(item.liftable for item in items))
            if clear or (solver.failure == "ends" and not item.liftable):
                break
    return Played(got, optimum, best / max(1, choices), highest / max(1, choices), cleared / max(1, len(scenes)))


def table(scenes: int = 200) -> Iterator[str]:
    """Lines: what looking no further costs, by rule, weights and discount."""
    yield f"{scenes} scenes of 7 to 10 objects; return over the optimum, and share of optimal choices"
    heads = "".join(f"{head:>18}" for head in ("optimum clears", "highest reward", "fixed order"))
    yield f"{'a failed attempt':<18}{'weights':<12}{'discount':>8}{heads}"
    drawn = sampled(scenes, (7, 10))
    rules: list[tuple[Failure, tuple[float, float], float]] = [
        ("stays", (1, 1), 0.0),
        ("stays", (1, 1), 0.5),
        ("stays", (1, 1), 0.9),
        ("ends", (1, 1), 0.9),
        ("ends", (1, 2), 0.9),
        ("removed", (1, 1), 0.9),
    ]
    for failure, weights, gamma in rules:
        solver = Solver(weights, gamma, failure)
        found = [played(drawn, solver, choose) for choose in (myopic(solver), blind(solver, drawn))]
        shown = "".join(f"{f'{row.got / row.optimum:.3f}, {row.optimal:.1%}':>18}" for row in found)
        cleared = played(drawn, solver, optimal(solver)).cleared
        yield f"{failure:<18}{f'{weights[0]:g}, {weights[1]:g}':<12}{gamma:>8}{cleared:>18.1%}{shown}"


if __name__ == "__main__":
    for line in table():
        print(line)
