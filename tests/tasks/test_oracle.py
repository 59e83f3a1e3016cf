"""The exact solution of the grasping task against plain value iteration, and what it says about looking ahead."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from tasks import oracle
from tasks.oracle import Item, Solver, best_of

WEIGHTS = (1.0, 1.0)
RULES = ("ends", "stays", "removed")


def component_values(items: Sequence[Item], weights: Sequence[float], gamma: float, failure: Any) -> np.ndarray:
    return Solver(weights, gamma, failure).component_values(items)


def best(items: Sequence[Item], weights: Sequence[float], gamma: float, failure: Any) -> int:
    return best_of(items, Solver(weights, gamma, failure).worth(items))


def value_iteration(items: Sequence[Item], weights: Sequence[float], gamma: float, failure: str) -> np.ndarray:
    """Q* ``[objects]`` by sweeps over every subset of objects that may be left."""
    everything = frozenset(range(len(items)))
    states = [frozenset(left) for n in range(len(items) + 1) for left in itertools.combinations(everything, n)]
    value = dict.fromkeys(states, 0.0)

    def q(state: frozenset[int], i: int) -> float:
        if any(items[j].on == i for j in state):
            return 0.0
        following = 0.0
        if items[i].liftable or failure == "removed":
            following = value[state - {i}]
        elif failure == "stays":
            following = value[state]
        return float(items[i].reward @ weights) + gamma * following

    for _ in range(400):
        for state in states:
            if any(items[i].liftable for i in state):
                value[state] = max(q(state, i) for i in state)
    if not any(item.liftable for item in items):
        return np.array([float(item.reward @ weights) for item in items])
    return np.array([q(everything, i) for i in range(len(items))])


def drawn(rng: np.random.Generator, count: int, stacked: bool) -> list[Item]:
    items = [Item(float(rng.integers(6)) / 5, bool(rng.random() < 0.6)) for _ in range(count)]
    cubes = [i for i, item in enumerate(items) if item.liftable]
    while stacked and len(cubes) > 1:
        top, base = cubes.pop(), cubes.pop()
        items[top] = Item(items[top].rank, True, on=base)
    return items


@pytest.mark.parametrize("failure", RULES)
@pytest.mark.parametrize("stacked", [False, True])
@pytest.mark.parametrize(("weights", "gamma"), [((1.0, 1.0), 0.0), ((1.0, 2.0), 0.9), ((2.0, 0.5), 0.5)])
def test_values_are_those_of_value_iteration(
    failure: Any, stacked: bool, weights: tuple[float, float], gamma: float
) -> None:
    rng = np.random.default_rng(0)
    for _ in range(4):
        items = drawn(rng, 6, stacked)
        values = component_values(items, weights, gamma, failure) @ weights
        assert values == pytest.approx(value_iteration(items, weights, gamma, failure), abs=1e-6)


def test_components_of_a_small_scene_by_hand() -> None:
    # A purple cube, a red cube, a blue bowl: purple, then red, is best.
    items = [Item(1.0, True), Item(0.0, True), Item(0.8, False)]
    gamma = 0.1
    after = {"stays": [gamma * (1 + gamma), 0.8 + gamma * 1.0], "ends": [0.0, 0.8]}
    for failure, bowl in after.items():
        expected = [[1 + gamma, 1.0], [1 + gamma, gamma * 1.0], bowl]
        assert component_values(items, WEIGHTS, gamma, failure) == pytest.approx(np.array(expected))
        assert best(items, WEIGHTS, gamma, failure) == 0


def test_now_and_what_follows_are_the_value() -> None:
    items = [Item(1.0, True), Item(0.0, True), Item(0.8, False)]
    now, later = Solver(WEIGHTS, 0.5, "removed").values(items)
    assert now.tolist() == [[1.0, 1.0], [1.0, 0.0], [0.0, 0.8]]
    assert later[2] == pytest.approx([1.5, 1.0])
    assert now + 0.5 * later == pytest.approx(component_values(items, WEIGHTS, 0.5, "removed"))


def test_what_something_stands_on_waits() -> None:
    # Below the red cube lies a purple one: red first, then purple.
    items = [Item(1.0, True), Item(0.0, True, on=0)]
    assert component_values(items, WEIGHTS, 0.5, "ends").tolist() == [[0.0, 0.0], [1.5, 0.5]]


def test_of_equal_choices_the_one_that_ends_is_best() -> None:
    assert best([Item(1.0, False), Item(0.0, True)], WEIGHTS, 0.0, "stays") == 1


@pytest.mark.parametrize("failure", RULES)
def test_the_last_cube_ends_the_episode_and_without_one_nothing_follows(failure: Any) -> None:
    assert component_values([Item(0.6, True)], WEIGHTS, 0.5, failure).tolist() == [[1.0, 0.6]]
    assert component_values([Item(0.6, False)], WEIGHTS, 0.5, failure).tolist() == [[0.0, 0.6]]
    assert component_values([], WEIGHTS, 0.5, failure).shape == (0, 2)


def test_a_bowl_that_stays_pays_for_ever_and_others_do_not() -> None:
    with pytest.raises(ValueError, match="gamma"):
        component_values([Item(0.6, False)], WEIGHTS, 1.0, "stays")
    with pytest.raises(ValueError, match="gamma"):
        component_values([Item(0.6, False)], WEIGHTS, 1.1, "ends")
    assert component_values([Item(0.6, True), Item(0.2, True)], WEIGHTS, 1.0, "ends")[0] == pytest.approx([2.0, 0.8])


@pytest.mark.parametrize(
    ("failure", "weights", "gamma", "looking_at_now", "one_at_a_time"),
    [
        # The paper's table stands: with equal weights the best choice has the highest reward.
        ("ends", (1, 1), 0.9, (1.0, 1.0), (1.0, 1.0)),
        ("stays", (1, 1), 0.0, (1.0, 1.0), (1.0, 1.0)),
        # Where color counts twice, neither of them is enough; nor where a bowl that was tried is gone.
        ("ends", (1, 2), 0.9, (0.90, 0.87), (0.97, 0.87)),
        ("removed", (1, 1), 0.9, (0.86, 0.79), (0.95, 0.70)),
    ],
)
def test_what_looking_no_further_costs(
    failure: Any,
    weights: tuple[float, float],
    gamma: float,
    looking_at_now: tuple[float, float],
    one_at_a_time: tuple[float, float],
) -> None:
    solver, scenes = Solver(weights, gamma, failure), oracle.sampled(60, (7, 10), seed=1)
    most = oracle.played(scenes, solver, oracle.optimal(solver))
    assert (most.got / most.optimum, most.optimal) == pytest.approx((1.0, 1.0))
    for choose, expected in (
        (oracle.myopic(solver), looking_at_now),
        (oracle.blind(solver, scenes), one_at_a_time),
    ):
        found = oracle.played(scenes, solver, choose)
        assert found.got / found.optimum == pytest.approx(expected[0], abs=0.03)
        assert found.optimal == pytest.approx(expected[1], abs=0.08)
