"""The exact solution of the grasping task against plain value iteration, and what it says about γ."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from tasks.oracle import Item, agreement, best, component_values

WEIGHTS = (1.0, 1.0)


def value_iteration(items: list[Item], weights: tuple[float, float], gamma: float) -> np.ndarray:
    """Q* ``[objects]`` of the state in which every object is there, by sweeps over all subsets of the liftable ones."""
    liftable = [i for i, item in enumerate(items) if item.liftable]
    states = [
        frozenset(i for i, there in zip(liftable, bits, strict=True) if there)
        for bits in product((0, 1), repeat=len(liftable))
    ]
    value = dict.fromkeys(states, 0.0)

    def q(state: frozenset[int], i: int) -> float:
        return float(items[i].reward @ weights) + gamma * value[state - {i} if items[i].liftable else state]

    for _ in range(400):
        for state in states:
            if state:
                value[state] = max(q(state, i) for i, item in enumerate(items) if i in state or not item.liftable)
    return np.array([q(frozenset(liftable), i) for i in range(len(items))])


@pytest.mark.parametrize("gamma", [0.0, 0.15, 0.5, 0.9])
@pytest.mark.parametrize("weights", [(1.0, 1.0), (2.0, 0.5)])
def test_values_are_those_of_value_iteration(gamma: float, weights: tuple[float, float]) -> None:
    rng = np.random.default_rng(0)
    for _ in range(5):
        items = [Item(float(rng.integers(6)) / 5, bool(rng.random() < 0.6)) for _ in range(6)] + [Item(0.4, True)]
        values = component_values(items, weights, gamma)
        assert values @ weights == pytest.approx(value_iteration(items, weights, gamma), abs=1e-6)


def test_components_of_a_small_scene_by_hand() -> None:
    # A purple cube, a red cube, a blue bowl: purple, then red, is best.
    items = [Item(1.0, True), Item(0.0, True), Item(0.8, False)]
    gamma = 0.1
    expected = [[1 + gamma, 1.0], [1 + gamma, gamma * 1.0], [gamma * (1 + gamma), 0.8 + gamma * 1.0]]
    assert component_values(items, WEIGHTS, gamma) == pytest.approx(np.array(expected))
    assert best(items, WEIGHTS, gamma) == 0


def test_of_equal_choices_the_one_that_ends_is_best() -> None:
    assert best([Item(1.0, False), Item(0.0, True)], WEIGHTS, 0.0) == 1


def test_the_last_cube_ends_the_episode_and_without_one_nothing_follows() -> None:
    assert component_values([Item(0.6, True)], WEIGHTS, 0.5).tolist() == [[1.0, 0.6]]
    assert component_values([Item(0.6, False)], WEIGHTS, 0.5).tolist() == [[0.0, 0.6]]
    assert component_values([], WEIGHTS, 0.5).shape == (0, 2)


def test_a_bowl_pays_for_ever_so_a_large_discount_breaks_the_metric() -> None:
    with pytest.raises(ValueError, match="gamma"):
        component_values([Item(0.6, False)], WEIGHTS, 1.0)
    assert agreement(0.0, 50, (7, 10), 30).highest == 1.0
    assert agreement(0.9, 50, (7, 10), 30).highest < 0.6
