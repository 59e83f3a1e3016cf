"""Grasping where a failure has consequences, and where cubes stand on cubes: what ends, what is gone, what is exact."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from tasks.grasping import GraspingEnv
from tasks.layouts import sample_layout
from tasks.tabletop import CUBE, Thing
from tasks.workcell import BOUNDS
from tests.settings import world_settings
from tests.tasks.test_grasping import attempt, put
from xqmap.envs.maniskill import ManiSkillEnv
from xqmap.evaluation import play
from xqmap.evaluation.baselines import known_to

pytestmark = pytest.mark.sim

PURPLE_BOWL, RED_CUBE = Thing("bowl", "purple", 0.45, -0.2), Thing("cube", "red", 0.6, 0.2)
BLUE_CUBE = Thing("cube", "blue", 0.5, 0.1, 30.0)


@pytest.fixture(scope="module")
def world() -> Iterator[GraspingEnv]:
    env = GraspingEnv(**world_settings("foresight", layout="stacked", hover=0.16), weights={"shape": 1.0, "color": 2.0})
    yield env
    env.close()


@pytest.mark.parametrize(
    ("failure", "at", "over", "left"),
    [
        ("ends", PURPLE_BOWL, True, 3),
        ("ends", Thing("cube", "red", 0.65, -0.4), True, 3),  # the bare table
        ("ends", BLUE_CUBE, False, 2),
        ("stays", PURPLE_BOWL, False, 3),
        ("removed", PURPLE_BOWL, False, 2),
        ("removed", Thing("cube", "red", 0.65, -0.4), False, 3),
    ],
)
def test_what_follows_an_attempt(
    world: GraspingEnv, monkeypatch: pytest.MonkeyPatch, failure: str, at: Thing, over: bool, left: int
) -> None:
    monkeypatch.setattr(world, "failure", failure)
    put(world, PURPLE_BOWL, RED_CUBE, BLUE_CUBE)
    _, info = attempt(world, at.x, at.y, CUBE if at.kind == "cube" else 0.004)
    assert info["terminated"] is over
    assert len(world.scene_objects()) == left
    put(world, PURPLE_BOWL, RED_CUBE, BLUE_CUBE)
    assert not world._failed and len(world.scene_objects()) == 3, "a new scene remembers nothing"


def test_a_stacked_layout_puts_the_lower_color_on_top() -> None:
    stacked = cubes = 0
    for seed in range(20):
        things = sample_layout(np.random.RandomState(seed), 9, "stacked", BOUNDS, 5.0)
        assert things == sample_layout(np.random.RandomState(seed), 9, "stacked", BOUNDS, 5.0)
        cubes += sum(thing.kind == "cube" for thing in things)
        for top in (thing for thing in things if thing.level):
            (base,) = [other for other in things if other is not top and (other.x, other.y) == (top.x, top.y)]
            assert base.kind == top.kind == "cube" and base.level == 0 and top.rank <= base.rank
            stacked += 2
    assert 0.5 < stacked / cubes < 0.95


def test_cubes_stand_and_are_lifted_one_after_the_other(world: GraspingEnv) -> None:
    purple, red = Thing("cube", "purple", 0.5, 0.1), Thing("cube", "red", 0.5, 0.1, level=1)
    put(world, purple, red, Thing("cube", "green", 0.6, -0.3))
    assert sorted(round(thing.top, 2) for thing in world.scene_objects()) == [CUBE, CUBE, 2 * CUBE]
    exact = dict(zip([thing.name for thing in world.scene_objects()], world.exact_values(0.5).tolist(), strict=True))
    # Red first and then purple and green; green first and then red and purple; purple is out of reach.
    assert exact == {"purple cube": [0, 0], "red cube": [1.75, 0.65], "green cube": [1.75, 0.85]}
    for rank, height in ((0.0, 2 * CUBE), (1.0, CUBE)):
        components, info = attempt(world, 0.5, 0.1, height)
        assert components == [1.0, rank]
        assert not info["terminated"]
    assert [thing.name for thing in world.scene_objects()] == ["green cube"]


def test_who_follows_the_exact_solution_gets_what_it_promises(world: GraspingEnv) -> None:
    env = ManiSkillEnv(lambda: world)
    run: dict[str, Any] = {}
    for name, choose in known_to(env, 0.9).items():
        if name in ("oracle", "myopic", "random pixel"):
            seeds = [0, 1] if name == "oracle" else [0]
            found = [play.play(choose, env, seed, 20, None, None, play.Optimum(env, 0.9, [1.0, 2.0])) for seed in seeds]
            run[name] = play.against_optimum(found)
    assert run["oracle"]["optimal"]["mean"] == 1.0
    assert run["oracle"]["return_ratio"] == pytest.approx(1.0, abs=1e-4)
    assert run["myopic"]["return_ratio"] < 1
    assert run["random pixel"]["optimal"]["mean"] < 0.5
