"""Turning and mirroring maps: the dihedral group D4, or the half of it that keeps the shape of a map that is not
square.
"""

from __future__ import annotations

from functools import cache

import torch
from torch import Tensor


def elements(rows: int, columns: int) -> int:
    """How many elements of D4 keep the shape of a map: all 8 of a square, else the first 4."""
    return 8 if rows == columns else 4


def transform(image: Tensor, element: int) -> Tensor:
    """Element 0–7 of D4 on ``[..., H, W]``: bit 0 mirrors rows, bit 1 columns, bit 2 transposes (needs H = W)."""
    image = image.flip(_axes(element)) if _axes(element) else image
    return image.transpose(-2, -1) if element & 4 else image


def restore(image: Tensor, element: int) -> Tensor:
    """The inverse of :func:`transform`."""
    image = image.transpose(-2, -1) if element & 4 else image
    return image.flip(_axes(element)) if _axes(element) else image


@cache
def origins(rows: int, columns: int) -> Tensor:
    """``[elements, A]``: which cell of a map, row · W + column, each cell of the map was before each element of D4."""
    cells = torch.arange(rows * columns).view(rows, columns)
    return torch.stack([transform(cells, element).reshape(-1) for element in range(elements(rows, columns))])


@cache
def moved(rows: int, columns: int) -> Tensor:
    """``[elements, A]``: where each cell of a map lies after each element of D4; the inverse of :func:`origins`."""
    return origins(rows, columns).argsort(-1)


def _axes(element: int) -> list[int]:
    return [axis for bit, axis in ((1, -2), (2, -1)) if element & bit]
