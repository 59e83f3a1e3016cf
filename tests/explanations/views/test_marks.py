"""Where labels stand on a map, and how large differences look."""

from __future__ import annotations

import math

import numpy as np
import pytest
from matplotlib.figure import Figure

from xqmap.explanations import Candidate, Decision
from xqmap.explanations.views import plots
from xqmap.explanations.views.marks import mark

SCALE = 4.0


@pytest.mark.parametrize("corner", [(0, 0), (0, 29), (59, 0), (59, 29), (30, 15)])
def test_labels_of_neighbouring_cells_stand_apart_and_on_the_map(corner: tuple[int, int]) -> None:
    row, column = corner
    beside = (row, column + 1 if column < 29 else column - 1)
    pixels = {"Selected": corner, "A": corner, "B": beside}
    candidates = [Candidate(name, "thing", {"a": 1.0, "b": 1.0}, pixel) for name, pixel in pixels.items()]
    axis = Figure().subplots()
    mark(Decision("toy", ("a", "b"), candidates, heightmap=np.ones((4, 60, 30))), axis, SCALE)
    # Cells that are shared have one label.
    labels = [text for text in axis.texts if text.get_text()]
    assert [text.get_text() for text in labels] == ["★ A", "B"]
    at = [(text.xy[0] * SCALE + text.xyann[0], text.xy[1] * SCALE + text.xyann[1]) for text in labels]  # type: ignore[attr-defined]
    assert math.dist(*at) >= 14
    assert all(0 < x < 30 * SCALE and 0 < y < 60 * SCALE for x, y in at)


def test_differences_that_are_nothing_beside_the_values_look_like_it() -> None:
    candidates = [Candidate(name, "thing", {"a": value, "b": 1.0}) for name, value in (("Selected", 1.0), ("A", 0.999))]
    low, high = plots.rdx(Decision("toy", ("a", "b"), candidates)).axes[0].get_ylim()
    assert low <= -0.25 and high >= 0.25
