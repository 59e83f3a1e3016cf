"""What lies where, in words: from the world's own knowledge, or from the heightmap alone. Replaceable: a perception
makes a Scene.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from matplotlib.path import Path as Outline
from scipy import ndimage

from xqmap.explanations.scene import Scene

if TYPE_CHECKING:
    from xqmap.envs.heightmap import PixelGrid


class Perception(Protocol):
    """Names what is in a heightmap."""

    def __call__(self, heightmap: np.ndarray, grid: PixelGrid, task: Any) -> Scene:
        """``heightmap`` ``[4, H, W]`` (0–255 and m), its grid, and the world it came from (None where there is
        none).
        """
        ...


class Simulator:
    """What the world itself knows: the outlines of its objects, the highest on top."""

    def __call__(self, heightmap: np.ndarray, grid: PixelGrid, task: Any) -> Scene:
        """Rasterises the world's objects; see :class:`Perception`."""
        rows, columns = grid.shape
        (x0, _), (y0, _), _ = grid.bounds
        x = x0 + (np.arange(columns) + 0.5) * grid.pixel_size
        y = y0 + (np.arange(rows) + 0.5) * grid.pixel_size
        centres = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        things = sorted(task.scene_objects(), key=lambda thing: thing.top)
        cells = np.full(rows * columns, -1)
        for i, thing in enumerate(things):
            cells[Outline(np.asarray(thing.footprint)).contains_points(centres)] = i
        names = [thing.name for thing in things]
        return Scene(names, cells.reshape(rows, columns), task.BACKGROUND, grid.bounds, heightmap[3])


class Vision:
    """From the heightmap alone: regions that stand up, their color by the nearest palette color, their shape by fits to
    the heights.

    Args:
        background: the name of what does not stand up.
        palette: red, green, blue (0–255) by color name.
        raised: height (m) above the background from which a cell belongs to an object.
        smallest: cells an object has at least.
        edge: rise (m) between neighbouring cells that separates two objects.
        whole_first: whether a region that has one of the shapes as a whole is one object, whatever steps are in it.
        shapes: names with the rules that choose them, tried in order: each may bound ``slope`` (degrees, of the plane
            that fits the region), ``hollow`` (how far the middle lies below the rim, m) and ``extent`` (longest side,
            m) from above by ``max_*`` and from below by ``min_*``.
        order: how a name is put together from ``{color}`` and ``{shape}``.
        unlike: how far a color's hue (a and b of CIE L*a*b*, at the lightness of the palette's) may be from the
            nearest one's; beyond, it is of no known color. Without it any
            color is its nearest.
    """

    def __init__(
        self,
        background: str,
        palette: Mapping[str, Sequence[int]],
        raised: float,
        smallest: int,
        edge: float,
        whole_first: bool,
        shapes: Mapping[str, Mapping[str, float]],
        order: str,
        unlike: float = math.inf,
    ) -> None:
        self.background, self.raised, self.smallest, self.edge = background, raised, smallest, edge
        self.colors = list(palette)
        self.paints = np.array([palette[name] for name in self.colors], dtype=float)
        self.palette, self.unlike = lab(self.paints), unlike
        self.whole_first, self.shapes, self.order = whole_first, shapes, order

    def __call__(self, heightmap: np.ndarray, grid: PixelGrid, task: Any) -> Scene:
        """Segments and names what stands up; see :class:`Perception`. The world is not asked."""
        color, height = heightmap[:3], heightmap[3]
        seen = (heightmap != 0).any(0)
        floor = float(np.median(height[seen])) if seen.any() else 0.0
        # Two objects that touch are told apart by the step between them; the step itself belongs to what is nearest.
        steep = ndimage.maximum_filter(height, 3) - ndimage.minimum_filter(height, 3) > self.edge
        raised = (height > floor + self.raised) & seen
        regions, _ = ndimage.label(raised)
        cores, count = ndimage.label(raised & ~steep)
        if self.whole_first:
            for region in range(1, regions.max() + 1):
                inside = regions == region
                if self._shape(height, inside, inside, grid.pixel_size) is not None:
                    cores[inside] = count = count + 1
        large = np.append(0, ndimage.sum_labels(np.ones_like(cores), cores, np.arange(1, count + 1))) >= self.smallest
        cores = np.where(large[cores], cores, 0)
        cells = np.full(height.shape, -1)
        if not cores.any():
            return Scene([], cells, self.background, grid.bounds, height)
        nearest = tuple(ndimage.distance_transform_edt(cores == 0, return_distances=False, return_indices=True))
        owner = np.where(raised & (regions == regions[nearest]), cores[nearest], 0)
        names: list[str] = []
        for core in np.flatnonzero(large):
            # What is low or hidden in its middle belongs to what surrounds it, unless it is an object itself.
            whole = ndimage.binary_fill_holes(owner == core) & ((owner == 0) | (owner == core))
            cells[whole & (cells < 0)] = len(names)
            names.append(self._name(color[:, cores == core], height, cores == core, whole & seen, grid.pixel_size))
        return Scene(names, cells, self.background, grid.bounds, height)

    def _name(
        self, color: np.ndarray, height: np.ndarray, inside: np.ndarray, whole: np.ndarray, pixel_size: float
    ) -> str:
        known = self._color(np.median(color, axis=1))
        shape = self._shape(height, inside, whole, pixel_size)
        name = self.order.format(color=known or "", shape=shape) if shape is not None else f"{known or ''} object"
        return name if known else f"{name.strip()} of no known color"

    def _color(self, seen: np.ndarray) -> str | None:
        """The nearest color of the palette to red, green, blue (0–255); None if it is none of them."""
        # Lightness says more of the lamp than of the paint.
        nearest = int(np.argmin(((self.palette - lab(seen[None])[0]) ** 2 * (0.1, 1, 1)).sum(-1)))
        light = np.clip(_luminance(self.paints[nearest]) / max(_luminance(seen), 1e-3), 0, 20)
        # As if the lamp were such that both are equally light.
        hue = lab(255 * (light * (seen / 255) ** 2.2)[None] ** (1 / 2.2))[0, 1:]
        return self.colors[nearest] if math.dist(hue, self.palette[nearest, 1:]) <= self.unlike else None

    def _shape(self, height: np.ndarray, inside: np.ndarray, whole: np.ndarray, pixel_size: float) -> str | None:
        """The first shape whose rules hold: of the plane through the cells ``inside``, and of the heights of the
        ``whole`` thing.
        """
        rows, columns = np.nonzero(inside)
        plane, *_ = np.linalg.lstsq(np.column_stack((rows, columns, np.ones(len(rows)))), height[inside], rcond=None)
        features = {
            "slope": float(np.rad2deg(np.arctan(np.hypot(plane[0], plane[1]) / pixel_size))),
            "hollow": float(np.quantile(height[whole], 0.95) - np.median(height[whole])),
            "extent": float(max(np.ptp(side) + 1 for side in np.nonzero(whole))) * pixel_size,
        }
        fitting = (
            name for name, rules in self.shapes.items() if all(_holds(*rule, features) for rule in rules.items())
        )
        return next(fitting, None)


def _holds(rule: str, limit: float, features: dict[str, float]) -> bool:
    side, _, name = rule.partition("_")
    return features[name] <= limit if side == "max" else features[name] >= limit


def _luminance(rgb: np.ndarray) -> float:
    return float((0.2126, 0.7152, 0.0722) @ (rgb / 255) ** 2.2)


def lab(rgb: np.ndarray) -> np.ndarray:
    """SRGB ``[N, 3]`` (0–255) to CIE L*a*b* (D65) ``[N, 3]``, where distance is about what a person sees (CIE
    15:2004).
    """
    linear = rgb / 255
    linear = np.where(linear > 0.04045, ((linear + 0.055) / 1.055) ** 2.4, linear / 12.92)
    xyz = (
        linear
        @ np.array([[0.4124, 0.2126, 0.0193], [0.3576, 0.7152, 0.1192], [0.1805, 0.0722, 0.9505]])
        / (0.9505, 1.0, 1.089)
    )
    f = np.where(xyz > (6 / 29) ** 3, np.cbrt(xyz), xyz / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.stack((116 * f[:, 1] - 16, 500 * (f[:, 0] - f[:, 1]), 200 * (f[:, 1] - f[:, 2])), axis=-1)


def agreement(first: Scene, second: Scene) -> tuple[int, int]:
    """How often two perceptions say the same: ``(agreeing, compared)`` over the objects of ``first``, asked at their
    middle cells.
    """
    agreeing = compared = 0
    for index, name in enumerate(first.names):
        cells = np.argwhere(first.cells == index)
        if len(cells) < 9:
            continue
        middle = cells[np.argmin(((cells - cells.mean(0)) ** 2).sum(1))]
        compared += 1
        agreeing += re.sub(r"\s+", " ", name) == second.name((int(middle[0]), int(middle[1])))
    return agreeing, compared
