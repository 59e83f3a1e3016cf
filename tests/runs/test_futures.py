"""What came of each candidate is what the world pays, played by hand."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from omegaconf import DictConfig, OmegaConf
from tensordict.nn import TensorDictModuleBase

from xqmap import keys
from xqmap.config import build
from xqmap.envs.episode import episode
from xqmap.models.policy import GreedyPolicy
from xqmap.runs import futures
from xqmap.runs.run import Run

GAMMA = 0.5
PERCEPTION = OmegaConf.create({"_target_": "xqmap.explanations.perception.Simulator"})


@pytest.fixture
def run(toy_config: Callable[..., DictConfig], tmp_path: Path) -> Run:
    torch.manual_seed(0)
    cfg = toy_config(f"loss.gamma={GAMMA}")
    cfg.task.weights = {"left": 1.0, "right": 3.0}
    cfg.method.weights = [1.0, 3.0]
    return Run(tmp_path, cfg, GreedyPolicy(build.qmaps(cfg, 0.1)).eval(), {}, "", 0)


def by_hand(run: Run, actions: list[int], policy: TensorDictModuleBase) -> list[torch.Tensor]:
    env = build.make_env(run.cfg, first_scene=5)()
    given = iter(actions)

    def choose(state: object) -> int:
        action = next(given, None)
        return int(policy(state.clone())[keys.ACTION]) if action is None else action  # type: ignore[attr-defined]

    paid = [result["next", keys.REWARD_COMPONENTS] for result in episode(env, choose)]
    env.close()
    return paid


def test_each_candidate_is_carried_out_and_gone_on_with(run: Run) -> None:
    decisions = run.episode(5, None, PERCEPTION)
    assert len(decisions) == 2
    # Somewhere that pays, whatever the untrained maps like.
    for decision, pixel in zip(decisions, ((3, 3), (11, 7)), strict=True):
        decision.candidates[1] = decision.at(pixel, "A")
    futures.play(run, decisions, times=2)
    env = build.make_env(run.cfg, first_scene=5)()
    first = env.cell(decisions[0])
    for i, before in enumerate(([], [first])):
        for candidate in decisions[i].candidates:
            assert candidate.pixel is not None
            action = candidate.pixel[0] * env.grid.shape[1] + candidate.pixel[1]
            paid = by_hand(run, [*before, action], run.policy)[i:]
            expected = sum((GAMMA**t * r * torch.tensor([1.0, 3.0]) for t, r in enumerate(paid)), torch.zeros(2))
            returns = decisions[i].played[candidate.label]
            assert len(returns) == 2
            assert list(returns[0].values()) == pytest.approx(expected.tolist())
    env.close()
    assert sum(decisions[0].played["A"][0].values()) >= 1.0
    assert decisions[1].played["A"][0] == pytest.approx({"left": 0.0, "right": 1.2})
