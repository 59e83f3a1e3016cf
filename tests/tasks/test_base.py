"""What every world has from its base: here one without a robot, as small as one can be."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import sapien
import torch
from mani_skill.sensors.camera import CameraConfig

from tasks.base import DecisionEnv, SceneObject
from xqmap.envs.maniskill import ManiSkillEnv
from xqmap.envs.protocol import Task

pytestmark = pytest.mark.sim

EDGE, RADIUS = 0.4, 0.05


class Drop(DecisionEnv):
    """A ball falls where one points; there is a box, and nobody else."""

    REWARD_COMPONENTS = ("hit",)
    METRICS = ("height_m",)
    pixel_size = 0.25
    workspace_bounds = np.array([[-1.0, 1.0], [-1.0, 1.0], [-0.01, 1.0]])

    @property
    def _default_sensor_configs(self) -> list[CameraConfig]:
        down = sapien.Pose([0, 0, 4], [0.5, -0.5, 0.5, 0.5])
        return [CameraConfig("above", down, 64, 64, 0.6, 0.1, 10.0, shader_pack="minimal")]

    def _load_scene(self, options: dict[str, Any]) -> None:
        ball = self.scene.create_actor_builder()
        ball.add_sphere_collision(radius=RADIUS)
        ball.add_sphere_visual(radius=RADIUS)
        ball.initial_pose = sapien.Pose([0, 0, 3.5])
        self.ball = ball.build("ball")
        for name, middle, half in (("floor", (0, 0, -0.1), (5, 5, 0.1)), ("box", (0.5, 0.5, EDGE / 2), 3 * [EDGE / 2])):
            builder = self.scene.create_actor_builder()
            builder.add_box_collision(sapien.Pose(middle), half)
            builder.add_box_visual(sapien.Pose(middle), half)
            builder.initial_pose = sapien.Pose()
            builder.build_static(name)

    def run_primitive(self, point: np.ndarray) -> tuple[dict[str, float], dict[str, float]]:
        self.ball.set_pose(sapien.Pose([*point[:2], point[2] + 0.3]))
        self.ball.set_linear_velocity(torch.zeros(1, 3))
        for _ in range(self.control_freq):
            self.control_step()
        height = float(self.ball.pose.p[0, 2])
        return {"hit": float(height > EDGE / 2)}, {"height_m": height}

    def highest_reward(self) -> float:
        return float(self.weights.max())

    def scene_objects(self) -> list[SceneObject]:
        corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * EDGE / 2 + 0.5
        return [SceneObject("box", corners, EDGE)]

    def oracle_point(self) -> np.ndarray:
        return np.array([0.5, 0.5, EDGE])


@pytest.fixture(scope="module")
def world() -> Iterator[Drop]:
    env = Drop()
    yield env
    env.close()


def test_a_world_needs_no_robot(world: Drop) -> None:
    assert isinstance(world, Task)
    env = ManiSkillEnv(lambda: world)
    for point, hit in ((world.oracle_point(), 1.0), (np.array([-0.5, -0.5, 0.0]), 0.0)):
        state = env.reset()
        cell = env.action_at(point)
        assert state["action_mask"][cell]
        state["action"] = torch.tensor(cell)
        result = env.step(state)["next"]
        assert result["reward_components"].tolist() == [hit]
        assert float(result["height_m"]) == pytest.approx(RADIUS + hit * EDGE, abs=0.01)
        assert float(result["reward_available"]) == 1.0 and bool(result["done"])


def test_its_state_can_be_kept_and_brought_back(world: Drop) -> None:
    world.reset(seed=0)
    before = {name: value.clone() for name, value in world.get_state_dict()["actors"].items()}
    world.step(np.array([-0.5, -0.5, 0.0]))
    assert not torch.allclose(world.get_state_dict()["actors"]["ball"], before["ball"])
    world.set_state_dict({"actors": before})
    assert torch.allclose(world.get_state_dict()["actors"]["ball"], before["ball"])


@pytest.mark.parametrize("point", [[0.0, np.nan, 0.0], [np.inf, 0.0, 0.0]])
def test_a_point_that_is_none_is_refused(world: Drop, point: list[float]) -> None:
    world.reset(seed=0)
    with pytest.raises(ValueError, match="three finite numbers"):
        world.step(np.array(point))
