"""A cup seals on a flat face that is wide enough, and nowhere else."""

from __future__ import annotations

import numpy as np
import pytest

from tasks.suction import seals
from tasks.tabletop import CUBE, INSIDE, OUTSIDE, Thing, sample_layout

DOWN = np.diag([1.0, -1.0, -1.0, 1.0])


def cup(x: float, y: float, z: float, tilt_deg: float = 0.0) -> np.ndarray:
    """The cup's rim at a point, its axis straight down or tilted around y."""
    angle = np.deg2rad(tilt_deg)
    pose = np.eye(4)
    pose[:3, :3] = (
        np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]) @ DOWN[:3, :3]
    )
    pose[:3, 3] = x, y, z
    return pose


@pytest.mark.parametrize(
    ("kind", "place", "tilt", "held"),
    [
        ("cube", (0.0, 0.0, CUBE), 0.0, True),
        ("cube", (0.008, 0.008, CUBE), 0.0, True),
        ("cube", (0.0, 0.0, CUBE), 5.0, True),
        ("cube", (0.0, 0.0, CUBE), 30.0, False),
        ("cube", (0.015, 0.0, CUBE), 0.0, False),
        ("cube", (0.0, 0.0, CUBE + 0.02), 0.0, False),
        ("cube", (0.1, 0.0, 0.0), 0.0, False),
        ("bowl", (0.04, 0.0, float(np.interp(0.04, *INSIDE.T))), 0.0, False),
        ("bowl", (0.056, 0.0, float(OUTSIDE[-1, 1])), 0.0, False),
        ("bowl", (0.0, 0.02, float(np.interp(0.02, *INSIDE.T))), 0.0, False),
    ],
    ids=[
        "face",
        "off centre",
        "a little tilted",
        "much tilted",
        "edge",
        "above",
        "beside",
        "bowl inside",
        "bowl rim",
        "bowl floor",
    ],
)
def test_where_the_cup_seals(kind: str, place: tuple[float, float, float], tilt: float, held: bool) -> None:
    assert seals(kind, np.eye(4), cup(*place, tilt)) is held


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
