"""A fully convolutional U-Net (Ronneberger et al., 2015) from a heightmap to one value per cell, and the geometry it
sees first.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from xqmap.models.context import GatedHead

# 3 × 3 each, before a pooling and after an upsampling.
CONVS_PER_LEVEL = 2


class LocalGeometry(nn.Module):
    """Turns a raw heightmap into what matters near a cell: colour, height, and the plane that fits its neighbourhood.

    A raw height in metres hides a slope of a few centimetres between cells, so a plain network never learns flatness.
    As HHA encodings of RGB-D images do (Gupta et al., 2014), the stem adds geometry computed from the same heights: for
    each window, the least-squares plane's slope and the residual around it (high at edges), and the height relative to
    the surroundings. All are invariant under turning and mirroring the map. No parameters are learned here.

    Args:
        pixel_size: edge of a cell in metres.
        height_scale: the height (m) that counts as 1.
        plane_windows: odd edge lengths of the plane fits, in cells.
        surroundings: odd edge length, in cells, of the mean that heights are taken relative to.
        slope_scale: the slope (degrees) that counts as 1; slopes are cut at four times it.

    Shapes: ``[B, 4, H, W]`` (0–255 and metres) → ``[B, channels, H, W]``, about unit scale.
    """

    def __init__(
        self, pixel_size: float, height_scale: float, plane_windows: list[int], surroundings: int, slope_scale: float
    ) -> None:
        super().__init__()
        for edge in (*plane_windows, surroundings):
            if edge < 3 or edge % 2 == 0:
                raise ValueError(
                    f"qnet.plane_windows and qnet.surroundings must be odd numbers of cells from 3 on, not {edge}"
                )
        self.pixel_size, self.height_scale, self.slope_scale = pixel_size, height_scale, slope_scale
        self.plane_windows, self.surroundings = list(plane_windows), surroundings
        for edge in self.plane_windows:
            offset = torch.arange(edge, dtype=torch.float32) - edge // 2
            rise = (offset / (edge * offset.square().sum())).expand(edge, edge)
            self.register_buffer(f"plane{edge}", torch.stack((rise, rise.T))[:, None].contiguous(), persistent=False)

    @property
    def radius(self) -> int:
        """How many cells to each side an output cell depends on."""
        return max((*self.plane_windows, self.surroundings)) // 2

    @property
    def channels(self) -> int:
        """Output channels: colour 3, height, relative height, and slope and residual of each plane window."""
        return 5 + 2 * len(self.plane_windows)

    def forward(self, heightmap: Tensor) -> Tensor:
        """``[B, 4, H, W]`` → ``[B, channels, H, W]``, in single precision at least."""
        heightmap = heightmap.to(torch.promote_types(heightmap.dtype, torch.float32))
        color, height = heightmap[:, :3] / 127.5 - 1, heightmap[:, 3:]
        channels = [color, height / self.height_scale, (height - _mean(height, self.surroundings)) / self.height_scale]
        rise = height / self.pixel_size
        for edge in self.plane_windows:
            padded = F.pad(rise, (edge // 2,) * 4, mode="replicate")
            across, down = F.conv2d(padded, getattr(self, f"plane{edge}").to(rise)).square_().chunk(2, dim=1)
            steepness = across + down
            slope = torch.rad2deg(torch.atan(steepness.sqrt())) / self.slope_scale
            # In double precision: the variance is a small difference of large squares.
            exact = padded.double()
            variance = (_box(exact.square(), edge) - _box(exact, edge).square()).to(rise.dtype)
            unexplained = (variance - steepness * (edge**2 - 1) / 12).clamp_min(0)
            # Residuals, in cells, are small numbers: ten times them is of the order of the other channels.
            channels += [slope.clamp_max(4.0), (10 * unexplained.sqrt()).clamp_max(4.0)]
        return torch.cat(channels, dim=1)


def _mean(image: Tensor, edge: int) -> Tensor:
    return _box(F.pad(image, (edge // 2,) * 4, mode="replicate"), edge)


def _box(image: Tensor, edge: int) -> Tensor:
    """Means over ``edge`` × ``edge`` cells, along rows and then along columns."""
    for axis in (-2, -1):
        count = image.shape[axis] - edge + 1
        total = image.narrow(axis, 0, count).clone()
        for start in range(1, edge):
            total += image.narrow(axis, start, count)
        image = total
    return image / edge**2


class UNet(nn.Module):
    """Encoder and decoder with skip connections; no normalisation over the image, so a value depends on the cells
    around its own only.

    Args:
        in_channels: channels of the input.
        width: channels of the first level; each level below has twice as many.
        depth: number of poolings; H and W must be multiples of 2 ** depth.
        context: numbers of a context by which a second head, :attr:`later`, is gated; 0 for none.
        horizon: next decisions that are told apart in what follows, by a third head, :attr:`ahead`.

    Shapes: ``[B, in_channels, H, W]`` → ``[B, 1, H, W]``.
    """

    def __init__(self, in_channels: int, width: int, depth: int, context: int = 0, horizon: int = 0) -> None:
        super().__init__()
        widths = [width * 2**level for level in range(depth + 1)]
        self.depth = depth
        self.encoder = nn.ModuleList(_block(a, b) for a, b in zip([in_channels, *widths[:-1]], widths, strict=True))
        self.decoder = nn.ModuleList(_block(widths[i + 1] + widths[i], widths[i]) for i in reversed(range(depth)))
        self.head = nn.Conv2d(width, 1, kernel_size=1)
        self.later = GatedHead(width, context) if context else None
        self.ahead = GatedHead(width, context, horizon) if context and horizon else None

    def forward(self, image: Tensor) -> Tensor:
        """``[B, in_channels, H, W]`` → ``[B, 1, H, W]``."""
        return self.value(self.features(image))

    def value(self, features: Tensor) -> Tensor:
        """``[B, width, H, W]`` → ``[B, 1, H, W]``: the last step, in full precision: a value near 1 in bfloat16 is only
        good to half a percent.
        """
        with torch.autocast(features.device.type, enabled=False):
            return self.head(features.to(self.head.weight.dtype))

    def following(self, features: Tensor, context: Tensor) -> Tensor:
        """``[B, width, H, W]`` and ``[B, size]`` → ``[B, horizon + 1, H, W]``: what follows, of each of the next
        decisions, and of all after them, which is what is left of the whole: telling apart changes nothing of what is
        learned as a whole.
        """
        assert self.later is not None
        later = self.later(features, context)
        if self.ahead is None:
            return later
        ahead = self.ahead(features.detach(), context.detach())
        return torch.cat((ahead, later - ahead.sum(1, keepdim=True)), 1)

    def features(self, image: Tensor) -> Tensor:
        """``[B, in_channels, H, W]`` → ``[B, width, H, W]``: what the value of each cell is made of."""
        skips = []
        for level, block in enumerate(self.encoder):
            image = block(image if level == 0 else pool(image))
            skips.append(image)
        skips.pop()
        for block in self.decoder:
            skip = skips.pop()
            first, *others = block.children()
            assert isinstance(first, nn.Conv2d)
            image = nn.Sequential(*others)(_upconv(first, image, skip))
        return image


def pool(image: Tensor) -> Tensor:
    """The highest of 2 × 2 cells. Where no gradient is asked for, without noting which they were, which is faster."""
    if image.requires_grad and torch.is_grad_enabled():
        return F.max_pool2d(image, 2)
    rows = torch.maximum(image[..., ::2, :], image[..., 1::2, :])
    return torch.maximum(rows[..., ::2], rows[..., 1::2])


def _upconv(conv: nn.Conv2d, below: Tensor, skip: Tensor) -> Tensor:
    """``conv`` over ``below``, each cell of it made 2 × 2, beside ``skip``; neither the larger map nor the two together
    are ever built.

    A 3 × 3 kernel that slides over doubled cells meets each with its taps 2, 1 + 2, 0 + 1, 0 in turn: a transposed
    convolution.
    """
    kernel, rest = conv.weight.split((below.shape[1], skip.shape[1]), dim=1)
    for axis in (2, 3):
        first, middle, last = kernel.unbind(axis)
        kernel = torch.stack((last, middle + last, first + middle, first), dim=axis)
    doubled = F.conv_transpose2d(below, kernel.transpose(0, 1), stride=2, padding=1)
    return doubled.add_(F.conv2d(skip, rest, conv.bias, padding=1))


def _block(in_channels: int, out_channels: int) -> nn.Sequential:
    layers: list[nn.Module] = []
    for i in range(CONVS_PER_LEVEL):
        layers += [
            nn.Conv2d(in_channels if i == 0 else out_channels, out_channels, 3, padding=1),
            nn.ReLU(inplace=True),
        ]
    return nn.Sequential(*layers)
