"""What lies on the whole map, as a few numbers, and a value that depends on it: how much can still follow a decision is
not to be seen around its cell.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

# Edge of the cells that are taken together first, and channels of the first convolution.
_POOLED, _WIDTH = 2, 16
# An object's cells, summed up, count to about 1.
_CELLS_OF_AN_OBJECT = 4.0


class Context(nn.Module):
    """Counts what stands up: only cells above ``raised_height`` are looked at, by convolutions without bias, so that
    the bare ground adds exactly nothing and every object its own share; these are summed up, and the strongest noted.

    Args:
        size: how many numbers.
        height_scale: the height (m) that counts as 1.
        raised_height: height over the map's floor, m, above which something stands up.

    Shapes: ``[B, 4, H, W]`` (0–255 and metres) → ``[B, size]``.
    """

    def __init__(self, size: int, height_scale: float, raised_height: float) -> None:
        super().__init__()
        self.size, self.height_scale, self.raised_height = size, height_scale, raised_height
        self.convolutions = nn.Sequential(
            nn.Conv2d(4, _WIDTH, 3, stride=2, padding=1, bias=False),
            nn.ReLU(inplace=True),
            nn.Conv2d(_WIDTH, 2 * _WIDTH, 3, stride=2, padding=1, bias=False),
            nn.ReLU(inplace=True),
            nn.Conv2d(2 * _WIDTH, 2 * _WIDTH, 3, padding=1, bias=False),
            nn.ReLU(inplace=True),
        )
        self.numbers = nn.Linear(4 * _WIDTH, size)

    def forward(self, heightmap: Tensor) -> Tensor:
        """``[B, 4, H, W]`` → ``[B, size]``, in full precision: what is counted differs by little."""
        with torch.autocast(heightmap.device.type, enabled=False):
            image = heightmap.to(self.numbers.weight.dtype)
            color, height = image[:, :3] / 127.5 - 1, image[:, 3:]
            raised = torch.cat((color, height / self.height_scale), 1) * (height > self.raised_height)
            seen = self.convolutions(F.avg_pool2d(raised, _POOLED))
            return F.relu(self.numbers(torch.cat((seen.sum((2, 3)) / _CELLS_OF_AN_OBJECT, seen.amax((2, 3))), 1)))


class GatedHead(nn.Module):
    """A value of each cell's features, gated by a context: features are scaled and shifted by it (FiLM, Perez et al.,
    2018) before the last layer. Added to the value it would give every cell the same future, also one after which
    nothing comes.

    Args:
        width: channels of the features.
        size: numbers of the context.
        parts: values of each cell.
        hidden: features that are gated.

    Shapes: ``[B, width, H, W]`` and ``[B, size]`` → ``[B, parts, H, W]``.
    """

    def __init__(self, width: int, size: int, parts: int = 1, hidden: int = 16) -> None:
        super().__init__()
        self.mix = nn.Conv2d(width, hidden, kernel_size=1)
        self.gate = nn.Linear(size, 2 * hidden)
        self.value = nn.Conv2d(hidden, parts, kernel_size=1)
        # At first nearly open.
        nn.init.normal_(self.gate.weight, std=0.05)
        nn.init.zeros_(self.gate.bias)

    def forward(self, features: Tensor, context: Tensor) -> Tensor:
        """In full precision, as :meth:`~xqmap.models.unet.UNet.value`."""
        with torch.autocast(features.device.type, enabled=False):
            scale, shift = self.gate(context)[..., None, None].chunk(2, 1)
            mixed = self.mix(features.to(self.mix.weight.dtype))
            return self.value(F.relu(mixed * (1 + scale) + shift))
