"""The receptive cone of an action: of every layer the cells that its value depends on, and no others.

The TD loss touches one cell per sample. Without normalisation over the image, Q_k(s, a) depends only on the cells
around a, on fewer of them from layer to layer. Computed on those, value and gradient are the full map's at a fraction
of the cost. What a layer's padding adds around the map is zero, so whatever a cone holds outside the map is set to zero
after each convolution.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TypeGuard

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from xqmap.data.symmetry import elements, moved, transform
from xqmap.models.qmaps import QMaps, pad_to_grid, values_at
from xqmap.models.unet import UNet, pool


@dataclass(frozen=True, eq=False)
class Region:
    """A square of cells of one level of the U-Net, elsewhere for each sample; it may reach over the level's map.

    Attributes:
        start: ``[B, 2]`` int64, its first row and column.
        size: rows, and columns.
        edges: rows and columns of the level's map.
    """

    start: Tensor
    size: int
    edges: tuple[int, int]

    def grown(self, by: int) -> Region:
        """With ``by`` more cells at each side."""
        return Region(self.start - by, self.size + 2 * by, self.edges)

    def parents(self) -> Region:
        """The cells of the next coarser level that these are part of, wherever they begin."""
        rows, columns = self.edges
        return Region(self.start.div(2, rounding_mode="floor"), self.size // 2 + 1, (rows // 2, columns // 2))

    def children(self) -> Region:
        """The cells of the next finer level that are part of these."""
        rows, columns = self.edges
        return Region(2 * self.start, 2 * self.size, (2 * rows, 2 * columns))

    @cached_property
    def cells(self) -> Tensor:
        """``[B, 2, size]``: the rows and the columns."""
        return self.start[..., None] + torch.arange(self.size, device=self.start.device)

    @cached_property
    def inside(self) -> Tensor:
        """``[B, 1, size, size]``: 1 for the cells of the map, 0 for those beyond."""
        edges = torch.tensor(self.edges, device=self.start.device)[:, None]
        rows, columns = ((self.cells >= 0) & (self.cells < edges)).float().unbind(1)
        return (rows[:, :, None] * columns[:, None, :])[:, None]


class Cone:
    """The cells of every layer of a U-Net that its value at one cell of each sample depends on.

    Args:
        unet: any of the Q-Maps' U-Nets, which are alike.
        cell: ``[B, 2]`` int64, rows and columns.
        edges: rows and columns of the map, multiples of ``2 ** unet.depth``.

    Attributes:
        encoder: for each block, finest level first, what it reads and what each of its convolutions gives.
        decoder: for each block, coarsest level first, the same.
    """

    def __init__(self, unet: UNet, cell: Tensor, edges: tuple[int, int]) -> None:
        self.encoder: list[list[Region]] = []
        self.decoder: list[list[Region]] = []
        needed = Region(cell, 1, edges)
        for block in reversed(unet.decoder):
            self.decoder.insert(0, _widened(block, needed))
            needed = self.decoder[0][0].parents()
        for block in reversed(unet.encoder):
            self.encoder.insert(0, _widened(block, needed))
            needed = self.encoder[0][0].children()

    @property
    def base(self) -> Region:
        """What the first layer reads."""
        return self.encoder[0][0]

    def features(self, unet: UNet, image: Tensor) -> Tensor:
        """``[B, width]``: what ``unet.features`` has at the cell, which ``unet.head`` makes a value of.

        Args:
            unet: one like that the cone was made for.
            image: ``[B, C, n, n]``, the cells of :attr:`base`, 0 beyond the map.
        """
        finer: list[tuple[Tensor, Region]] = []
        for block, regions in zip(unet.encoder, self.encoder, strict=True):
            image = _activated(pool(finer[-1][0]), regions[0]) if finer else image
            finer.append((_convolved(block, image, regions), regions[-1]))
        image, held = finer.pop()
        for block, regions in zip(unet.decoder, self.decoder, strict=True):
            skip, beside = finer.pop()
            cells = regions[0].cells
            doubled = _taken(_activated(image, held), cells.div(2, rounding_mode="floor") - held.start[..., None])
            skip = _activated(_taken(skip, cells - beside.start[..., None]), regions[0])
            image, held = _convolved(block, torch.cat((doubled, skip), 1), regions), regions[-1]
        return _activated(image, held)[..., 0, 0]


def has_cone(network: nn.Module) -> TypeGuard[QMaps]:
    """Whether cones give the full maps' values: Q-Maps of U-Nets that are alike and made of plain convolutions."""
    # A class made from it may compute its maps in another way.
    unets = list(network.unets) if type(network) is QMaps else []
    return bool(unets) and all(_plain(unet) and str(unet) == str(unets[0]) for unet in unets)


def values(network: QMaps, heightmap: Tensor, action: Tensor) -> Tensor:
    """``[B, K]``: the Q-Maps of heightmaps ``[B, 4, H, W]`` at the actions ``[B]``, row · W + column."""
    return network.joined(*parts(network, heightmap, action))


def parts(network: QMaps, heightmap: Tensor, action: Tensor) -> tuple[Tensor, Tensor | None]:
    """What the actions pay, ``[B, K]``, and what can follow, by horizon, ``[B, K, P]``: Q_k = now_k + γ · Σ later_k.
    All of Q_k and None where the network has no context.
    """
    rows, columns = heightmap.shape[-2:]
    if network.training or not network.symmetric:
        return _parts(network, heightmap, action)
    sides = range(elements(rows, columns))
    places = moved(rows, columns).to(action.device)
    seen = [_parts(network, transform(heightmap, side), places[side, action]) for side in sides]
    now = torch.stack([first for first, _ in seen]).mean(0)
    later = [second for _, second in seen if second is not None]
    return now, torch.stack(later).mean(0) if later else None


def _parts(network: QMaps, heightmap: Tensor, action: Tensor) -> tuple[Tensor, Tensor | None]:
    columns = heightmap.shape[-1]
    heightmap = pad_to_grid(heightmap, network.stride)
    rows, padded = heightmap.shape[-2:]
    cell = torch.stack((action // columns, action % columns), -1)
    unets = [unet for unet in network.unets if isinstance(unet, UNet)]
    cone = Cone(unets[0], cell, (rows, padded))
    if cone.base.size**2 >= rows * padded:
        image, place = network.geometry(heightmap), cell[:, 0] * padded + cell[:, 1]
        features = [values_at(unet.features(image).flatten(2), place)[..., None, None] for unet in unets]
        return _valued(network, unets, features, heightmap)
    # The stem repeats the map's edge where its own windows reach over it.
    margin = network.stem.radius
    around = cone.base.grown(margin)
    last = torch.tensor(around.edges, device=cell.device)[:, None] - 1
    seen = _taken(heightmap, around.cells.clamp_min(0).minimum(last)).contiguous()
    image = network.geometry(seen)[..., margin:-margin, margin:-margin]
    image = image * cone.base.inside.to(image.dtype)
    features = [cone.features(unet, image)[..., None, None] for unet in unets]
    return _valued(network, unets, features, heightmap)


def _valued(
    network: QMaps, unets: list[UNet], features: list[Tensor], heightmap: Tensor
) -> tuple[Tensor, Tensor | None]:
    """What each U-Net makes of its features ``[B, width, 1, 1]`` at the cells, in the context of the whole map."""
    now = torch.cat([unet.value(seen).flatten(1) for unet, seen in zip(unets, features, strict=True)], 1)
    if network.context is None:
        return now, None
    whole = network.context(heightmap)
    later = [unet.following(seen, whole).flatten(1) for unet, seen in zip(unets, features, strict=True)]
    return now, torch.stack(later, 1)


def _plain(unet: nn.Module) -> bool:
    """Whether a U-Net is one of 3 × 3 and other odd convolutions that keep the size of a map, each before its ReLU."""
    if type(unet) is not UNet or not isinstance(unet.head, nn.Conv2d) or unet.head.kernel_size != (1, 1):
        return False
    layers = [layer for block in (*unet.encoder, *unet.decoder) for layer in block.children()]
    return all(isinstance(relu, nn.ReLU) for relu in layers[1::2]) and all(
        isinstance(conv, nn.Conv2d)
        and (conv.stride, conv.dilation, conv.padding_mode) == ((1, 1), (1, 1), "zeros")
        and isinstance(conv.padding, tuple)
        and conv.kernel_size == (2 * conv.padding[0] + 1,) * 2 == (2 * conv.padding[1] + 1,) * 2
        for conv in layers[::2]
    )


def _layers(block: nn.Module) -> Iterator[nn.Conv2d]:
    return (layer for layer in block.children() if isinstance(layer, nn.Conv2d))


def _widened(block: nn.Module, needed: Region) -> list[Region]:
    """What ``block`` has to read, and what each of its convolutions has to give, to give ``needed``."""
    regions = [needed]
    for conv in reversed(list(_layers(block))):
        regions.insert(0, regions[0].grown(int(conv.padding[0])))
    return regions


def _convolved(block: nn.Module, image: Tensor, regions: list[Region]) -> Tensor:
    """``block`` without its last ReLU over the cells of the first of ``regions``."""
    for conv, region in zip(_layers(block), regions[:-1], strict=True):
        image = F.conv2d(image if region is regions[0] else _activated(image, region), conv.weight, conv.bias)
    return image


def _activated(image: Tensor, region: Region) -> Tensor:
    """The ReLU of ``image``, in place; 0 beyond the map."""
    # Unseen by autograd: it meets the zeros in the ReLU, which passes nothing back through them.
    image.detach().mul_(region.inside.to(image.dtype))
    return image.relu_()


def _taken(image: Tensor, places: Tensor) -> Tensor:
    """``[B, C, n, m]``: rows and columns ``places`` ``[B, 2, n]`` of ``image`` ``[B, C, h, w]``."""
    batch = torch.arange(len(image), device=image.device)[:, None, None]
    rows, columns = places.unbind(1)
    return image[batch, :, rows[:, :, None], columns[:, None, :]].permute(0, 3, 1, 2)
