"""What can be seen and landed on from above a field of blocks: for evaluation and perception, never for the policy.
Lengths in metres.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch

from .agents.aircraft import FOOT_RADIUS, HULL_HALF, HULL_UNDERSIDE
from .blocks import Block
from .flight import SLOW_BELOW

# A contact is sure to happen with what reaches this far under foot or hull, and sure not to with what stays farther
# away: a fast descent is pushed off by what it passes closely.
OVERLAP, CLEARANCE = 0.01, 0.03
# Of two contacts the higher one is sure to be the first if it is this much higher: a simulation step of a fast descent.
TIE = 0.1
# A descent is slow where it touches at most this far above the point it was sent to, and touches what lies at most this
# far below.
SLOW_ABOVE, BELOW = 0.75, SLOW_BELOW - 0.1
# What a fast descent grazes may push it aside this far at most (measured: 0.45), with no contact that counts.
PUSHED = 0.6


def cell_middles(bounds: np.ndarray, pixel_size: float) -> np.ndarray:
    """``[H · W, 2]``: the middles (world x, y) of the cells of ``bounds`` ``[≥2, 2]``, row after row."""
    x, y = (np.arange(low + pixel_size / 2, high, pixel_size) for low, high in bounds[:2])
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def in_view(blocks: list[Block], bounds: np.ndarray, pixel_size: float) -> list[Block]:
    """The blocks that reach into at least one cell of ``bounds``."""
    cells = cell_middles(bounds, pixel_size)
    return [block for block in near(blocks, bounds, 0.0) if block.distance(cells).min() <= pixel_size / 2]


def near(blocks: list[Block], bounds: np.ndarray, margin: float) -> list[Block]:
    """A superset of the blocks that come closer than ``margin`` to ``bounds``."""
    middle, half = bounds[:2].mean(1), (bounds[:2, 1] - bounds[:2, 0]) / 2
    return [block for block in blocks if (np.abs(middle - (block.x, block.y)) < half + block.radius + margin).all()]


def seen_points(
    image: torch.Tensor, camera: Mapping[str, torch.Tensor], bounds: np.ndarray, pixel_size: float
) -> np.ndarray:
    """The points that can be chosen: above the middle of each cell in which the camera saw anything, as high as the
    highest it saw there.

    Args:
        image: ``[1, h, w, 1]`` int16, mm along the optical axis.
        camera: ManiSkill's ``intrinsic_cv`` ``[1, 3, 3]`` (pixels) and ``extrinsic_cv`` ``[1, ≥3, 4]`` (world to
            camera, whose axes are x right, y down, z forward).
        bounds: ``[3, 2]``, world.
        pixel_size: edge of a cell.

    Returns:
        ``[M, 3]``, world; heights are rounded to half precision above the floor, as maps store them.
    """
    depth = image[0, ..., 0].numpy() / 1000
    intrinsic, extrinsic = (camera[name][0].numpy() for name in ("intrinsic_cv", "extrinsic_cv"))
    u, v = (
        (np.arange(count) - middle) / focal
        for count, middle, focal in zip(depth.shape[::-1], intrinsic[:2, 2], intrinsic.diagonal(), strict=False)
    )
    right, below, ahead = extrinsic[:3, :3]
    rays = (right[:, None] * u)[:, None] + (below[:, None] * v + ahead[:, None])[..., None]
    points = (rays * depth - (extrinsic[:3, 3] @ extrinsic[:3, :3])[:, None, None]).reshape(3, -1)
    points = points[:, ((points >= bounds[:, :1]) & (points < bounds[:, 1:])).all(0)]
    middles = cell_middles(bounds, pixel_size)
    columns = round((bounds[0, 1] - bounds[0, 0]) / pixel_size)
    column, row = ((points[:2] - bounds[:2, :1]) / pixel_size).astype(int)
    heights = np.full(len(middles), -np.inf)
    np.maximum.at(heights, row * columns + column, points[2] - bounds[2, 0])
    seen = np.isfinite(heights)
    return np.column_stack((middles[seen], heights[seen].astype(np.float16).astype(float) + bounds[2, 0]))


@dataclass(frozen=True)
class Prospects:
    """What is touched first by an aircraft that comes straight down at each of ``M`` points. Thing 0 is the ground,
    thing i the i-th block.

    Attributes:
        sure: ``[M]``: the thing that the foot is sure to touch first, slowly; -1 where that is not sure.
        may: ``[1 + blocks, M]`` bool: whether the foot may touch the thing first.
        room: ``[M]``: how far it is to the nearest edge of a block.
    """

    sure: np.ndarray
    may: np.ndarray
    room: np.ndarray


def prospects(blocks: list[Block], points: np.ndarray) -> Prospects:
    """By geometry alone: where edges are too close to say, or the descent is fast, only the physics knows.

    Args:
        blocks: of the field, that come near any of the points.
        points: ``[M, 3]``, that an aircraft is sent to.
    """
    # The least and the most that can touch, of a foot (then of one that was pushed aside) and of a hull: a square lies
    # between two circles.
    foot_radii = FOOT_RADIUS - OVERLAP, FOOT_RADIUS + CLEARANCE
    hull_radii = HULL_HALF - OVERLAP, np.sqrt(2) * HULL_HALF + CLEARANCE
    radii = np.array([*foot_radii, PUSHED + foot_radii[1], *hull_radii])
    foot = np.full((3, 1 + len(blocks), len(points)), -np.inf)
    foot[:, 0] = 0.0
    hull = np.full((2, len(points)), -np.inf)
    room = np.full(len(points), np.inf)
    for i, block in enumerate(blocks, start=1):
        here = np.flatnonzero(np.hypot(*(points[:, :2] - (block.x, block.y)).T) < block.radius + 1.0)
        highest = block.highest_within(points[here], radii)
        foot[:, i, here] = highest[:3]
        hull[:, here] = np.maximum(hull[:, here], highest[3:] - HULL_UNDERSIDE)
        room[here] = np.minimum(room[here], np.abs(block.distance(points[here])))
    # By this height there has been a contact.
    latest = np.maximum(foot[0].max(0), hull[0])
    lowest = points[:, 2] - SLOW_BELOW - TIE
    grazes = np.maximum(foot[1].max(0), hull[1]) > points[:, 2] + SLOW_BELOW - TIE
    may = (foot[1] >= latest - TIE) & (foot[1] > lowest) | (foot[2] > lowest) & grazes
    first, every = foot[0].argmax(0), np.arange(len(points))
    height = foot[0, first, every]
    foot[1, first, every] = -np.inf
    alone = height > np.maximum(foot[1].max(0), hull[1]) + TIE
    slow = (height <= points[:, 2] + SLOW_ABOVE) & (height >= points[:, 2] - BELOW)
    return Prospects(np.where(alone & slow, first, -1), may, room)
