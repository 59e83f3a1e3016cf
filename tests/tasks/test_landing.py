from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import torch

from tasks.blocks import Block
from tasks.flight import Touch
from tasks.landing import LandingEnv
from tasks.overview import cell_middles
from tests.settings import world_settings
from xqmap.envs.maniskill import ManiSkillEnv
from xqmap.envs.protocol import Task

pytestmark = pytest.mark.sim


@pytest.fixture(scope="module")
def world() -> Iterator[LandingEnv]:
    env = LandingEnv(**world_settings("landing"))
    yield env
    env.close()


@pytest.fixture(scope="module")
def mapped(world: LandingEnv) -> ManiSkillEnv:
    return ManiSkillEnv(lambda: world)


def block(world: LandingEnv, **values: Any) -> Block:
    """A block near the middle of the view of seed 0."""
    world.reset(seed=0)
    x, y = world._location
    return Block(
        **{"x": x + 3, "y": y - 4, "yaw": 25, "length": 2.5, "width": 2.2, "height": 1.4, "incline": 0, "color": "red"}
        | values
    )


def put(world: LandingEnv, *blocks: Block) -> dict[str, Any]:
    return world.reset(seed=0, options={"blocks": [one.to_dict() for one in blocks]})[0]


def land(world: LandingEnv, x: float, y: float, z: float) -> tuple[list[float], dict[str, float]]:
    _, reward, _, _, info = world.step(np.array([x, y, z]))
    components = info["reward_components"][0]
    assert float(reward) == float((components * world.weights).sum())
    return components.tolist(), {name: float(info[name]) for name in world.METRICS}


def test_offers_what_the_framework_asks_of_a_task(world: LandingEnv) -> None:
    assert isinstance(world, Task)


@pytest.mark.parametrize(
    ("incline", "color", "expected"),
    [
        (0.0, "green", [1, 1]),
        (0.0, "gray", [1, 0]),
        (20.0, "blue", [0, 1]),
        (35.0, "gray", [0, 0]),
        (4.9, "red", [1, 1]),
        (5.1, "red", [0, 1]),
    ],
)
def test_the_touched_top_pays(world: LandingEnv, incline: float, color: str, expected: list[float]) -> None:
    target = block(world, incline=incline, color=color)
    put(world, target)
    components, metrics = land(world, target.x, target.y, target.height)
    assert components == expected
    assert metrics["landing_offset_m"] < 0.15
    assert metrics["control_steps"] <= world.control_steps


def test_the_ground_is_flat_and_gray(world: LandingEnv) -> None:
    put(world)
    assert land(world, *world._location, 0.0)[0] == [1, 0]


def test_comes_to_rest_at_the_slope_s_angle_and_slides_off_a_steep_one(world: LandingEnv) -> None:
    gentle, steep = block(world, incline=12), block(world, incline=35)
    put(world, gentle)
    _, metrics = land(world, gentle.x, gentle.y, gentle.height)
    assert metrics["tilt_deg"] == pytest.approx(12, abs=0.5)
    assert metrics["slid"] == 0
    put(world, steep)
    assert land(world, steep.x, steep.y, steep.height)[1]["slid"] == 1


def test_a_hull_that_hits_a_wall_is_a_miss(world: LandingEnv) -> None:
    tall = block(world, height=3.0, yaw=0, length=2)
    put(world, tall)
    assert land(world, tall.x + 1 + 0.18, tall.y, 0.0)[0] == [0, 0]
    put(world, tall)
    assert land(world, tall.x + 1 + 0.5, tall.y, 0.0)[0] == [1, 0], "half a metre away there is room"


def test_a_touched_wall_is_not_flat(world: LandingEnv) -> None:
    target = block(world)
    put(world, target)
    spot = np.array([*target.footprint[0], target.height / 2])
    (built,) = world._entities
    assert world._outcome_of(Touch(spot, spot, True, built)) == {"flatness": 0.0, "color": 1.0}


def test_a_time_out_pays_nothing(world: LandingEnv, monkeypatch: pytest.MonkeyPatch) -> None:
    target = block(world)
    put(world, target)
    monkeypatch.setattr(world, "control_steps", 10)
    components, metrics = land(world, target.x, target.y, target.height)
    assert components == [0, 0]
    assert metrics["control_steps"] == 10


def test_the_oracle_always_gets_what_is_available(mapped: ManiSkillEnv) -> None:
    world, available = mapped.task, []
    for seed in range(25):
        mapped.next_scene = seed
        state = mapped.reset()
        cell = mapped.action_at(world.oracle_point())
        assert state["action_mask"][cell]
        state["action"] = torch.tensor(cell)
        result = mapped.step(state)["next"]
        assert float(result["reward"]) == float(result["reward_available"])
        available.append(float(result["reward_available"]))
    assert set(available) == {1.0, 2.0}, "views without a flat colored top occur"


def test_weights_decide_what_is_best(world: LandingEnv, monkeypatch: pytest.MonkeyPatch) -> None:
    inclined = block(world, incline=20)
    put(world, inclined)
    assert world.highest_reward() == 1
    monkeypatch.setattr(world, "weights", torch.tensor([0.25, 1.0]))
    assert world.highest_reward() == 1
    assert inclined.distance(world.oracle_point()[None])[0] < 0
    monkeypatch.setattr(world, "weights", torch.tensor([1.0, 0.25]))
    assert inclined.distance(world.oracle_point()[None])[0] > 0, "the ground is flat"


def test_a_seed_repeats_scene_and_outcome_whatever_came_before(world: LandingEnv) -> None:
    def episode(seed: int) -> tuple[Any, ...]:
        images = world.reset(seed=seed)[0]["sensor_data"]["down"]
        scene = images["rgb"].numpy().copy(), images["depth"].numpy().copy(), [one.to_dict() for one in world.blocks]
        target = world.blocks[0]
        spot = np.clip([target.x, target.y], world._location - 10, world._location + 10)
        return *scene, land(world, *spot, max(0.0, float(target.top_at(spot[None])[0])))

    first, other, again = episode(5), episode(6), episode(5)
    assert all(np.array_equal(a, b) for a, b in zip(first[:2], again[:2], strict=True))
    assert first[2:] == again[2:]
    assert not np.array_equal(first[0], other[0])


def test_one_block_can_be_changed_and_nothing_else(world: LandingEnv) -> None:
    before = world.reset(seed=3)[0]["sensor_data"]["down"]
    rgb, depth, place = before["rgb"].numpy().copy(), before["depth"].numpy().copy(), world._location.copy()
    colored = next(
        i for i, one in enumerate(world.blocks) if one.color != "gray" and np.abs(place - (one.x, one.y)).max() < 8
    )
    blocks = [one.to_dict() for one in world.blocks]
    blocks[colored]["color"] = "gray"
    after = world.reset(seed=3, options={"blocks": blocks})[0]["sensor_data"]["down"]
    assert np.array_equal(depth, after["depth"].numpy())
    assert np.array_equal(place, world._location)
    changed = (rgb != after["rgb"].numpy()).any(-1).mean()
    assert 0.001 < changed < 0.1


def test_heights_of_the_map_are_those_of_the_world(mapped: ManiSkillEnv) -> None:
    world = mapped.task
    for seed in range(5):
        mapped.next_scene = seed
        state = mapped.reset()
        seen, height = state["action_mask"].numpy(), state["heightmap"][3].flatten().numpy()
        assert state["heightmap"].shape == (4, 84, 84)
        assert seen.mean() > 0.95
        cells = cell_middles(world.workspace_bounds, world.pixel_size)
        clear = seen.copy()
        for one in world.blocks:
            distance = one.distance(cells)
            top = distance < -0.25
            # The highest point of a cell: up to half a diagonal up the slope.
            rise = 0.18 * np.tan(np.deg2rad(one.incline)) + 0.02
            error = height[top & seen] - (one.top_at(cells[top & seen]) + 0.05)
            assert ((error > -0.02) & (error < rise)).all()
            clear &= distance > 0.25
        assert np.abs(height[clear] - 0.05).max() < 0.01, "ground"
        assert (height[~seen] == 0).all()


def test_the_same_field_serves_several_landings() -> None:
    env = LandingEnv(**world_settings("landing", landings_per_episode=2))
    try:
        env.reset(seed=1)
        blocks, place = list(env.blocks), env._location.copy()
        _, _, terminated, truncated, _ = env.step(np.array([*place, 0.0]))
        assert not terminated and not truncated
        assert env.blocks == blocks and not np.array_equal(env._location, place)
        assert env.agent.robot.pose.p[0, 2] == pytest.approx(env.altitude)
        _, _, terminated, _, _ = env.step(np.array([*env._location, 0.0]))
        assert terminated
    finally:
        env.close()


def test_objects_are_those_in_view(world: LandingEnv) -> None:
    near, far = block(world, color="gray", incline=20), block(world)
    far = Block(**far.to_dict() | {"x": world._location[0] + 14})
    put(world, near, far)
    (thing,) = world.scene_objects()
    assert thing.name == "gray inclined block"
    assert thing.attributes == {"color": "gray", "kind": "inclined block", "incline_deg": 20}
    assert thing.top == pytest.approx(1.4 + 1.25 * np.tan(np.deg2rad(20)))
    assert np.allclose(thing.footprint.mean(0), (near.x, near.y))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("altitude", 3),
        ("pixel_size", 1.0),
        ("image_size", 20),
        ("blocks", [9, 3]),
        ("incline_deg", [8, 80]),
        ("inclined_share", 2),
    ],
)
def test_a_setting_out_of_range_is_named(name: str, value: Any) -> None:
    with pytest.raises(ValueError, match=f"^{name} must be between"):
        LandingEnv(**world_settings("landing", **{name: value}))
