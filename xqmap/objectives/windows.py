"""The receptive-field window around an action: all that the value there, and its gradient, depend on.

The TD loss touches one cell per sample. Without normalisation over the image, Q_k(s, a) depends only on the cells
within the network's radius of a; computed on that window, aligned to the pooling grid and padded where the full map is
padded, value and gradient are the same at a fraction of the cost.
"""

from __future__ import annotations

from typing import Protocol, TypeGuard

import torch
from torch import Tensor, nn

from xqmap.models.qmaps import pad_to_grid

_OVER_THE_IMAGE = (nn.modules.batchnorm._NormBase, nn.GroupNorm, nn.LayerNorm)


class Windowed(Protocol):
    """A network whose value at a cell depends on the cells within ``radius`` of it, on a pooling grid of ``stride``."""

    radius: int
    stride: int


def can_window(network: nn.Module) -> TypeGuard[Windowed]:
    """Whether windows give the full map's values: the network states its radius and stride and never normalises over
    the image.
    """
    stated = isinstance(getattr(network, "radius", None), int) and isinstance(getattr(network, "stride", None), int)
    return stated and not any(isinstance(module, _OVER_THE_IMAGE) for module in network.modules())


def crop(heightmap: Tensor, action: Tensor, radius: int, stride: int) -> tuple[Tensor, Tensor]:
    """Cuts each map down to the window its action depends on.

    Args:
        heightmap: ``[B, C, H, W]``.
        action: ``[B]`` int64, row · W + column.
        radius: cells to each side that matter.
        stride: windows start at multiples of it.

    Returns:
        The windows ``[B, C, h, w]`` and the actions ``[B]`` within them (row · w + column). Where a window would reach
        over the map's edge it is moved inside, so that its edge is the map's.
    """
    columns = heightmap.shape[-1]
    heightmap = pad_to_grid(heightmap, stride)
    wanted = -(-(2 * radius + stride) // stride) * stride
    sizes = [min(wanted, edge) for edge in heightmap.shape[-2:]]
    cells = (action // columns, action % columns)
    starts = [
        ((cell - radius).div(stride, rounding_mode="floor") * stride).clamp(0, edge - size)
        for cell, size, edge in zip(cells, sizes, heightmap.shape[-2:], strict=True)
    ]
    row = starts[0][:, None] + torch.arange(sizes[0], device=action.device)
    column = starts[1][:, None] + torch.arange(sizes[1], device=action.device)
    batch = torch.arange(len(action), device=action.device)[:, None, None]
    windows = heightmap[batch, :, row[:, :, None], column[:, None, :]].permute(0, 3, 1, 2)
    return windows.contiguous(), (cells[0] - starts[0]) * sizes[1] + cells[1] - starts[1]
