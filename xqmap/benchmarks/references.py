"""What the fast paths must equal, written plainly: the map of an RGB-D scene in numpy, and Q-Maps layer by layer."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from xqmap.envs.heightmap import PixelGrid
from xqmap.models.qmaps import QMaps
from xqmap.models.unet import UNet


def plain_heightmap(
    color: np.ndarray, depth: np.ndarray, intrinsics: np.ndarray, pose: np.ndarray, grid: PixelGrid
) -> np.ndarray:
    """``[4, H, W]`` as Ravens describes it: per camera unproject, keep what is inside, write in order of z; the highest
    camera wins. Of equals the first pixel, where Ravens leaves it open. ``depth`` in metres.
    """
    low, high = np.array(grid.bounds).T
    heights, colors = [], []
    for image, metres, k, to_world in zip(color, depth, intrinsics, pose, strict=True):
        h, w = metres.shape
        u, v = np.meshgrid(np.arange(w), np.arange(h))
        points = np.stack(
            ((u - k[0, 2]) * metres / k[0, 0], (v - k[1, 2]) * metres / k[1, 1], metres), axis=-1
        ).reshape(-1, 3)
        points = (to_world @ np.column_stack((points, np.ones(len(points)))).T).T[:, :3]
        kept = ((points >= low) & (points < high)).all(1) & (metres.reshape(-1) > 0)
        points, shades = points[kept], image.reshape(-1, 3)[kept]
        order = len(points) - 1 - np.argsort(points[::-1, 2], kind="stable")
        points, shades = points[order], shades[order]
        column = np.floor((points[:, 0] - low[0]) / grid.pixel_size).astype(int).clip(0, grid.shape[1] - 1)
        row = np.floor((points[:, 1] - low[1]) / grid.pixel_size).astype(int).clip(0, grid.shape[0] - 1)
        height, shade = np.full(grid.shape, -1.0), np.zeros((*grid.shape, 3))
        height[row, column] = points[:, 2] - low[2]
        shade[row, column] = shades
        heights.append(height)
        colors.append(shade)
    winner = np.argmax(heights, axis=0)
    color_of_winner = np.take_along_axis(np.array(colors), winner[None, ..., None], axis=0)[0]
    return np.concatenate((color_of_winner.transpose(2, 0, 1), np.max(heights, axis=0)[None].clip(0)))


def plain_unet(unet: UNet, image: Tensor) -> Tensor:
    """``[B, C, H, W]`` → ``[B, 1, H, W]``: pooled, doubled and joined as the U-Net is usually written."""
    skips: list[Tensor] = []
    for level, block in enumerate(unet.encoder):
        image = block(image if level == 0 else F.max_pool2d(image, 2))
        skips.append(image)
    image = skips.pop()
    for block in unet.decoder:
        image = block(torch.cat((F.interpolate(image, scale_factor=2, mode="nearest"), skips.pop()), dim=1))
    return unet.head(image)


class PlainQMaps(QMaps):
    """All maps at once, one net after the other."""

    def maps(self, heightmap: Tensor) -> Tensor:
        """``[B, 4, H, W]`` → ``[B, K, H, W]``; the poolings must divide H and W."""
        with torch.no_grad():
            image = self.stem(heightmap)
        return torch.cat([plain_unet(unet, image) for unet in self._unets()], dim=1)
