"""What an object on the table offers to a cup that comes straight down on it, by exact geometry: for evaluation, never
for the policy. Lengths in metres.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import sapien

from .primitives import steps_needed
from .suction import RIM_RADIUS, cast, rim, seals
from .tabletop import RADIUS, Thing, pose_of

# Higher than anything that lies on the table.
ABOVE = 1.0
# What of the cup meets a surface first, seen from above: its middle or its rim.
CUP = np.vstack((np.zeros((1, 2)), rim()[:, :2]))


@dataclass(frozen=True)
class Offer:
    """The best that a pick can make of one object.

    Attributes:
        touch: ``[3]``: a point where the cup meets this object before any other; None where there is none.
        lift: ``[3]``: one where it can be lifted, too.
    """

    touch: np.ndarray | None = None
    lift: np.ndarray | None = None

    @property
    def point(self) -> np.ndarray | None:
        """Where it pays most."""
        return self.touch if self.lift is None else self.lift


def surface(kind: str, pose: np.ndarray, places: np.ndarray) -> np.ndarray:
    """``[N]``: z of a body at ``pose`` ``[4, 4]``, seen from above at ``places`` ``[N, 2]``; −inf beside it."""
    origins = np.column_stack((places, np.full(len(places), ABOVE)))
    return ABOVE - cast(kind, pose, origins, np.array([0.0, 0.0, -1.0])).distance


def offer(
    built: sapien.Entity,
    things: Mapping[sapien.Entity, Thing],
    cells: tuple[np.ndarray, np.ndarray],
    reachable: Callable[[np.ndarray], np.ndarray],
    seal: str,
) -> Offer:
    """Looks for the best place on one object, from its middle outwards.

    Args:
        built: the object.
        things: all objects, any of which may be in the way.
        cells: ``[W]`` and ``[H]``: the middles of the map's columns (world x) and rows (world y).
        reachable: whether the cup gets to the points ``[M, 3]``.
        seal: ``"rim"``: where the cup's rim lies on a cube it lifts it; ``"touch"``: wherever it touches one.
    """
    kind, pose = things[built].kind, pose_of(built)
    others = [(thing.kind, pose_of(entity)) for entity, thing in things.items() if entity is not built]
    x, y = (axis[np.abs(axis - middle) < RADIUS[kind]] for axis, middle in zip(cells, pose[:2, 3], strict=True))
    places = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    touch = None
    for place in places[np.hypot(*(places - pose[:2, 3]).T).argsort()]:
        height = surface(kind, pose, place + CUP).max()
        point = np.append(place, height)
        if not np.isfinite(height) or not reachable(point[None])[0]:
            continue
        beside = (body for body in others if np.hypot(*(body[1][:2, 3] - place)) < RADIUS[body[0]] + RIM_RADIUS)
        if any(surface(*body, place + CUP).max() >= height for body in beside):
            continue
        touch = point if touch is None else touch
        if kind != "cube":
            break
        if seal == "touch" or seals(kind, pose, _pointing_down(point)):
            return Offer(touch, point)
    return Offer(touch)


def in_time(offers: list[Offer], limit: float, hover: float, home: np.ndarray, period: float) -> list[Offer]:
    """What is left of offers if a pick may take ``limit`` control steps; the other arguments are those of
    :func:`.primitives.steps_needed`.
    """
    points = np.array([np.full(3, np.nan) if one.point is None else one.point for one in offers]).reshape(-1, 3)
    return [
        Offer() if touched > limit else Offer(one.touch) if whole > limit else one
        for one, touched, whole in zip(offers, *steps_needed(points, hover, home, period), strict=True)
    ]


def _pointing_down(point: np.ndarray) -> np.ndarray:
    tcp = np.diag([1.0, -1.0, -1.0, 1.0])
    tcp[:3, 3] = point
    return tcp
