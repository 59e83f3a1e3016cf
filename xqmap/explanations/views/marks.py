"""Candidates on a map: rings, and labels that keep out of one another's way."""

from __future__ import annotations

import math

from matplotlib.axes import Axes
from matplotlib.patheffects import withStroke

from xqmap.explanations.candidate import SELECTED
from xqmap.explanations.decision import Decision

# Points between the middles of labels and rings, where there is room.
_APART = 14


def mark(decision: Decision, axis: Axes, scale: float) -> None:
    """Rings each candidate's cell, which stays visible, and leads a line to its label, ★ for the selected one.

    Args:
        decision: whose candidates are marked; those of one cell share a label.
        axis: shows a map, its origin at the lower left.
        scale: points of the page to a cell, about.
    """
    cells: dict[tuple[int, int], list[str]] = {}
    for candidate in decision.candidates:
        if candidate.pixel is not None:
            cells.setdefault(candidate.pixel, []).append("★" if candidate.label == SELECTED else candidate.label)
    assert decision.heightmap is not None
    rows, columns = decision.heightmap.shape[-2:]
    taken = [(column * scale, row * scale) for row, column in cells]
    for (row, column), labels in cells.items():
        axis.plot(column, row, "o", ms=11, mfc="none", mec="white", mew=3)
        axis.plot(column, row, "o", ms=11, mfc="none", mec="black", mew=1.1)
        # Towards the middle, so that no label leaves the map, unless something is marked there already.
        x, y = (-13 if column > columns / 2 else 13, -13 if row > rows / 2 else 13)
        places = [(x, y), (x, -y), (-x, y), (-x, -y), (2.5 * x, 0), (0, 2.5 * y), (2.5 * x, y), (x, 2.5 * y)]
        spots = [(column * scale + dx, row * scale + dy) for dx, dy in places]
        inside = [
            all(6 < at < scale * side - 6 for at, side in zip(spot, (columns, rows), strict=True)) for spot in spots
        ]
        free = [min((math.dist(spot, other) for other in taken), default=math.inf) for spot in spots]
        best = max(range(len(places)), key=lambda i: (inside[i], min(free[i], _APART), -i))
        taken.append(spots[best])
        # Lines by themselves, below all labels.
        line = {
            "arrowstyle": "-",
            "lw": 0.9,
            "shrinkB": 5.5,
            "path_effects": [withStroke(linewidth=2.4, foreground="white")],
        }
        axis.annotate("", (column, row), xytext=places[best], textcoords="offset points", zorder=4, arrowprops=line)
        axis.annotate(
            " ".join(labels),
            (column, row),
            xytext=places[best],
            textcoords="offset points",
            ha="center",
            va="center",
            fontsize=11 if "★" in labels else 9,
            zorder=5,
            bbox={"boxstyle": "round,pad=0.2", "fc": "white", "ec": "0.3", "lw": 0.6, "alpha": 0.9},
        )
