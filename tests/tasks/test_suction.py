"""A cup seals on a flat face that is wide enough, and nowhere else."""

from __future__ import annotations

import numpy as np
import pytest

from tasks.suction import seals
from tasks.tabletop import CUBE, INSIDE, OUTSIDE

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
