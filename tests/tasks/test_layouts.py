from __future__ import annotations

import numpy as np
import pytest

from tasks.agents.kinematics import forward
from tasks.agents.ur5e import joints_at
from tasks.grasping import GraspingEnv
from tasks.layouts import reachable_layout, reaches, sample_layout
from tasks.tabletop import CUBE, Thing
from tasks.workcell import BIN, HOME_HEIGHT
from tests.settings import world_settings

HOME = joints_at(np.array([[*BIN, HOME_HEIGHT]]), np.zeros(6))[0]


@pytest.mark.parametrize(("layout", "count"), [("spread", 7), ("spread", 30), ("cluttered", 25)])
def test_layouts_repeat_by_seed_hold_a_cube_and_do_not_overlap(layout: str, count: int) -> None:
    bounds = np.array([[0.28, 0.72], [-0.45, 0.45]])
    things = sample_layout(np.random.RandomState(3), count, layout, bounds, 5.0)
    assert things == sample_layout(np.random.RandomState(3), count, layout, bounds, 5.0)
    assert len(things) == count
    assert "cube" in {thing.kind for thing in things}
    places = np.array([[thing.x, thing.y] for thing in things])
    apart = np.linalg.norm(places[:, None] - places, axis=-1)[~np.eye(count, dtype=bool)]
    assert apart.min() > CUBE
    assert all(Thing(**thing.to_dict()) == thing for thing in things)


def test_layouts_out_of_reach_are_drawn_again() -> None:
    drawn = [reachable_layout(np.random.RandomState(seed), 10, "spread", 6.0, 0.4, HOME) for seed in range(6)]
    assert all(reaches(thing, 0.4, HOME) for things, _ in drawn for thing in things)
    assert sum(rejected for _, rejected in drawn) > 0
    with pytest.raises(ValueError, match="lower task"):
        reachable_layout(np.random.RandomState(0), 2, "spread", 6.0, 1.5, HOME)


@pytest.mark.sim
def test_the_world_draws_layouts_out_of_reach_again() -> None:
    env = GraspingEnv(**world_settings("grasping", hover=0.4, objects=[10, 10]))
    try:
        rejected = 0
        for seed in range(6):
            env.reset(seed=seed)
            rejected += env.layouts_rejected
            for thing in env._things.values():
                flange = forward(joints_at(np.array([[thing.x, thing.y, 0.4]]), env._home)[0])
                assert np.linalg.norm(flange[:2, 3] * (-1, -1) - (thing.x, thing.y)) < 0.001
        assert rejected > 0
    finally:
        env.close()
