from __future__ import annotations

import numpy as np

from tasks.blocks import Block
from tasks.overview import FOOT_ROOM, HULL_ROOM, best_place, in_view

BOUNDS = np.array([[-10.5, 10.5], [-10.5, 10.5], [0.0, 4.0]])
FLAT = Block(4, 3, 30, 3, 2, 1, 0, "red")


def best(*blocks: Block) -> tuple[float, np.ndarray]:
    """Two for a flat colored top, one for any other, a half for the ground."""
    return best_place(
        list(blocks),
        BOUNDS,
        0.25,
        25.0,
        lambda thing: 0.5 if thing is None else 1.0 + (thing.flat and thing.color != "gray"),
    )


def test_the_best_top_is_found_at_its_middle() -> None:
    reward, point = best(FLAT, Block(-4, -3, 0, 3, 3, 2, 20, "blue"))
    assert reward == 2
    assert np.linalg.norm(point[:2] - (FLAT.x, FLAT.y)) < 0.75
    assert point[2] == FLAT.height


def test_open_ground_is_far_from_blocks() -> None:
    reward, point = best()
    assert (reward, point[2]) == (0.5, 0)
    lonely = Block(0, 0, 0, 20.6, 20.6, 1, 0, "gray")
    assert best_place([lonely], BOUNDS, 0.25, 25.0, lambda thing: float(thing is None))[0] == 0, (
        "the strip left is narrower than the hull"
    )


def test_a_sliver_at_the_rim_does_not_count() -> None:
    inside = Block(10.5 + 1.0 - FOOT_ROOM - 0.2, 0, 0, 2, 2, 1, 0, "red")
    sliver = Block(10.5 + 1.0 - FOOT_ROOM, 0, 0, 2, 2, 1, 0, "red")
    assert best(inside)[0] == 2
    assert best(sliver)[0] == 0.5
    assert in_view([inside, sliver], BOUNDS, 0.25) == [inside, sliver]
    assert in_view([Block(12, 0, 0, 2, 2, 1, 0, "red")], BOUNDS, 0.25) == []


def test_a_hidden_top_does_not_count() -> None:
    low = Block(9.4, 0, 0, 1, 1, 0.4, 0, "red")
    tall = Block(7.9, 0, 0, 1, 6, 3.8, 0, "gray")
    assert best(low)[0] == 2
    assert best(low, tall)[0] == 1


def test_a_top_without_room_for_the_hull_does_not_count() -> None:
    def neighbor(x: float) -> Block:
        return Block(x, 0, 0, 2, 2, 1, 20, "gray")

    small = Block(0, 0, 0, 1, 1, 1, 0, "red")
    east, west = neighbor(1 + 0.1 + HULL_ROOM), neighbor(-1 - 0.1 - HULL_ROOM)
    assert best(small)[0] == 2
    assert best(small, east)[0] == 2
    assert best(small, east)[1][0] < 0.1
    assert best(small, neighbor(1 + HULL_ROOM), neighbor(-1 - HULL_ROOM))[0] == 1
    assert best(small, east, west)[0] == 1, "no middle of a cell is within 0.1 m of the block's middle"
