"""What lies on each cell of a heightmap."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass
class Scene:
    """The objects of one heightmap.

    Attributes:
        names: of the objects.
        cells: ``[H, W]`` int: the object on each cell, −1 where there is none.
        background: the name of what is there then.
        bounds: ``[3][2]``, world metres.
        height: ``[H, W]``, m above the floor of the bounds.
    """

    names: list[str]
    cells: np.ndarray
    background: str
    bounds: Sequence[Sequence[float]]
    height: np.ndarray

    def index(self, pixel: tuple[int, int]) -> int | None:
        """The object on a pixel (row, column); None for the background."""
        found = int(self.cells[pixel])
        return found if found >= 0 else None

    def name(self, pixel: tuple[int, int]) -> str:
        """What a pixel shows, in words."""
        index = self.index(pixel)
        return self.background if index is None else self.names[index]

    def position(self, pixel: tuple[int, int]) -> tuple[float, float, float]:
        """World x, y, z (m) of a pixel's centre."""
        (x0, x1), (y0, y1), (z0, _) = self.bounds
        rows, columns = self.cells.shape
        x, y = x0 + (pixel[1] + 0.5) * (x1 - x0) / columns, y0 + (pixel[0] + 0.5) * (y1 - y0) / rows
        return float(x), float(y), float(z0 + self.height[pixel])
