from __future__ import annotations

import numpy as np
import pytest
import sapien

from tasks.agents.ur5e import joints_at
from tasks.offers import Offer, in_time, offer
from tasks.tabletop import CUBE, Thing, entity
from tasks.workcell import BIN, CELLS, HOME_HEIGHT, PIXEL_SIZE

HOME = joints_at(np.array([[*BIN, HOME_HEIGHT]]), np.zeros(6))[0]
RED, BLUE, BOWL = Thing("cube", "red", 0.5, 0.1), Thing("cube", "blue", 0.5, 0.1), Thing("bowl", "red", 0.5, 0.1)


def lying(*things: tuple[Thing, float, float]) -> dict[sapien.Entity, Thing]:
    """Things with their height over the table (m) and their tilt about x (degrees)."""
    built = {entity(thing): thing for thing, _, _ in things}
    for one, (thing, z, tilt) in zip(built, things, strict=True):
        half = np.deg2rad(tilt) / 2
        one.pose = sapien.Pose([thing.x, thing.y, z], [np.cos(half), np.sin(half), 0, 0])
    return built


def first_offer(*things: tuple[Thing, float, float], seal: str = "rim", reach: bool = True) -> Offer:
    built = lying(*things)
    return offer(next(iter(built)), built, CELLS, lambda points: np.full(len(points), reach), seal)


def near_middle(point: np.ndarray | None, z: float) -> bool:
    return point is not None and bool(
        np.abs(point[:2] - (0.5, 0.1)).max() <= PIXEL_SIZE and point[2] == pytest.approx(z, abs=0.002)
    )


def test_a_cube_is_lifted_at_its_middle_and_a_bowl_only_touched() -> None:
    cube = first_offer((RED, 0, 0))
    assert cube.touch is not None and cube.lift is not None
    assert near_middle(cube.lift, CUBE) and np.array_equal(cube.touch, cube.lift)
    bowl = first_offer((BOWL, 0, 0))
    # The cup's rim meets the round bottom before its middle would.
    assert near_middle(bowl.touch, 0.009) and bowl.lift is None
    assert bowl.point is bowl.touch and cube.point is cube.lift


@pytest.mark.parametrize(("tilt", "lifted"), [(10, True), (20, False)])
def test_a_tilted_cube_can_be_touched_and_lifted_only_if_the_cup_seals(tilt: float, lifted: bool) -> None:
    tilted = first_offer((RED, 0, tilt))
    assert tilted.touch is not None
    assert (tilted.lift is not None) == lifted
    assert first_offer((RED, 0, tilt), seal="touch").lift is not None


def test_what_lies_under_another_is_offered_beside_it() -> None:
    under, above = (RED, 0.0, 0.0), (BLUE, CUBE, 0.0)
    assert first_offer(under, above) == Offer()
    assert near_middle(first_offer(above, under).lift, 2 * CUBE)
    # A ledge narrower than the cup's rim: it meets the upper cube first.
    assert first_offer(under, (Thing("cube", "blue", 0.5, 0.108), CUBE, 0)).lift is None
    half = first_offer(under, (Thing("cube", "blue", 0.5, 0.13), CUBE, 0))
    assert half.lift is not None and half.lift[1] < 0.13 - CUBE / 2


def test_what_is_out_of_reach_offers_nothing() -> None:
    assert first_offer((RED, 0, 0), reach=False) == Offer()


def test_a_limit_takes_the_lift_first_and_then_the_touch() -> None:
    cube = first_offer((RED, 0, 0))
    kept = {limit: in_time([cube, Offer()], limit, 0.1, HOME, 0.01) for limit in range(0, 1500, 5)}
    counts = [(one.touch is not None) + (one.lift is not None) for one, _ in kept.values()]
    assert counts == sorted(counts) and set(counts) == {0, 1, 2}
    assert all(nothing == Offer() for _, nothing in kept.values())
    assert in_time([], 100, 0.1, HOME, 0.01) == []
