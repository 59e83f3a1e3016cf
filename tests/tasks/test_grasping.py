"""The grasping world: what pays, what seals, what is seen, what repeats."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import sapien
import torch

from tasks.grasping import GraspingEnv
from tasks.layouts import reaches
from tasks.tabletop import CUBE, OUTSIDE, RANK, Thing, body_of, cube_top, pose_of
from tasks.workcell import BOUNDS, CAMERAS, PIXEL_SIZE
from tests.settings import world_settings
from xqmap.envs.maniskill import ManiSkillEnv
from xqmap.envs.protocol import Task

pytestmark = pytest.mark.sim

CUBE_AT = Thing("cube", "blue", 0.5, 0.1, 30.0)
BOWL_AT = Thing("bowl", "purple", 0.45, -0.2)


@pytest.fixture(scope="module")
def world() -> Iterator[GraspingEnv]:
    env = GraspingEnv(**world_settings("grasping"))
    yield env
    env.close()


@pytest.fixture(scope="module")
def mapped(world: GraspingEnv) -> ManiSkillEnv:
    return ManiSkillEnv(lambda: world)


def put(world: GraspingEnv, *things: Thing) -> dict[str, Any]:
    return world.reset(seed=0, options={"things": [thing.to_dict() for thing in things]})[0]


def attempt(world: GraspingEnv, x: float, y: float, z: float) -> tuple[list[float], dict[str, Any]]:
    _, reward, terminated, truncated, info = world.step(np.array([x, y, z]))
    components = info["reward_components"][0]
    assert float(reward) == float((components * world.weights).sum())
    return components.tolist(), {**info, "terminated": bool(terminated), "truncated": bool(truncated)}


@pytest.fixture(scope="module")
def whole_pick(world: GraspingEnv) -> float:
    """Control steps of a pick at the middle of ``CUBE_AT``."""
    put(world, CUBE_AT, BOWL_AT)
    return float(attempt(world, CUBE_AT.x, CUBE_AT.y, CUBE)[1]["control_steps"])


def test_offers_what_the_framework_asks_of_a_task(world: GraspingEnv) -> None:
    assert isinstance(world, Task)


@pytest.mark.parametrize(
    ("thing", "offset", "height", "shape", "touched"),
    [
        (CUBE_AT, (0.0, 0.0), CUBE, 1.0, True),
        (CUBE_AT, (0.006, 0.004), CUBE, 1.0, True),
        (CUBE_AT, (0.018, 0.0), CUBE, 0.0, True),
        (BOWL_AT, (0.0, 0.0), 0.004, 0.0, True),
        (BOWL_AT, (0.03, 0.0), 0.02, 0.0, True),
        (BOWL_AT, (0.056, 0.0), float(OUTSIDE[-1, 1]), 0.0, True),
        (CUBE_AT, (0.1, 0.0), 0.0, 0.0, False),
    ],
    ids=["face", "off the middle", "edge", "bowl's floor", "bowl's inside", "bowl's rim", "table"],
)
def test_what_is_tried_pays_its_color_and_only_a_lifted_cube_its_shape(
    world: GraspingEnv, thing: Thing, offset: tuple[float, float], height: float, shape: float, touched: bool
) -> None:
    put(world, thing, Thing("cube", "red", 0.7, 0.4))
    components, info = attempt(world, thing.x + offset[0], thing.y + offset[1], height)
    assert components == pytest.approx([shape, thing.rank if touched else 0.0])
    assert float(info["touched"]) == touched
    assert float(info["slip_mm"]) < 1
    assert len(world.scene_objects()) == (1 if shape else 2), "a lifted cube is gone, all else stays"
    assert float(info["control_steps"]) < world.control_steps


def test_a_bowl_stays_where_it_was(world: GraspingEnv) -> None:
    put(world, CUBE_AT, BOWL_AT)
    before = world.scene_objects()[1].footprint
    for offset in (0.0, 0.04, 0.056):
        attempt(world, BOWL_AT.x, BOWL_AT.y + offset, 0.03)
    moved = np.linalg.norm(world.scene_objects()[1].footprint.mean(0) - before.mean(0))
    assert moved < 0.01


def test_the_lifted_cube_lies_in_the_bin(world: GraspingEnv) -> None:
    put(world, CUBE_AT, BOWL_AT)
    attempt(world, *cube_top(pose_of(next(iter(world._things)))))
    (cube,) = world._binned
    assert (cube.pose.p[:2] < 0.6).all() and cube.pose.p[0] < BOUNDS[0, 0]
    assert 0 < cube.pose.p[2] < 0.1


@pytest.mark.parametrize("holds", [20, 60], ids=["while it is lifted", "on the way to the bin"])
def test_a_cube_that_drops_is_a_failure_and_the_arm_goes_home(
    world: GraspingEnv, monkeypatch: pytest.MonkeyPatch, holds: int
) -> None:
    put(world, CUBE_AT, Thing("cube", "red", 0.7, 0.4))
    held = iter(range(10_000))
    monkeypatch.setattr(world.suction, "slip", lambda: 0.0 if next(held) < holds or world.suction.body is None else 1.0)
    components, info = attempt(world, CUBE_AT.x, CUBE_AT.y, CUBE)
    assert components == pytest.approx([0.0, RANK["blue"]])
    assert float(info["sealed"]) == 1 and not world._binned
    assert "blue cube" in {thing.name for thing in world._things.values()}
    assert np.allclose(world.agent.robot._objs[0].get_qpos(), world._home, atol=0.01)


def test_touching_is_enough_with_the_touch_seal(world: GraspingEnv, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(world, "seal", "touch")
    put(world, CUBE_AT, BOWL_AT)
    assert attempt(world, CUBE_AT.x + 0.016, CUBE_AT.y, CUBE)[0] == pytest.approx([1.0, RANK["blue"]])
    put(world, CUBE_AT, BOWL_AT)
    assert attempt(world, BOWL_AT.x, BOWL_AT.y, 0.01)[0] == pytest.approx([0.0, RANK["purple"]])


def test_an_episode_ends_with_the_last_cube_or_the_limit_of_attempts(
    world: GraspingEnv, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(world, "failure", "stays")
    put(world, CUBE_AT, BOWL_AT)
    monkeypatch.setattr(world, "attempts", 2)
    assert not attempt(world, 0.6, 0.4, 0.0)[1]["truncated"]
    info = attempt(world, 0.6, 0.4, 0.0)[1]
    assert info["truncated"] and not info["terminated"]
    put(world, CUBE_AT, BOWL_AT)
    info = attempt(world, CUBE_AT.x, CUBE_AT.y, CUBE)[1]
    assert info["terminated"] and not info["truncated"]


@pytest.mark.parametrize(
    "share", [0.1, 0.4, 0.6, 0.8, 0.95], ids=["on the way", "going down", "lifting", "to the bin", "over the bin"]
)
def test_a_pick_that_takes_too_long_lifts_nothing_and_the_arm_goes_home(
    world: GraspingEnv, whole_pick: float, share: float
) -> None:
    put(world, CUBE_AT, BOWL_AT)
    world.arm.limit = limit = round(share * whole_pick)
    components, info = attempt(world, CUBE_AT.x, CUBE_AT.y, CUBE)
    assert components[0] == 0.0 and not world._binned
    assert components[1] == pytest.approx(RANK["blue"] if float(info["touched"]) else 0.0)
    assert float(info["control_steps"]) == limit
    assert np.allclose(world.agent.robot._objs[0].get_qpos(), world._home, atol=0.01)


def test_the_oracle_always_gets_what_is_available(mapped: ManiSkillEnv) -> None:
    world = mapped.task
    for seed in range(4):
        mapped.next_scene = seed
        state, done = mapped.reset(), False
        while not done:
            cell = mapped.action_at(world.oracle_point())
            assert state["action_mask"][cell]
            state["action"] = torch.tensor(cell)
            state = mapped.step(state)["next"]
            assert float(state["reward"]) == pytest.approx(float(state["reward_available"]))
            done = bool(state["done"])
        assert bool(state["terminated"])


def test_exact_values_name_the_best_object(world: GraspingEnv, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(world, "failure", "stays")
    put(world, CUBE_AT, BOWL_AT, Thing("cube", "yellow", 0.7, 0.4))
    names = [thing.name for thing in world.scene_objects()]
    values = dict(zip(names, world.exact_values(0.1).tolist(), strict=True))
    assert values["blue cube"] == pytest.approx([1.1, 0.8 + 0.1 * 0.4])
    assert values["purple bowl"] == pytest.approx([0.1 * 1.1, 1.0 + 0.1 * 0.84])
    assert world.highest_reward() == pytest.approx(1.8)


def test_weights_decide_what_is_best(world: GraspingEnv, monkeypatch: pytest.MonkeyPatch) -> None:
    put(world, Thing("cube", "red", 0.5, 0.1), BOWL_AT)
    monkeypatch.setattr(world, "weights", torch.tensor([0.5, 1.0]))
    assert world.highest_reward() == 1.0
    assert np.linalg.norm(world.oracle_point()[:2] - (BOWL_AT.x, BOWL_AT.y)) < 0.01


def test_the_mask_is_what_inverse_kinematics_can_reach(world: GraspingEnv, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(world, "hover", 0.3)
    rng = np.random.default_rng(0)
    points = np.column_stack((rng.uniform(*BOUNDS[0], 300), rng.uniform(*BOUNDS[1], 300), rng.uniform(0, 0.05, 300)))
    reached = [reaches(Thing("cube", "red", x, y), 0.3, world._home) for x, y, _ in points]
    assert 0.5 < np.mean(reached) < 1
    assert np.array_equal(world.reachable(points), reached)


def test_the_waiting_arm_hides_nothing(world: GraspingEnv) -> None:
    seen = put(world, CUBE_AT, BOWL_AT)
    hidden, calibration = seen["sensor_data"], seen["sensor_param"]
    with_arm = {name: hidden[name]["depth"].numpy().copy() for name in CAMERAS}
    robot = world.agent.robot._objs[0]
    robot.set_root_pose(sapien.Pose([5.0, 0, 0]))
    without = world.get_obs()["sensor_data"]
    low, high = BOUNDS.T
    for name, (eye, _) in CAMERAS.items():
        to_camera = calibration[name]["extrinsic_cv"][0].numpy()
        depth = without[name]["depth"][0, ..., 0].numpy() / 1000
        v, u = np.indices(depth.shape)
        ray = np.stack(((u - 320) / 450, (v - 240) / 450, np.ones_like(depth)), -1) * depth[..., None]
        world_points = (ray - to_camera[:3, 3]) @ to_camera[:3, :3]
        assert np.linalg.norm(-to_camera[:3, 3] @ to_camera[:3, :3] - eye) < 1e-3
        inside = ((world_points >= low) & (world_points < high)).all(-1)
        assert (
            np.abs(
                with_arm[name][0, ..., 0][inside].astype(int) - without[name]["depth"][0, ..., 0].numpy()[inside]
            ).max()
            <= 1
        )
    robot.set_root_pose(sapien.Pose(q=[0, 0, 0, 1]))


def test_the_map_shows_cubes_bowls_and_the_table_where_they_are(mapped: ManiSkillEnv) -> None:
    put(mapped.task, CUBE_AT, BOWL_AT)
    state = mapped._observe(mapped.task.get_obs())
    assert state["heightmap"].shape == (4, 320, 160)
    height = state["heightmap"][3].flatten()
    floor = -BOUNDS[2, 0]
    for point, expected in (
        ((CUBE_AT.x, CUBE_AT.y), CUBE),
        ((BOWL_AT.x, BOWL_AT.y), 0.004),
        ((BOWL_AT.x + 0.056, BOWL_AT.y), 0.035),
        ((0.6, 0.4), 0.0),
    ):
        assert float(height[mapped.action_at(point)]) == pytest.approx(expected + floor, abs=0.003)
    assert float(state["action_mask"].float().mean()) > 0.99
    assert pytest.approx(PIXEL_SIZE) == mapped.grid.pixel_size


def test_a_seed_repeats_scene_and_outcome_whatever_came_before(world: GraspingEnv) -> None:
    def episode(seed: int) -> tuple[Any, ...]:
        images = world.reset(seed=seed)[0]["sensor_data"]["front"]
        scene = images["rgb"].numpy().copy(), images["depth"].numpy().copy()
        things = [thing.to_dict() for thing in world._things.values()]
        components, info = attempt(world, *world.oracle_point())
        return *scene, things, components, float(info["slip_mm"]), [built.pose.p.tolist() for built in world._things]

    first, other, again = episode(5), episode(6), episode(5)
    assert all(np.array_equal(a, b) for a, b in zip(first[:2], again[:2], strict=True))
    assert first[2:] == again[2:]
    assert not np.array_equal(first[0], other[0])


def test_one_object_can_be_changed_and_nothing_else(world: GraspingEnv) -> None:
    before = world.reset(seed=3)[0]["sensor_data"]["front"]
    rgb, depth = before["rgb"].numpy().copy(), before["depth"].numpy().copy()
    things = [thing.to_dict() for thing in world._things.values()]
    things[0]["color"] = "purple" if things[0]["color"] == "red" else "red"
    after = world.reset(seed=3, options={"things": things})[0]["sensor_data"]["front"]
    assert np.abs(depth.astype(int) - after["depth"].numpy()).max() <= 1
    assert 0.0005 < (rgb != after["rgb"].numpy()).any(-1).mean() < 0.1


def test_objects_rest_when_the_picture_is_taken() -> None:
    env = GraspingEnv(**world_settings("grasping", objects=[25, 25], layout="cluttered"))
    try:
        for seed in range(3):
            env.reset(seed=seed)
            assert len(env.scene_objects()) == 25
            assert max(np.linalg.norm(body_of(built).linear_velocity) for built in env._things) < 0.01
    finally:
        env.close()


def test_depth_noise_is_drawn_from_the_scene_s_seed() -> None:
    env = GraspingEnv(**world_settings("grasping", depth_noise=0.003))
    try:
        clean = env.depth_noise
        images = [env.reset(seed=2)[0]["sensor_data"]["left"]["depth"].numpy().astype(int).copy() for _ in range(2)]
        env.depth_noise = 0.0
        truth = env.reset(seed=2)[0]["sensor_data"]["left"]["depth"].numpy().astype(int)
        assert np.array_equal(*images)
        assert np.std(images[0] - truth) == pytest.approx(1000 * clean, rel=0.1)
    finally:
        env.close()


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("objects", [9, 31]),
        ("light", 3),
        ("depth_noise", -1),
        ("hover", 0.5),
        ("attempts", 0),
        ("layout", "heap"),
        ("seal", "glue"),
    ],
)
def test_a_setting_out_of_range_is_named(name: str, value: Any) -> None:
    with pytest.raises(ValueError, match=f"^{name} must be"):
        GraspingEnv(**world_settings("grasping", **{name: value}))
