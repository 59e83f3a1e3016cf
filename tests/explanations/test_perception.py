"""Names read off a heightmap: of blocks, of cubes and bowls, and of a real scene of Ravens."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from hydra import compose, initialize_config_dir

from xqmap.config import build, plugins
from xqmap.envs.heightmap import PixelGrid, heightmap
from xqmap.explanations.perception import Perception, Simulator, Vision, agreement

RAVENS = Path(__file__).parents[2].parent / "shared" / "data" / "ravens_scene_dev.npz"
TABLE = [[0.25, 0.75], [-0.5, 0.5], [-0.01, 0.28]]
CELL = 0.003125


def tabletop_vision() -> Perception:
    with initialize_config_dir(str(plugins.CONF), version_base=None):
        return build.perception(compose("explain", ["explain/perception@perception=grasping_vision"]).perception)


def test_perceptions_agree_on_a_plain_scene() -> None:
    class Thing:
        def __init__(self, name: str, x: float, y: float) -> None:
            self.name, self.top, self.attributes = name, 1.0, {}
            self.footprint = np.array([[x, y], [x + 1, y], [x + 1, y + 1], [x, y + 1]])

    class World:
        BACKGROUND = "ground"

        def scene_objects(self) -> list[Thing]:
            return [Thing("red flat block", 0.5, 0.5), Thing("blue inclined block", 2.5, 2.0)]

    grid = PixelGrid([[0, 4], [0, 4], [0, 3]], 0.1)
    image = np.full((4, 40, 40), 120.0, dtype=np.float32)
    image[3] = 0.05
    image[:3, 5:15, 5:15] = np.array([200, 60, 50])[:, None, None]
    image[3, 5:15, 5:15] = 1.0
    image[:3, 20:30, 25:35] = np.array([60, 90, 180])[:, None, None]
    image[3, 20:30, 25:35] = 1.0 + 0.03 * np.arange(10)
    truth = Simulator()(image, grid, World())
    seen = Vision(
        "ground",
        {"red": [200, 60, 50], "blue": [60, 90, 180], "gray": [120, 120, 120]},
        0.15,
        9,
        0.4,
        False,
        {"flat": {"max_slope": 5.0}, "inclined": {"min_slope": 5.0}},
        "{color} {shape} block",
    )(image, grid, None)
    assert agreement(truth, seen) == (2, 2)
    assert seen.name((0, 0)) == truth.name((0, 0)) == "ground"
    assert truth.position((20, 25)) == pytest.approx((2.55, 2.05, 1.0))


def test_a_cube_is_flat_on_top_and_a_bowl_hollow() -> None:
    grid = PixelGrid(TABLE, CELL)
    image = np.full((4, *grid.shape), 51.0, dtype=np.float32)
    image[3] = 0.01
    rows, columns = np.mgrid[: grid.shape[0], : grid.shape[1]]

    def bowl(row: int, column: int, color: tuple[int, int, int]) -> None:
        radius = np.hypot(rows - row, columns - column) * CELL
        inside = radius < 0.0575
        image[3][inside] = 0.01 + np.interp(radius[inside], (0, 0.01, 0.028, 0.0545), (0.004, 0.0077, 0.0175, 0.035))
        image[:3, inside] = np.array(color)[:, None]

    def cube(row: int, column: int, color: tuple[int, int, int]) -> None:
        image[3, row - 6 : row + 7, column - 6 : column + 7] = 0.05
        image[:3, row - 6 : row + 7, column - 6 : column + 7] = np.array(color)[:, None, None]

    bowl(60, 60, (240, 80, 85))
    cube(60, 120, (75, 118, 165))
    bowl(200, 10, (85, 164, 76))
    cube(200, 37, (233, 138, 42))
    # What no camera saw in a bowl's middle.
    image[:, 198:203, 8:13] = 0
    scene = tabletop_vision()(image, grid, None)
    pixels = ((60, 120), (60, 60), (200, 10), (200, 37), (300, 80))
    assert [scene.name(pixel) for pixel in pixels] == ["blue cube", "red bowl", "green bowl", "orange cube", "table"]


@pytest.mark.skipif(not RAVENS.exists(), reason="the scene of Ravens is not here")
def test_a_scene_as_ravens_drew_it_is_named() -> None:
    with np.load(RAVENS) as scene:
        grid = PixelGrid(scene["bounds"].tolist(), float(scene["pixel_size"]))
        images = [torch.from_numpy(scene[name]).float() for name in ("depth", "intrinsics", "camera_to_world")]
        image = heightmap(torch.from_numpy(scene["color"]), *images, grid).numpy()
    names = sorted(tabletop_vision()(image, grid, None).names)
    assert sum("bowl" in name for name in names) == sum("cube" in name for name in names) == len(names) / 2 == 6
    bowls = ["blue bowl", "gray bowl", "green bowl", "purple bowl", "red bowl", "yellow bowl"]
    assert [name for name in names if name.endswith("bowl")] == bowls
    # Ravens' own pink, cyan and brown are none of the colors that this world has.
    cubes = ["blue cube", *["cube of no known color"] * 3, "orange cube", "red cube"]
    assert [name for name in names if "cube" in name] == cubes


def test_a_color_that_the_palette_has_not_is_of_no_known_color() -> None:
    see = tabletop_vision()
    for color in ((255, 157, 167), (118, 183, 178), (156, 117, 95), (150, 220, 60)):
        assert see._color(np.array(color, dtype=float)) is None
    settings = plugins.perception("grasping_vision")
    for name, color in settings["palette"].items():
        for lamp in (0.6, 1.0, 1.1):
            assert see._color(np.clip(lamp * np.array(color, dtype=float), 0, 255)) == name
