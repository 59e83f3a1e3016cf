"""What the worlds call the highest reward available is what their primitives earn, of whichever cell is chosen."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import torch
from tensordict import TensorDictBase

from tasks.agents.aircraft import FOOT_RADIUS
from tasks.blocks import Block
from tasks.flight import steps_needed
from tasks.grasping import GraspingEnv
from tasks.landing import CELLS, LandingEnv
from tasks.overview import Prospects, near, prospects, seen_points
from tasks.tabletop import Thing
from tests.settings import world_settings
from xqmap.envs.maniskill import ManiSkillEnv
from xqmap.evaluation.baselines import BASELINES, random_pixel

pytestmark = pytest.mark.sim


@pytest.fixture(scope="module")
def field() -> Iterator[LandingEnv]:
    env = LandingEnv(**world_settings("landing"))
    yield env
    env.close()


@pytest.fixture(scope="module")
def mapped(field: LandingEnv) -> ManiSkillEnv:
    return ManiSkillEnv(lambda: field)


def foreseen(world: LandingEnv, points: np.ndarray) -> tuple[Prospects, list[dict[str, float]]]:
    """What is touched first at each of the points, and the sub-rewards of all things that may be."""
    blocks = near(world.blocks, world.workspace_bounds, 1.0)
    return prospects(blocks, points), [world._properties(thing) for thing in (None, *blocks)]


def seen(world: LandingEnv) -> np.ndarray:
    """``[M, 3]``: the points that can be chosen."""
    image, camera = (world._last_obs[name]["down"] for name in ("sensor_data", "sensor_param"))
    return seen_points(image["depth"], camera, world.workspace_bounds, world.pixel_size)


def earned(world: LandingEnv, point: np.ndarray) -> dict[str, float]:
    """The sub-rewards of a landing, after which all is as it was."""
    return world._outcome_of(world._flight.rehearse(point, world.control_steps))


def beside(state: TensorDictBase, env: ManiSkillEnv, generator: torch.Generator) -> int:
    """A cell around the edge of a random object; any where there is none."""
    things = env.task.scene_objects()
    if not things:
        return random_pixel(state, env, generator)
    thing = things[int(torch.randint(len(things), (), generator=generator))]
    outline = np.asarray(thing.footprint)
    corner = outline[int(torch.randint(len(outline), (), generator=generator))]
    reach = 0.2 + float(torch.rand((), generator=generator))
    return env.action_at(outline.mean(0) + reach * (corner - outline.mean(0)))


def test_the_world_knows_which_cells_can_be_chosen(mapped: ManiSkillEnv) -> None:
    for seed in (7000, 7001, 7010, 7031):
        mapped.next_scene = seed
        state = mapped.reset()
        points = {mapped.action_at(point): point for point in seen(mapped.task)}
        cells = set(np.flatnonzero(state["action_mask"]).tolist())
        assert len(cells ^ set(points)) <= 1, "what lies on the border of two cells is rounded into either"
        apart = [np.abs(points[cell] - mapped.point(cell).numpy()).max() > 0.003 for cell in cells & set(points)]
        assert np.mean(apart) < 0.005


def test_physics_touches_at_edges_what_geometry_says(field: LandingEnv) -> None:
    rng, sure = np.random.default_rng(0), 0
    for seed in range(100, 112):
        field.reset(seed=seed)
        points = seen(field)
        ahead, pays = foreseen(field, points)
        for i in rng.choice(np.flatnonzero(ahead.room < 0.4), 8, replace=False):
            outcome = earned(field, points[i])
            if ahead.sure[i] >= 0:
                assert outcome == pays[ahead.sure[i]]
                sure += 1
            else:
                may = [pays[thing] for thing in np.flatnonzero(ahead.may[:, i])]
                # A wall is not flat.
                may += [thing | {"flatness": 0.0} for thing in may]
                assert outcome in [*may, {"flatness": 0.0, "color": 0.0}]
    assert 20 < sure < 90


@pytest.mark.parametrize(("seed", "x", "y"), [(205, 1.02, -8.35), (206, 4.33, 7.87), (217, 1.87, 17.04)])
def test_what_a_fast_descent_only_grazes_is_no_touch(field: LandingEnv, seed: int, x: float, y: float) -> None:
    field.reset(seed=seed)
    points = seen(field)
    nearest = np.hypot(*(points[:, :2] - (x, y)).T).argmin()
    ahead, _ = foreseen(field, points[nearest : nearest + 1])
    assert ahead.sure[0] < 0 and ahead.may[0, 0] and ahead.room[0] < 0.15
    assert earned(field, points[nearest]) == {"flatness": 1.0, "color": 0.0}
    spot = field._flight.rehearse(points[nearest], field.control_steps).spot
    assert np.hypot(*(spot - points[nearest])[:2]) > 0.15, "it was pushed aside, to the ground"


@pytest.mark.parametrize(
    ("views", "changes"),
    [(300, {}), (60, {"blocks": [2, 2]}), (8, {"blocks": [60, 80]}), (12, {"incline_deg": [2.0, 8.0]})],
    ids=["usual", "two blocks", "crowded", "slopes"],
)
def test_no_landing_earns_more_than_is_available(views: int, changes: dict[str, Any]) -> None:
    """Physics is asked where geometry does not say."""
    env = ManiSkillEnv(lambda: LandingEnv(**world_settings("landing", **changes)))
    world, generator, asked = env.task, torch.Generator().manual_seed(0), 0
    try:
        for seed in range(7000, 7000 + views):
            env.next_scene = seed
            state = env.reset()
            highest = world.highest_reward()
            for name, choose in (BASELINES | {"beside": beside}).items():
                cell = choose(state, env, generator)
                if not state["action_mask"][cell]:
                    assert name in ("random object", "beside"), "the middle of what is seen may be hidden"
                    continue
                point = env.point(cell).numpy().astype(float)
                ahead, pays = foreseen(world, point[None])
                sure = int(ahead.sure[0])
                reward = world.weighed(pays[sure] if sure >= 0 else earned(world, point))
                asked += sure < 0
                assert reward <= highest, f"{name} in view {seed}"
                assert name != "oracle" or reward == highest, f"view {seed}"
    finally:
        env.close()
    assert asked > 0


@pytest.mark.parametrize("seed", [7102, 7116, 7259])
def test_a_sliver_of_the_best_top_is_worth_what_it_earns(mapped: ManiSkillEnv, seed: int) -> None:
    world = mapped.task
    mapped.next_scene = seed
    state = mapped.reset()
    assert world.highest_reward() == 2.0
    state["action"] = torch.tensor(mapped.action_at(world.oracle_point()))
    assert state["action_mask"][state["action"]]
    result = mapped.step(state)["next"]
    assert result["reward_components"].tolist() == [1.0, 1.0]
    assert float(result["reward_available"]) == 2.0


def test_what_only_physics_can_tell_is_tried_and_leaves_no_trace(field: LandingEnv) -> None:
    # The foot reaches the only colored top by so little that it may miss it.
    field.reset(seed=0)
    points = seen(field)
    x, y = points[:, 0].max() + FOOT_RADIUS + 1, field._location[1]
    sliver = Block(x=x, y=y, yaw=0, length=2, width=8, height=1.4, incline=0, color="red")
    outcomes = []
    for rehearsed in (True, False):
        field.reset(seed=0, options={"blocks": [sliver.to_dict()]})
        if rehearsed:
            best = field.highest_reward(), field.oracle_point()
            assert field._flight._rehearsed
            assert not field.frames
        _, reward, _, _, info = field.step(points[0])
        outcomes.append((float(reward), {name: float(info[name]) for name in field.METRICS}))
    assert outcomes[0] == outcomes[1]
    field.reset(seed=0, options={"blocks": [sliver.to_dict()]})
    assert float(field.step(best[1])[1]) == best[0]


def test_every_cell_in_view_can_be_reached_in_time(field: LandingEnv) -> None:
    field.reset(seed=0)
    points = seen(field)
    ahead, pays = foreseen(field, points)
    far = np.argsort(-np.linalg.norm(points[:, :2] - field._location, axis=1))
    needed = steps_needed(CELLS * field.pixel_size / np.sqrt(2), field.altitude)
    for i in far[ahead.sure[far] >= 0][:4]:
        assert field._outcome_of(field._flight.rehearse(points[i], needed)) == pays[ahead.sure[i]]
    with pytest.raises(ValueError, match=f"^control_steps must be at least {needed}, .* not {needed - 1}$"):
        LandingEnv(**world_settings("landing", control_steps=needed - 1))


@pytest.mark.parametrize(
    ("scenes", "choices", "changes"),
    [
        (4, 5, {}),
        (3, 5, {"objects": [25, 25], "layout": "cluttered"}),
        (2, 5, {"objects": [15, 15], "seal": "touch", "weights": {"shape": 0.25, "color": 1.0}}),
    ],
    ids=["usual", "cluttered", "touch"],
)
def test_no_pick_earns_more_than_is_available(scenes: int, choices: int, changes: dict[str, Any]) -> None:
    env = ManiSkillEnv(lambda: GraspingEnv(**world_settings("grasping", **changes)))
    world, generator = env.task, torch.Generator().manual_seed(0)
    by = list((BASELINES | {"beside": beside}).items())
    try:
        for seed in range(7000, 7000 + scenes):
            env.next_scene = seed
            state = env.reset()
            for turn in range(choices):
                name, choose = by[(seed + turn) % len(by)]
                highest = world.highest_reward()
                state["action"] = torch.tensor(choose(state, env, generator))
                assert state["action_mask"][state["action"]] or name == "beside"
                state = env.step(state)["next"]
                assert float(state["reward"]) <= highest, f"{name}, choice {turn} of scene {seed}"
                assert name != "oracle" or float(state["reward"]) == highest
                if state["done"]:
                    break
    finally:
        env.close()


def test_a_limit_of_time_takes_from_what_is_available_what_it_takes_from_a_pick() -> None:
    world = GraspingEnv(**world_settings("grasping"))
    cube = Thing("cube", "blue", 0.5, 0.1)

    def best(limit: float) -> tuple[float, float, dict[str, Any]]:
        world.reset(seed=0, options={"things": [cube.to_dict()]})
        world.arm.limit = limit
        highest = world.highest_reward()
        _, reward, _, _, info = world.step(world.oracle_point())
        return highest, float(reward), info

    try:
        highest, reward, info = best(1500)
        whole = float(info["control_steps"])
        assert highest == reward == pytest.approx(1 + cube.rank)
        for share, pays in ((0.3, 0.0), (0.6, cube.rank), (1.02, 1 + cube.rank)):
            highest, reward, _ = best(round(share * whole))
            assert highest == reward == pytest.approx(pays)
    finally:
        world.close()
