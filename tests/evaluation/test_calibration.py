"""Right values pass, wrong ones are found out: in the toy world, whose values are known exactly."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from omegaconf import DictConfig
from tensordict import TensorDictBase

from tests.toy import EDGE, PATCHES, SIZE
from xqmap import keys
from xqmap.config import build
from xqmap.evaluation import calibration
from xqmap.models.qmaps import write_chosen

GAMMA = 0.9


class Knowing:
    """A policy that draws the exact Q-Maps of the toy world, changed by ``change``."""

    def __init__(self, env: Any, change: Callable[[np.ndarray], np.ndarray] = lambda values: values) -> None:
        self.env, self.change = env, change

    def __call__(self, state: TensorDictBase) -> TensorDictBase:
        maps = torch.full((2, SIZE, SIZE), -5.0)
        exact = self.env.task.exact_values(GAMMA)
        for i, values in zip(sorted(self.env.task.present), self.change(exact), strict=True):
            row, column = PATCHES[i][3]
            maps[:, row : row + EDGE, column : column + EDGE] = torch.tensor(values)[:, None, None]
        state[keys.COMPONENT_ACTION_VALUE] = maps.reshape(2, -1)
        state[keys.ACTION_VALUE] = maps.sum(0).reshape(-1)
        state[keys.ACTION] = state[keys.ACTION_VALUE].argmax()
        return write_chosen(state)


@pytest.fixture
def env(toy_config: Callable[..., DictConfig]) -> Any:
    return build.make_env(toy_config(), 0)()


def calibrate(policy: Any, env: Any) -> dict[str, Any]:
    return calibration.calibrate(policy, env, [0, 1], GAMMA, [1.0, 1.0], keys.REWARD_COMPONENTS)


def test_exact_values_are_found_right(env: Any) -> None:
    found = calibrate(Knowing(env), env)
    for name in ("left", "right"):
        exact, returned = found["exact"][name], found["returns"][name]
        assert (exact["bias"], exact["mae"], returned["mae"]) == pytest.approx((0, 0, 0), abs=1e-6)
        assert exact["sign_accuracy"] == 1.0
        assert exact["rank_correlation"] == pytest.approx(1.0)
        # Two episodes: three patches, then two; every pair differs in both components.
        assert (exact["count"], exact["pairs"], returned["count"]) == (10, 8, 4)


def test_a_state_in_which_no_object_can_be_reached_asks_about_none(env: Any) -> None:
    env.task.reachable = lambda points: np.arange(len(points)) == 0
    found = calibrate(Knowing(env), env)
    assert found["exact"] is None
    assert found["returns"]["left"]["count"] == 4


def test_values_that_promise_too_much_are_found_out(env: Any) -> None:
    found = calibrate(Knowing(env, lambda values: values + 0.25), env)
    assert found["exact"]["left"]["bias"] == pytest.approx(0.25, abs=1e-6)
    assert found["returns"]["right"]["bias"] == pytest.approx(0.25, abs=1e-6)
    assert found["exact"]["left"]["sign_accuracy"] == 1.0


def test_bars_with_their_names_swapped_are_found_out(env: Any) -> None:
    found = calibrate(Knowing(env, lambda values: values[:, ::-1].copy()), env)
    assert found["exact"]["left"]["sign_accuracy"] < 0.8
    assert found["exact"]["left"]["mae"] > 0.2


def test_a_policy_of_the_sum_is_held_against_the_sum(env: Any) -> None:
    class Summed(Knowing):
        def __call__(self, state: TensorDictBase) -> TensorDictBase:
            state = super().__call__(state)
            state[keys.COMPONENT_ACTION_VALUE] = state[keys.ACTION_VALUE][None]
            return write_chosen(state)

    found = calibration.calibrate(Summed(env), env, [0], GAMMA, [1.0, 1.0], keys.REWARD)
    assert list(found["exact"]) == ["reward"]
    assert found["exact"]["reward"]["mae"] == pytest.approx(0, abs=1e-6)
    assert "reward, exact value" in calibration.table(found)


def test_a_world_without_exact_values_says_so(env: Any) -> None:
    class Unsolved:
        def __init__(self, task: Any) -> None:
            self.task = task

        def __getattr__(self, name: str) -> Any:
            if name == "exact_values":
                raise AttributeError(name)
            return getattr(self.task, name)

    policy = Knowing(type("Known", (), {"task": env.task}))
    env.task = Unsolved(env.task)
    found = calibrate(policy, env)
    assert found["exact"] is None
    assert found["returns"]["left"]["mae"] == pytest.approx(0, abs=1e-6)
    assert "no exact values" in calibration.table(found)
