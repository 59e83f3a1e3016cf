"""The look of every figure, whatever settings matplotlib was started with.

Colours are Okabe and Ito's, which colour-blind people can tell apart; a component keeps its own everywhere.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import matplotlib
from matplotlib.figure import Figure

PALETTE = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#F0E442", "#000000")
STYLE: Any = {
    "font.size": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 11,
    "figure.dpi": 130,
    "savefig.bbox": "tight",
    "svg.hashsalt": "xqmap",
    # A name is no formula, whatever dollar signs it has.
    "text.parse_math": False,
}


class Picture(Figure):
    """A figure that a notebook shows, whatever backend it has."""

    def _repr_png_(self) -> bytes:
        return rendered(self, "png", dpi=100)


@contextmanager
def drawing(changes: Mapping[str, Any] | None = None) -> Iterator[None]:
    """Lets matplotlib's own defaults hold, and :data:`STYLE` and ``changes`` over them; no backend is needed."""
    settings, defaults = matplotlib.rcParams, matplotlib.rcParamsDefault
    with matplotlib.rc_context():
        for name in defaults:
            if name != "backend":
                settings._set(name, defaults._get(name))
        settings.update(STYLE | (changes or {}))
        yield


def rendered(figure: Figure, kind: str, changes: Mapping[str, Any] | None = None, **options: Any) -> bytes:
    """A figure as a file's content.

    Args:
        figure: what was made within :func:`drawing`.
        kind: ``png`` or ``svg``.
        changes: to :data:`STYLE`.
        options: of :meth:`~matplotlib.figure.Figure.savefig`.
    """
    buffer = io.BytesIO()
    with drawing(changes):
        figure.savefig(buffer, format=kind, **options)
    return buffer.getvalue()
