from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from tasks.agents.aircraft import FOOT_RADIUS, HULL_HALF, HULL_UNDERSIDE
from tasks.blocks import Block
from tasks.overview import CLEARANCE, OVERLAP, SLOW_ABOVE, cell_middles, in_view, prospects, seen_points

BOUNDS = np.array([[-10.5, 10.5], [-10.5, 10.5], [-0.05, 4.0]])
FLAT = Block(4, 3, 30, 3, 2, 1, 0, "red")
GROUND, OPEN = 0, -1


def at(x: float, y: float, z: float, *blocks: Block) -> tuple[int, list[int], float]:
    """What is sure, what may be, and the room, of one point."""
    ahead = prospects(list(blocks), np.array([[x, y, z]]))
    return int(ahead.sure[0]), np.flatnonzero(ahead.may[:, 0]).tolist(), float(ahead.room[0])


def test_tops_and_open_ground_are_sure() -> None:
    assert at(4, 3, 1, FLAT) == (1, [1], pytest.approx(1.0))
    assert at(-4, -3, 0, FLAT)[:2] == (GROUND, [GROUND])
    assert at(0, 0, 0)[:2] == (GROUND, [GROUND])


@pytest.mark.parametrize(
    ("beyond", "expected"),
    [
        (-0.05, (1, [1])),
        (FOOT_RADIUS - OVERLAP - 0.005, (1, [1])),
        (FOOT_RADIUS - OVERLAP + 0.005, (OPEN, [1])),
        (FOOT_RADIUS + CLEARANCE - 0.005, (OPEN, [1])),
        (FOOT_RADIUS + CLEARANCE + 0.005, (OPEN, [GROUND, 1])),
        (HULL_HALF + 0.005, (OPEN, [GROUND, 1])),
        (np.sqrt(2) * HULL_HALF + CLEARANCE + 0.005, (GROUND, [GROUND])),
    ],
    ids=["on the edge", "the foot's edge", "an edge of it", "grazed", "the hull", "its edge", "free"],
)
def test_a_top_counts_as_far_as_a_foot_reaches_it(beyond: float, expected: tuple[int, list[int]]) -> None:
    block = Block(0, 0, 0, 2, 2, 1, 0, "red")
    x = 1 + beyond
    # Sent to the top where the foot reaches it, else to the ground.
    assert at(x, 0, 1 if expected[1] == [1] else 0, block)[:2] == expected


def test_a_descent_that_is_fast_where_it_touches_leaves_it_open() -> None:
    assert at(4, 3, 1 - SLOW_ABOVE + 0.01, FLAT)[0] == 1
    assert at(4, 3, 1 - SLOW_ABOVE - 0.01, FLAT)[:2] == (OPEN, [GROUND, 1])


def test_a_descent_that_grazes_may_end_on_what_lies_near() -> None:
    beside, far = Block(1.5, 0, 0, 1, 1, 0.6, 0, "blue"), Block(2, 0, 0, 1, 1, 0.6, 0, "blue")
    grazed = Block(-0.85, 0, 0, 2, 2, 2, 0, "gray")
    assert at(0.4, 0, 0, grazed, beside)[:2] == (OPEN, [GROUND, 1, 2])
    assert at(0.4, 0, 0, grazed, far)[:2] == (OPEN, [GROUND, 1])
    assert at(0.4, 0, 1.5, grazed, beside)[1] == [], "slow where it touches, and too high for what lies below"


def test_what_lies_too_far_below_the_point_is_never_reached() -> None:
    tall = Block(2.5, 0, 0, 2, 2, 3, 0, "gray")
    assert at(0, 0, 3, tall)[:2] == (OPEN, [])


def test_the_hull_needs_room_beside_what_is_higher() -> None:
    low = Block(0, 0, 0, 1, 1, 1, 0, "red")

    def beside(height: float) -> tuple[int, list[int], float]:
        return at(0.4, 0, 1, low, Block(1.1, 0, 0, 1, 1, height, 0, "gray"))

    assert beside(1 + HULL_UNDERSIDE - 0.15)[0] == 1
    assert beside(1 + HULL_UNDERSIDE + 0.05)[:2] == (OPEN, [1])
    assert beside(1 + HULL_UNDERSIDE + 0.15)[:2] == (OPEN, [])


@given(
    st.floats(0, 35),
    st.floats(0, 360),
    st.tuples(st.floats(-3, 3), st.floats(-3, 3)),
    st.floats(0.01, 0.5),
)
def test_the_highest_point_within_reach_is_that_of_a_dense_search(
    incline: float, yaw: float, place: tuple[float, float], radius: float
) -> None:
    block = Block(0.3, -0.2, yaw, 2.5, 1.8, 2.0, incline, "red")
    angle, share = np.meshgrid(np.linspace(0, 2 * np.pi, 241), np.linspace(0, 1, 41))
    around = radius * share * np.array([np.cos(angle), np.sin(angle)])
    points = around.reshape(2, -1).T + place
    on = points[block.distance(points) <= 0]
    (highest,) = block.highest_within(np.array([place]), np.array([radius]))[0]
    assert len(on) == 0 or block.top_at(on).max() <= highest + 1e-9
    if np.isfinite(highest):
        # A step of the search, up the slope.
        wider = block.highest_within(np.array([place]), np.array([radius + 0.05]))[0, 0]
        assert highest <= wider
        assert len(on) == 0 or highest - block.top_at(on).max() < 0.05


def test_points_are_those_of_the_cells_that_the_camera_saw() -> None:
    # Straight down from 10 m: x to the right, y up in the image; a step of 2 m height on the right.
    depth = torch.full((1, 8, 8, 1), 10_000, dtype=torch.int16)
    depth[:, :, 4:] = 8_000
    depth[:, 0] = 0
    camera = {
        "intrinsic_cv": torch.tensor([[[4.0, 0, 4], [0, 4, 4], [0, 0, 1]]]),
        "extrinsic_cv": torch.tensor([[[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 10]]]),
    }
    bounds = np.array([[-8.0, 8.0], [-8.0, 8.0], [-0.05, 4.0]])
    points = seen_points(depth, camera, bounds, 4.0)
    assert sorted({round(z, 2) for z in points[:, 2]}) == [0.0, 2.0]
    assert set(points[points[:, 2] > 1][:, 0]) == {2.0, 6.0}
    assert len(np.unique(points[:, :2], axis=0)) == len(points) == 16
    # What was seen at depth 0 is the camera itself, above the bounds.
    depth[:, :5] = 0
    assert seen_points(depth, camera, bounds, 4.0)[:, 1].max() == -2.0


def test_a_block_is_in_view_with_a_cell() -> None:
    inside, outside = Block(11.4, 0, 0, 2, 2, 1, 0, "red"), Block(12, 0, 0, 2, 2, 1, 0, "red")
    assert in_view([inside, outside], BOUNDS, 0.25) == [inside]


def test_cells_run_along_x_then_y() -> None:
    cells = cell_middles(np.array([[0.0, 2.0], [0.0, 1.0]]), 0.5)
    assert cells.tolist() == [[x, y] for y in (0.25, 0.75) for x in (0.25, 0.75, 1.25, 1.75)]
