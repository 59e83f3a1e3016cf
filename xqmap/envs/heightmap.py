"""From calibrated RGB-D images to one orthographic map of colour and height, and back from its pixels to metres.

The map follows Ravens (Zeng et al., 2020): a point belongs to the cell ``floor((p - p_min) / pixel_size)``; rows run
along the second world axis, columns along the first; the highest point of a cell wins; height counts from the floor of
the bounds; a cell that no camera saw is 0 high and black. One departure: where cameras disagree, the cell takes the
colour of the point that won the height (Ravens averages the cameras' colours, which bleeds at occlusion edges). Of
equally high points that is the first one, camera by camera, row by row.

The same images give the same bits everywhere: rays are computed in double precision and rounded to single; a point is
ray · depth + origin in single precision, rounded after the product and after the sum.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

# Rows and columns of the tiles of an image that are computed, or left out, as a whole.
_ROWS, _COLUMNS = 8, 64
# Of one pass: places, cells and heights of so many points stay in a processor's cache.
_POINTS_IN_CACHE = 2**16
_LOWER_HALF = 2**32 - 1


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
    rays = _rays(_array(intrinsics), _array(camera_to_world), *depth.shape[1:])
    across, down, origin = (torch.from_numpy(np.moveaxis(part, 0, -1)).to(depth.device) for part in rays)
    return (across[:, None] + down[:, :, None]) * depth[..., None] + origin[:, None, None]


def metres(depth: Tensor | np.ndarray, depth_unit: float | None = None) -> Tensor:
    """Depth in float32 metres, whatever type it comes in; holes stay 0, below 0, NaN or infinite.

    Args:
        depth: of any shape. The largest number of an integer type (65535 of uint16) is a hole: it becomes 0.
        depth_unit: metres per number of ``depth``. None: integer types are millimetres, floating-point types metres.

    Raises:
        ValueError: if ``depth`` holds no real numbers, or ``depth_unit`` is none above 0.
    """
    depth = _tensor("depth", depth)
    whole = not depth.is_floating_point()
    if depth_unit is None:
        depth_unit = 0.001 if whole else 1.0
    if isinstance(depth_unit, str) or not 0 < depth_unit < float("inf"):
        raise ValueError(f"depth_unit must be metres per number (0.001 for millimetres), not {depth_unit!r}")
    found = depth.float()
    if whole:
        found = F.threshold(-found, -float(torch.iinfo(depth.dtype).max), 0.0).neg_()
    return found if depth_unit == 1 else found / (1 / depth_unit)


@contextmanager
def _one_thread() -> Iterator[None]:
    """On a processor, passes are so short that threads which wait for each other cost more than they save."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


@_one_thread()
def heightmap(
    color: Tensor | np.ndarray,
    depth: Tensor | np.ndarray,
    intrinsics: Tensor | np.ndarray,
    camera_to_world: Tensor | np.ndarray,
    grid: PixelGrid,
    depth_unit: float | None = None,
) -> Tensor:
    """Fuses N calibrated RGB-D images into one orthographic map.

    Args:
        color: ``[N, h, w, 3]`` uint8.
        depth: ``[N, h, w]`` along the optical axis: integer types in millimetres, floating-point types in metres. Holes
            are 0, below 0, NaN, infinite, or the largest number of an integer type.
        intrinsics: ``[N, 3, 3]``, pixels.
        camera_to_world: ``[N, 4, 4]``, metres; camera axes x right, y down, z forward.
        grid: the cells to fill.
        depth_unit: metres per number of ``depth``, where its type does not say it.

    Returns:
        ``[4, H, W]`` float32: red, green, blue (0–255) and height (m) above ``grid``'s floor; all 0 where nothing was
        seen.

    Raises:
        ValueError: if shapes or types are others, or the calibration is none.
    """
    named = {"color": color, "depth": depth, "intrinsics": intrinsics, "camera_to_world": camera_to_world}
    color, depth, intrinsics, camera_to_world = given = [_tensor(name, part) for name, part in named.items()]
    count, h, w = depth.shape if depth.dim() == 3 else (0, 0, 0)
    shapes = [(count, h, w, 3), (count, h, w), (count, 3, 3), (count, 4, 4)]
    if not depth.numel() or [tuple(part.shape) for part in given] != shapes or color.dtype != torch.uint8:
        raise ValueError(
            "heightmap needs color [N,h,w,3] uint8, depth [N,h,w] (integers: mm, floats: m), intrinsics [N,3,3], "
            "camera_to_world [N,4,4], not "
            + ", ".join(f"{name} {[*part.shape]} {part.dtype}" for name, part in zip(named, given, strict=True))
        )
    found, padding = metres(depth, depth_unit), (0, -w % _COLUMNS, 0, -h % _ROWS)
    found = F.pad(found, padding) if any(padding) else found.contiguous()
    height, width = found.shape[1:]
    (x0, _), (y0, _), (z0, z1) = grid.bounds
    # From camera axes to columns and rows, both counted from 1 on, and metres above the floor.
    pose = _array(camera_to_world)[:, :3].copy()
    pose[:, :, 3] -= x0, y0, z0
    pose[:, :2] /= grid.pixel_size
    pose[:, :2, 3] += 1
    rays = _rays(_array(intrinsics), pose, height, width)
    if not all(np.isfinite(part).all() for part in rays):
        raise ValueError(
            "intrinsics and camera_to_world must be finite, and fx and fy not 0: the calibration is broken"
        )
    best, least = _highest(found, rays, grid.shape, z1 - z0)
    seen = best >= least
    point = (~best).bitwise_and_(_LOWER_HALF)
    if any(padding):
        row, u = point // width, point % width
        point = (row // height * h + row % height) * w + u
    fused = torch.empty(4, best.numel(), device=depth.device)
    fused[:3] = color.reshape(-1, 3).index_select(0, point).T
    fused[:3] *= seen
    fused[3] = best.sub_(least).bitwise_right_shift_(32).clamp_(0).int().view(torch.float32)
    return fused.view(4, *grid.shape)


def _tensor(name: str, numbers: Any) -> Tensor:
    """What torch can compute with, from real numbers in any order of bytes and strides; not copied where it need not.

    Raises:
        ValueError: if they are no real numbers.
    """
    if not isinstance(numbers, Tensor):
        array = np.asarray(numbers)
        if array.dtype.kind not in "iuf" or array.dtype.itemsize > 8:
            raise ValueError(
                f"{name} must be integers (depth: mm) or floats (depth: m) of at most 64 bits, not {array.dtype}"
            )
        numbers = torch.from_numpy(np.require(array, array.dtype.newbyteorder("="), ["C", "W"]))
    if numbers.dtype == torch.bool or numbers.is_complex():
        raise ValueError(f"{name} must be integers (depth: mm) or floats (depth: m), not {numbers.dtype}")
    return numbers.detach()


def _array(numbers: Tensor) -> np.ndarray:
    return numbers.detach().cpu().double().numpy()


def _rays(intrinsics: np.ndarray, pose: np.ndarray, h: int, w: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """``[3, N, w]``, ``[3, N, h]``, ``[3, N]`` float32: a point is the last + depth · (the first + the second)."""
    fx, fy, cx, cy = (intrinsics[:, i, j, None] for i, j in ((0, 0), (1, 1), (0, 2), (1, 2)))
    right, below, ahead, origin = np.moveaxis(pose[:, :3], (2, 1), (0, 1))[..., None]
    with np.errstate(all="ignore"):
        across = (right * ((np.arange(w) - cx) / fx)).astype(np.float32)
        down = (below * ((np.arange(h) - cy) / fy) + ahead).astype(np.float32)
        # 0 is added so that there is no −0, whose bits are those of a negative number.
        return across, down, origin[..., 0].astype(np.float32) + np.float32(0)


def _in_bounds(depth: Tensor, rays: tuple[np.ndarray, ...], low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """``[N, H / tile, W / tile]`` bool: the tiles of ``depth`` of which a point may lie between ``low`` and ``high``
    (``[3]``).

    Interval arithmetic over a tile's outermost rays and depths; since rounding keeps order, no point gets lost.
    """
    count, h, w = depth.shape
    near, far = (
        reduce(reduce(depth.view(count, -1, _ROWS, w), 2).view(count, h // _ROWS, -1, _COLUMNS), 3).cpu().numpy()
        for reduce in (torch.amin, torch.amax)
    )
    across, down, origin = rays
    across = np.sort((across[..., ::_COLUMNS], across[..., _COLUMNS - 1 :: _COLUMNS]), axis=0)[:, :, :, None]
    down = np.sort((down[..., ::_ROWS], down[..., _ROWS - 1 :: _ROWS]), axis=0)[..., None]
    with np.errstate(all="ignore"):
        reach = np.concatenate(((across + down) * near, (across + down) * far)) + origin[..., None, None]
        beside = (reach.max(0) < low[:, None, None, None]) | (reach.min(0) >= high[:, None, None, None])
    # A tile with NaN among its depths is neither beside nor between.
    return ~beside.any(0)


@lru_cache(maxsize=2)
def _memory(device: torch.device, thread: int) -> tuple[Tensor, Tensor, Tensor]:
    """What a pass computes in, kept from one to the next: memory that is new to a process takes longer than a pass."""
    shape = _POINTS_IN_CACHE // _COLUMNS, _COLUMNS
    reals = torch.empty(4, *shape, device=device)
    cells, longs = (torch.empty(2, *shape, dtype=kind, device=device) for kind in (torch.int32, torch.int64))
    return reals, cells, longs


def _highest(depth: Tensor, rays: tuple[np.ndarray, ...], shape: tuple[int, int], ceiling: float) -> tuple[Tensor, int]:
    """The highest point of every cell.

    Args:
        depth: ``[N, H, W]`` float32 metres, in whole tiles.
        rays: to (column, row, height), columns and rows counted from 1 on.
        shape: rows and columns of the map.
        ceiling: height from which on a point is out of bounds, m.

    Returns:
        ``[cells]`` int64 and its least value for a cell that was seen. A value less that one is the bits of the height
        in the upper half; the lower half counts down from its largest number to the point's place in ``depth``.
    """
    rows, columns = shape
    count, height, width = depth.shape
    high = np.array((columns + 1, rows + 1, ceiling), dtype=np.float32)
    inside = _in_bounds(depth, rays, np.array((1, 1, 0), dtype=np.float32), high)
    # The rows of those tiles, with the rays of each.
    across_row = width // _COLUMNS
    line = np.flatnonzero(np.broadcast_to(inside[:, :, None], (count, height // _ROWS, _ROWS, across_row)))
    row = line // across_row
    image = row // height
    tables = (
        rays[0].reshape(3, -1, _COLUMNS),
        rays[1].reshape(3, -1).take(row, 1)[..., None],
        rays[2].take(image, 1)[..., None],
        line - (row - image) * across_row,
        line,
        _LOWER_HALF - line[:, None] * _COLUMNS,
    )
    across, down, origin, column, place, last = (torch.from_numpy(table).to(depth.device) for table in tables)

    # Height and point make one number, so that one pass finds the highest point and, of equals, the first. The bits of
    # heights from 0 on are in the heights' order. With this added, and wrap-around, those below the ceiling are the
    # largest there are: what is too low, too high, infinite or no number comes below them.
    added = 2**31 - int(high[2:].view(np.int32)[0])
    # With a border of one cell, where what lies beside the map ends up.
    best = torch.full(((rows + 2) * (columns + 2),), (added << 32) - 1, device=depth.device)
    lane = torch.arange(_COLUMNS, device=depth.device)
    reals, cells, longs = _memory(depth.device, threading.get_ident())
    size = reals.shape[1]
    for start in range(0, len(line), size):
        some = slice(start, start + size)
        few = len(line[some])
        points, found, (x, y), (cell, rank) = reals[:3, :few], reals[3, :few], cells[:, :few], longs[:, :few]
        torch.index_select(depth.view(-1, _COLUMNS), 0, place[some], out=found)
        # Holes are infinitely far away: out of bounds.
        F.threshold(found, 0.0, float("inf"), inplace=True)
        torch.index_select(across, 1, column[some], out=points)
        points.add_(down[:, some]).mul_(found).add_(origin[:, some])
        cells[:, :few].copy_(points[:2])
        cell.copy_(x.clamp_(0, columns + 1).add_(y.clamp_(0, rows + 1), alpha=columns + 2))
        rank.copy_(points[2].view(torch.int32).add_(added))
        rank.bitwise_left_shift_(32).bitwise_or_(last[some]).bitwise_xor_(lane)
        best.scatter_reduce_(0, cell.reshape(-1), rank.reshape(-1), "amax")
    return best.view(rows + 2, columns + 2)[1:-1, 1:-1].reshape(-1), added << 32
