"""Turning and mirroring maps: the dihedral group D4, or the half of it that keeps the shape of a map that is not
square.
"""

from __future__ import annotations

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


def _axes(element: int) -> list[int]:
    return [axis for bit, axis in ((1, -2), (2, -1)) if element & bit]
