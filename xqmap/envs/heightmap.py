"""From calibrated RGB-D images to one orthographic map of colour and height, and back from its pixels to metres. Pure
torch.

The map follows Ravens (Zeng et al., 2020): a point belongs to the cell ``floor((p - p_min) / pixel_size)``; rows run
along the second world axis, columns along the first; the highest point of a cell wins; height counts from the floor of
the bounds; a cell that no camera saw is 0 high and black. One departure: where cameras disagree, the cell takes the
colour of the point that won the height (Ravens averages the cameras' colours, which bleeds at occlusion edges).
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional as F

# Of one pass: their places, cells and heights fit a core's second-level cache.
_POINTS_IN_CACHE = 2**16
# Where the upper half of a 64-bit number lies, of its two 32-bit ones.
_UPPER = 1 if sys.byteorder == "little" else 0


@dataclass(frozen=True)
class PixelGrid:
    """The workspace cut into square cells.

    Args:
        bounds: ``[3, 2]``: lowest and highest x, y, z in world metres, as nested tuples.
        pixel_size: edge of a cell in metres.
    """

    bounds: tuple[tuple[float, float], tuple[float, float], tuple[float, float]]
    pixel_size: float

    def __init__(self, bounds: Sequence[Sequence[float]] | Tensor, pixel_size: float) -> None:
        rows = tuple((float(low), float(high)) for low, high in bounds)
        if len(rows) != 3 or any(low >= high for low, high in rows):
            raise ValueError(f"bounds must be three (low, high) pairs with low < high, not {rows}")
        if not pixel_size > 0:
            raise ValueError(f"pixel_size must be above 0 m, not {pixel_size}")
        object.__setattr__(self, "bounds", rows)
        object.__setattr__(self, "pixel_size", float(pixel_size))

    @property
    def shape(self) -> tuple[int, int]:
        """``(H, W)``: cells along y and along x."""
        (x0, x1), (y0, y1), _ = self.bounds
        return round((y1 - y0) / self.pixel_size), round((x1 - x0) / self.pixel_size)

    def to_pixel(self, points: Tensor) -> Tensor:
        """World points ``[..., ≥2]`` (m) to the ``[..., 2]`` int64 (row, column) of the cells they lie in; may fall
        outside the map.
        """
        (x0, _), (y0, _), _ = self.bounds
        column = ((points[..., 0] - x0) / self.pixel_size).floor()
        row = ((points[..., 1] - y0) / self.pixel_size).floor()
        return torch.stack((row, column), dim=-1).long()

    def to_point(self, pixel: Tensor, height: Tensor) -> Tensor:
        """Cells ``[..., 2]`` (row, column) with their map heights ``[...]`` (m) to world points ``[..., 3]`` at the
        cells' centres.
        """
        (x0, _), (y0, _), (z0, _) = self.bounds
        x = x0 + (pixel[..., 1] + 0.5) * self.pixel_size
        y = y0 + (pixel[..., 0] + 0.5) * self.pixel_size
        return torch.stack((x, y, height + z0), dim=-1)


def unproject(depth: Tensor, intrinsics: Tensor, camera_to_world: Tensor) -> Tensor:
    """Depth images ``[N, h, w]`` (m along the optical axis) to world points ``[N, h, w, 3]`` (m).

    Camera axes: x right, y down, z forward; pixel (u, v) is the ray through ((u - cx) / fx, (v - cy) / fy, 1).
    """
    across, down, origin = _rays(intrinsics, camera_to_world, *depth.shape[1:])
    return torch.addcmul(origin, depth[:, None], across + down).movedim(1, -1)


def _rays(intrinsics: Tensor, camera_to_world: Tensor, h: int, w: int) -> tuple[Tensor, Tensor, Tensor]:
    """``[N, 3, 1, w]``, ``[N, 3, h, 1]``, ``[N, 3, 1, 1]`` float32: a point is the last + depth · (the first + the
    second).
    """
    u, v = (torch.arange(count, dtype=torch.float64, device=intrinsics.device) for count in (w, h))
    fx, fy, cx, cy = (intrinsics.double()[:, i, j, None] for i, j in ((0, 0), (1, 1), (0, 2), (1, 2)))
    right, below, ahead, origin = camera_to_world.double()[:, :3, :, None].unbind(2)
    across, down = right * ((u - cx) / fx)[:, None], below * ((v - cy) / fy)[:, None] + ahead
    return across[:, :, None].float(), down[..., None].float(), origin[..., None].float()


def heightmap(color: Tensor, depth: Tensor, intrinsics: Tensor, camera_to_world: Tensor, grid: PixelGrid) -> Tensor:
    """Fuses N calibrated RGB-D images into one orthographic map.

    Args:
        color: ``[N, h, w, 3]`` uint8.
        depth: ``[N, h, w]`` metres along the optical axis.
        intrinsics: ``[N, 3, 3]``, pixels.
        camera_to_world: ``[N, 4, 4]``; camera axes x right, y down, z forward.
        grid: the cells to fill.

    Returns:
        ``[4, H, W]`` float32: red, green, blue (0–255) and height (m) above ``grid``'s floor; all 0 where nothing was
        seen.

    Raises:
        ValueError: if the shapes do not belong together.
    """
    if (
        color.shape != (*depth.shape, 3)
        or intrinsics.shape != (len(depth), 3, 3)
        or camera_to_world.shape != (len(depth), 4, 4)
    ):
        raise ValueError(
            "heightmap needs color [N,h,w,3], depth [N,h,w], intrinsics [N,3,3], camera_to_world [N,4,4], not "
            f"{[tuple(t.shape) for t in (color, depth, intrinsics, camera_to_world)]}"
        )
    rows, columns = grid.shape
    (x0, _), (y0, _), (z0, z1) = grid.bounds
    # From world metres to columns and rows, both from 1 on, and metres below the floor: what is kept has numbers up to
    # 0.
    to_grid = torch.diag(torch.tensor([1 / grid.pixel_size, 1 / grid.pixel_size, -1, 1], dtype=torch.float64))
    to_grid[:3, 3] = torch.tensor([1.0, 1, 0]) - to_grid.diagonal()[:3] * torch.tensor(
        [x0, y0, z0], dtype=torch.float64
    )
    count, h, w = depth.shape
    across, down, origin = _rays(intrinsics, to_grid.to(depth.device) @ camera_to_world.double(), h, w)

    # With a border of one cell, where what lies beside the map ends up. Height and point make one number, so that one
    # pass finds the
    # highest point and, among equals, the first: the bits of floats order them as their values do, and negative ones
    # never win.
    best = torch.full(((rows + 2) * (columns + 2),), -1, device=depth.device)
    # Rows of an image after the ones before, in the same memory, which the processor's cache holds.
    size = max(1, _POINTS_IN_CACHE // w) if depth.device.type == "cpu" else h
    last = depth.numel() - 1
    points = torch.empty(3, size, w, device=depth.device)
    cells, ranks = torch.empty(2, size, w, dtype=torch.int64, device=depth.device)
    for i, top in ((i, top) for i in range(count) for top in range(0, h, size)):
        seen = depth[i, top : top + size].float()
        (x, y, z), cell, rank = points[:, : len(seen)], cells[: len(seen)], ranks[: len(seen)]
        torch.add(across[i], down[i, :, top : top + size], out=points[:, : len(seen)])
        for plane, start in zip((x, y, z), origin[i], strict=True):
            torch.addcmul(start, plane, seen, out=plane)
        y.clamp_(0, rows + 1).floor_()
        cell.copy_(x.clamp_(0, columns + 1).floor_().add_(y, alpha=columns + 2).nan_to_num_())
        # Above the ceiling, or no number: as if below the floor.
        F.threshold(z, z0 - z1, 1.0, inplace=True).nan_to_num_(nan=1.0).neg_()
        first = last - (i * h + top) * w
        torch.arange(first, first - seen.numel(), -1, out=rank.view(-1))
        rank.view(torch.int32).view(*rank.shape, 2)[..., _UPPER].copy_(z.view(torch.int32))
        best.scatter_reduce_(0, cell.view(-1), rank.view(-1), "amax")
    best = best.view(rows + 2, columns + 2)[1:-1, 1:-1].reshape(-1)
    point = (last - (best & (2**32 - 1))).clamp_(0)
    fused = torch.empty(4, rows * columns, dtype=torch.float32, device=depth.device)
    fused[:3] = color.reshape(-1, 3)[point].T
    fused[3] = (best >> 32).int().view(torch.float32)
    return fused.masked_fill_(best < 0, 0).view(4, rows, columns)
