"""What can be seen and landed on from above a field of blocks, by exact geometry: for evaluation and perception, never
for the policy.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .blocks import Block

# What a choice needs to be sure of its outcome: the foot this far inside the top's edges, the hull this far from other
# blocks (m).
FOOT_ROOM = 0.2
HULL_ROOM = 0.5


def cell_middles(bounds: np.ndarray, pixel_size: float) -> np.ndarray:
    """``[H · W, 2]``: the middles (world x, y, m) of the cells of ``bounds`` ``[≥2, 2]``, row after row."""
    x, y = (np.arange(low + pixel_size / 2, high, pixel_size) for low, high in bounds[:2])
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def in_view(blocks: list[Block], bounds: np.ndarray, pixel_size: float) -> list[Block]:
    """The blocks that reach into at least one cell of ``bounds``."""
    cells = cell_middles(bounds, pixel_size)
    return [block for block in _near(blocks, bounds, 0.0) if block.distance(cells).min() <= pixel_size / 2]


def best_place(
    blocks: list[Block], bounds: np.ndarray, pixel_size: float, altitude: float, reward: Callable[[Block | None], float]
) -> tuple[float, np.ndarray]:
    """Looks at every cell's middle: what lies there, whether it is hidden from the middle of the view, whether there is
    room.

    Args:
        blocks: of the field.
        bounds: of the view, ``[3, 2]``, m.
        pixel_size: edge of a cell, m.
        altitude: of the eye, m.
        reward: of landing on a block's top, or on the ground (None).

    Returns:
        The highest reward of the cells that are visible and have room for foot (``FOOT_ROOM``) and hull
        (``HULL_ROOM``); of those cells the point ``[3]`` with the most room. 0 and the view's middle if there is none.
    """
    cells, blocks = cell_middles(bounds, pixel_size), _near(blocks, bounds, HULL_ROOM)
    owner, top, room = np.zeros(len(cells), dtype=int), np.zeros(len(cells)), np.full(len(cells), np.inf)
    for i, block in enumerate(blocks, start=1):
        distance = block.distance(cells)
        own = distance <= 0
        owner[own], top[own] = i, block.top_at(cells[own])
        room = np.minimum(room, np.where(own, -distance - FOOT_ROOM, distance - HULL_ROOM))
    points, eye = np.column_stack((cells, top)), np.array([*bounds[:2].mean(1), altitude])
    rewards = np.array([reward(thing) for thing in (None, *blocks)])
    for value in np.unique(rewards)[::-1]:
        cells_of_value = np.flatnonzero((rewards[owner] == value) & (room >= 0))
        hidden = np.zeros(len(cells_of_value), dtype=bool)
        for block in blocks:
            hidden |= block.hides(points[cells_of_value], eye)
        seen = cells_of_value[~hidden]
        if len(seen):
            return float(value), points[seen[room[seen].argmax()]]
    return 0.0, np.array([*eye[:2], 0.0])


def _near(blocks: list[Block], bounds: np.ndarray, margin: float) -> list[Block]:
    """A superset of the blocks that come closer than ``margin`` (m) to ``bounds``."""
    middle, half = bounds[:2].mean(1), (bounds[:2, 1] - bounds[:2, 0]) / 2
    return [block for block in blocks if (np.abs(middle - (block.x, block.y)) < half + block.radius + margin).all()]
