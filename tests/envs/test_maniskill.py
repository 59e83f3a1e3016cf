"""What a world shows, and when that is not enough to go on with."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from omegaconf import DictConfig

from tests.toy import ToyTask
from xqmap import keys
from xqmap.config import build
from xqmap.envs.maniskill import ManiSkillEnv
from xqmap.errors import UserError, WorldError


@pytest.mark.parametrize(("blind_after", "goes_on"), [(1, False), (2, True)])
def test_nothing_to_see_matters_only_where_a_choice_is_to_be_made(blind_after: int, goes_on: bool) -> None:
    class Blind(ToyTask):
        def _observation(self):  # type: ignore[no-untyped-def]
            seen = super()._observation()
            if self.made >= blind_after:
                seen["sensor_data"]["above"]["depth"].zero_()
            return seen

    env = ManiSkillEnv(Blind)
    state = env.reset()
    state[keys.ACTION] = torch.tensor(0)
    if not goes_on:
        with pytest.raises(WorldError, match="heightmap is empty"):
            env.step(state)
        return
    following = env.step(state)["next"]
    following[keys.ACTION] = torch.tensor(0)
    last = env.step(following.exclude(keys.REWARD))["next"]
    assert bool(last[keys.DONE])
    assert not bool(last[keys.ACTION_MASK].any())


class Measuring(ToyTask):
    """Its camera gives whole numbers of ``unit`` (m), with a hole in the corner."""

    unit, kind = 0.001, torch.uint16

    def _observation(self):  # type: ignore[no-untyped-def]
        seen = super()._observation()
        depth = seen["sensor_data"]["above"]["depth"] / self.unit
        depth[0, 0, 0] = torch.iinfo(self.kind).max
        seen["sensor_data"]["above"]["depth"] = depth.to(self.kind)
        return seen


@pytest.mark.parametrize("kind", [torch.int16, torch.uint16, torch.int32])
def test_whole_numbers_are_millimetres_and_the_largest_is_a_hole(
    kind: torch.dtype, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Measuring, "kind", kind)
    whole, measured = (ManiSkillEnv(task).reset() for task in (ToyTask, Measuring))
    hole = (measured[keys.HEIGHTMAP] == 0).all(0)
    assert int(hole.sum()) == 1
    assert not bool(measured[keys.ACTION_MASK][hole.flatten()])
    assert torch.equal(measured[keys.HEIGHTMAP][:, ~hole], whole[keys.HEIGHTMAP][:, ~hole])


def test_an_empty_map_tells_how_depth_was_read(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Measuring, "unit", 0.01)
    with pytest.raises(WorldError, match=r"heightmap is empty.* read in mm, of others in m; above: torch.uint16\)"):
        ManiSkillEnv(Measuring).reset()


def test_weights_go_by_name_and_components_are_those_of_the_world(toy_config: Callable[..., DictConfig]) -> None:
    cfg = toy_config()
    cfg.task.weights = {"right": 2.0, "left": 1.0}
    assert list(cfg.method.weights) == [1.0, 2.0]
    build.make_env(cfg, first_scene=0)().close()
    cfg.task.weights = {"right": 2.0}
    assert list(cfg.method.weights) == [1.0, 2.0]
    for wrong in (["right", "left"], ["left"], ["left", "right", "up"], ["left", "flatness"]):
        cfg.task.components = wrong
        with pytest.raises(UserError, match=r"task.components=.*the world's REWARD_COMPONENTS are \['left', 'right'\]"):
            build.make_env(cfg, first_scene=0)()


@pytest.mark.parametrize(
    ("broken", "says"),
    [
        (lambda reward, parts: (reward, torch.cat((parts, parts[:, :1]), 1)), "3 numbers for the 2 components"),
        (lambda reward, parts: (reward, parts[:, :1]), "1 numbers for the 2 components"),
        (lambda reward, parts: (reward + 0.01, parts), "not the sum of the weighted components"),
        (lambda reward, parts: (reward, parts.flip(-1) + 0.5), "not the sum of the weighted components"),
    ],
)
def test_a_world_whose_rewards_do_not_add_up_is_told_at_the_step(broken: Callable[..., object], says: str) -> None:
    class Broken(ToyTask):
        def step(self, action):  # type: ignore[no-untyped-def]
            seen, reward, terminated, truncated, info = super().step(action)
            reward, parts = broken(reward, torch.as_tensor(info["reward_components"]))
            return seen, reward, terminated, truncated, info | {"reward_components": parts}

    env = ManiSkillEnv(Broken, weights={"left": 1.0, "right": 1.0})
    state = env.reset()
    state[keys.ACTION] = torch.tensor(0)
    with pytest.raises(WorldError, match=says):
        env.step(state)
