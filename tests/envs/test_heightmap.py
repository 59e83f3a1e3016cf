"""Fusion against the published reference scene, brute force, and hand-made views; pixels to metres and back."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from xqmap.benchmarks.references import plain_heightmap
from xqmap.envs.heightmap import PixelGrid, heightmap

REFERENCE = Path(__file__).parents[2].parent / "shared" / "data" / "ravens_scene_dev.npz"
GRID = PixelGrid([[0.0, 1.0], [0.0, 0.5], [0.0, 1.0]], 0.05)


def from_above(height: float = 2.0, size: int = 64, focal: float = 100.0) -> tuple[torch.Tensor, torch.Tensor]:
    """Intrinsics and pose of a camera above (0.5, 0.25), image right along x, image down along −y."""
    intrinsics = torch.tensor([[[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1.0]]])
    pose = torch.eye(4)[None].clone()
    pose[0, :3, :3] = torch.tensor([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]])
    pose[0, :3, 3] = torch.tensor([0.5, 0.25, height])
    return intrinsics, pose


@pytest.mark.skipif(not REFERENCE.exists(), reason="the reference scene is not on this machine")
@pytest.mark.parametrize("camera", [0, 1, 2])
def test_reference_scene(camera: int) -> None:
    scene = np.load(REFERENCE)
    one = slice(camera, camera + 1)
    inputs = [torch.from_numpy(scene[name][one]) for name in ("color", "depth", "intrinsics", "camera_to_world")]
    fused = heightmap(*inputs, PixelGrid(scene["bounds"].tolist(), float(scene["pixel_size"]))).numpy()
    height = np.abs(fused[3] - scene["heightmaps"][camera]) < 1e-3
    color = np.abs(fused[:3].transpose(1, 2, 0) - scene["colormaps"][camera].astype(float)).max(-1) <= 2
    assert height.mean() >= 0.99
    assert color.mean() >= 0.99


@pytest.mark.skipif(not REFERENCE.exists(), reason="the reference scene is not on this machine")
def test_equals_the_plain_algorithm_on_the_reference_scene() -> None:
    scene = np.load(REFERENCE)
    arrays = [scene[name] for name in ("color", "depth", "intrinsics", "camera_to_world")]
    grid = PixelGrid(scene["bounds"].tolist(), float(scene["pixel_size"]))
    same = np.abs(heightmap(*map(torch.from_numpy, arrays), grid).numpy() - plain_heightmap(*arrays, grid)) < 1e-3
    assert same[3].mean() >= 0.999
    # Where two cameras see a spot at the same height, rounding decides whose color it takes.
    assert same.all(0).mean() >= 0.99


def brute_force(color: np.ndarray, depth: np.ndarray, intrinsics: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """``[4, H, W]`` of GRID, point by point, with the roundings that heightmap.py promises."""
    fused = np.zeros((4, *GRID.shape), dtype=np.float32)
    height = np.full(GRID.shape, -1, dtype=np.float32)
    (x0, _), (y0, _), (z0, z1) = GRID.bounds
    for camera, (k, to_world) in enumerate(zip(intrinsics.astype(float), pose.astype(float), strict=True)):
        to_grid = to_world[:3] - [[0, 0, 0, x0], [0, 0, 0, y0], [0, 0, 0, z0]]
        to_grid[:2] /= GRID.pixel_size
        to_grid[:2, 3] += 1
        for v, u in np.ndindex(depth.shape[1:]):
            across = (to_grid[:, 0] * ((u - k[0, 2]) / k[0, 0])).astype(np.float32)
            down = (to_grid[:, 1] * ((v - k[1, 2]) / k[1, 1]) + to_grid[:, 2]).astype(np.float32)
            metres = depth[camera, v, u]
            if not 0 < metres < np.inf:
                continue
            x, y, z = (across + down) * metres + to_grid[:, 3].astype(np.float32)
            column, row = int(np.floor(x)) - 1, int(np.floor(y)) - 1
            beside = not (0 <= row < GRID.shape[0] and 0 <= column < GRID.shape[1] and 0 <= z < z1 - z0)
            if not beside and z > height[row, column]:
                height[row, column] = fused[3, row, column] = z
                fused[:3, row, column] = color[camera, v, u]
    return fused


def cameras(seed: int, count: int, h: int, w: int) -> tuple[np.ndarray, ...]:
    """Colors, depths with holes and equal heights, intrinsics and poses around GRID, every second one inside it."""
    random = np.random.default_rng(seed)
    color = random.integers(1, 256, (count, h, w, 3), dtype=np.uint8)
    depth = random.uniform(0.05, 1.5, (count, h, w)).astype(np.float32)
    depth[random.random(depth.shape) < 0.3] = 0.5
    for hole in (0, -0.3, np.nan, np.inf, -np.inf):
        depth[random.random(depth.shape) < 0.03] = hole
    pose = np.tile(np.eye(4), (count, 1, 1))
    pose[:, :3, 3] = random.uniform([0, 0, 0], [1, 0.5, 1], (count, 3)) + np.arange(count)[:, None] % 2 * [0.3, 0, 0.5]
    pose[:, :3, :3] = np.linalg.qr(random.normal(size=(count, 3, 3)))[0]
    pose[0, :3, :3] = np.diag([1, -1, -1])
    intrinsics = np.array([[0.7 * w, 0, w / 2], [0, 0.8 * h, h / 2], [0, 0, 1]]).repeat(count).reshape(3, 3, count)
    return color, depth, np.moveaxis(intrinsics, 2, 0).astype(np.float32), pose.astype(np.float32)


@pytest.mark.parametrize(
    ("seed", "count", "h", "w"),
    [(0, 3, 16, 64), (1, 2, 17, 65), (2, 4, 1, 1), (3, 1, 9, 130), (4, 2, 33, 7), (5, 3, 8, 63), (6, 1, 100, 128)],
)
def test_equals_brute_force_bit_by_bit(seed: int, count: int, h: int, w: int) -> None:
    scene = cameras(seed, count, h, w)
    assert np.array_equal(heightmap(*scene, GRID).numpy(), brute_force(*scene))


def test_of_equally_high_points_the_first_wins_whichever_way_it_is_computed() -> None:
    grid = PixelGrid([[0.0, 1.0], [0.0, 0.5], [0.0, 1.0]], 1 / 32)
    # All numbers are sums of powers of two: nothing is rounded, here or there.
    random = np.random.default_rng(0)
    color = random.integers(1, 256, (3, 40, 64, 3), dtype=np.uint8)
    depth = (2 - random.integers(0, 5, (3, 40, 64)) / 4).astype(np.float32)
    depth[random.random(depth.shape) < 0.1] = 0
    intrinsics, pose = (part.repeat(3, 1, 1).numpy() for part in from_above(focal=64.0))
    pose[1, 0, 3], pose[2, :3, :3] = 0.5 + 1 / 64, np.diag([-1, 1, -1])
    plain = plain_heightmap(color, depth, intrinsics, pose, grid)
    assert np.array_equal(heightmap(color, depth, intrinsics, pose, grid).numpy(), plain)
    assert (plain[:3].any(0) & (plain[3] == 0)).any()


def test_the_number_of_threads_is_what_it_was() -> None:
    before = torch.get_num_threads()
    try:
        torch.set_num_threads(3)
        heightmap(*cameras(0, 1, 8, 8), GRID)
        with pytest.raises(ValueError, match="heightmap needs"):
            heightmap(*cameras(0, 1, 8, 8)[:3], torch.eye(3), GRID)
        assert torch.get_num_threads() == 3
    finally:
        torch.set_num_threads(before)


def test_many_points_of_one_cell_take_several_passes() -> None:
    color, depth, intrinsics, pose = cameras(7, 3, 240, 320)
    several = heightmap(color, depth, intrinsics, pose, GRID)
    each = torch.stack(
        [heightmap(*(part[i : i + 1] for part in (color, depth, intrinsics, pose)), GRID) for i in range(3)]
    )
    first = each[:, 3:].argmax(0, keepdim=True).expand(1, 4, *GRID.shape)
    assert torch.equal(several, each.gather(0, first)[0])


TYPES = ("float16", "float32", "float64", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64")


def inside(depth: torch.Tensor | np.ndarray, **unit: float) -> torch.Tensor:
    """The map of a camera that hangs inside the bounds, 25 cm over their floor."""
    intrinsics, pose = from_above(height=0.25, focal=16.0)
    return heightmap(torch.full((1, 64, 64, 3), 9, dtype=torch.uint8), depth, intrinsics, pose, GRID, **unit)


def holes_of(kind: np.dtype) -> list[float]:
    """Every number of a type that is no reading."""
    if kind.kind == "f":
        return [0.0, -0.0, -0.1, np.nan, np.inf, -np.inf, float(np.finfo(kind).min)]
    return [0, np.iinfo(kind).max, *([-1, np.iinfo(kind).min] if kind.kind == "i" else [])]


@pytest.mark.parametrize("library", ["numpy", "numpy, other byte order", "torch"])
@pytest.mark.parametrize("name", TYPES)
def test_every_type_has_its_unit_and_its_holes(name: str, library: str) -> None:
    kind = np.dtype(name)
    depth = np.full((1, 64, 64), 0.125 if kind.kind == "f" else 125, dtype=kind)
    for row, hole in enumerate(holes_of(kind)):
        depth[0, 28 + row] = hole
    expected = np.full((1, 64, 64), 0.125, dtype=np.float32)
    expected[0, 28 : 28 + len(holes_of(kind))] = np.nan
    given = {"numpy": depth, "torch": torch.from_numpy(depth)}.get(library, depth.astype(kind.newbyteorder()))
    fused = inside(given)
    assert torch.equal(fused, inside(expected))
    assert fused[3].unique().tolist() == [0, 0.125]


@pytest.mark.parametrize("name", TYPES)
def test_nothing_but_holes_is_an_empty_map(name: str) -> None:
    for hole in holes_of(np.dtype(name)):
        assert not inside(np.full((1, 64, 64), hole, dtype=name)).any()


def test_bfloat16_is_metres() -> None:
    depth = torch.full((1, 64, 64), 0.125)
    assert torch.equal(inside(depth.bfloat16()), inside(depth))


@pytest.mark.parametrize(
    ("name", "value", "unit"), [("uint16", 1250, 0.0001), ("float32", 125, 0.001), ("int32", 1, 0.125)]
)
def test_a_stated_unit_goes_before_that_of_the_type(name: str, value: float, unit: float) -> None:
    fused = inside(np.full((1, 64, 64), value, dtype=name), depth_unit=unit)
    assert torch.allclose(fused, inside(torch.full((1, 64, 64), 0.125)))


@pytest.mark.parametrize("unit", [0, -0.001, float("nan"), float("inf"), "mm"])
def test_a_unit_that_is_none_is_refused(unit: float) -> None:
    with pytest.raises(ValueError, match=r"depth_unit must be metres per number \(0.001 for millimetres\), not"):
        inside(np.full((1, 64, 64), 125), depth_unit=unit)


def test_views_and_memory_that_is_not_ours_give_the_same_map() -> None:
    color, depth, intrinsics, pose = cameras(0, 2, 16, 64)
    expected = heightmap(color, depth, intrinsics, pose, GRID)
    framed = np.zeros((2, 20, 130, 4), dtype=np.uint8)
    framed[:, 2:18, 1:129:2, :3] = color
    turned = np.ascontiguousarray(depth[:, ::-1])[:, ::-1]
    turned.flags.writeable = False
    views = framed[:, 2:18, 1:129:2, :3], turned, intrinsics.astype(float), pose.astype(float)
    assert torch.equal(heightmap(*views, GRID), expected)
    tensors = [torch.from_numpy(framed)[:, 2:18, 1:129:2, :3], torch.from_numpy(depth.transpose(0, 2, 1).copy()).mT]
    assert torch.equal(
        heightmap(*tensors, *(torch.from_numpy(view).requires_grad_() for view in views[2:]), GRID), expected
    )


def test_color_comes_from_the_point_that_won_the_height() -> None:
    intrinsics, pose = from_above()
    color = torch.zeros(2, 64, 64, 3, dtype=torch.uint8)
    color[0, ..., 0], color[1, ..., 1] = 200, 200
    depth = torch.full((2, 64, 64), 2.0)
    depth[0], depth[1] = 1.8, 1.7
    fused = heightmap(color, depth, intrinsics.repeat(2, 1, 1), pose.repeat(2, 1, 1), GRID)
    seen_by_both = fused[3] > 0.25
    assert bool(seen_by_both.any())
    assert torch.equal(fused[:2, seen_by_both], torch.tensor([[0.0], [200.0]]).expand(2, int(seen_by_both.sum())))


def test_rows_are_y_and_columns_are_x() -> None:
    intrinsics, pose = from_above()
    depth = torch.full((1, 64, 64), 2.0)
    # A raised spot right (+x) and up in the image (+y).
    depth[0, 20:24, 40:44] = 1.5
    fused = heightmap(torch.full((1, 64, 64, 3), 9, dtype=torch.uint8), depth, intrinsics, pose, GRID)
    row, column = (fused[3] == fused[3].max()).nonzero()[0].tolist()
    assert row > GRID.shape[0] / 2
    assert column > GRID.shape[1] / 2


def test_unseen_cells_are_empty_and_bounds_half_open() -> None:
    intrinsics, pose = from_above()
    color, depth = torch.full((1, 64, 64, 3), 9, dtype=torch.uint8), torch.full((1, 64, 64), 2.5)
    assert float(heightmap(color, depth, intrinsics, pose, GRID).abs().sum()) == 0
    assert float(heightmap(color, torch.full((1, 64, 64), 1.0), intrinsics, pose, GRID).abs().sum()) == 0


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        (
            {"depth": np.zeros((1, 8, 9))},
            r"heightmap needs .*integers: mm, floats: m.*, depth \[1, 8, 9\] torch.float64",
        ),
        ({"depth": np.zeros((1, 8, 8, 1))}, "heightmap needs"),
        ({"depth": np.zeros((8, 8))}, "heightmap needs"),
        ({"depth": np.zeros((0, 8, 8)), "color": np.zeros((0, 8, 8, 3), dtype=np.uint8)}, "heightmap needs"),
        ({"depth": 1.0}, "heightmap needs"),
        ({"color": np.zeros((1, 8, 8, 3))}, r"color \[N,h,w,3\] uint8.*color \[1, 8, 8, 3\] torch.float64"),
        ({"color": np.zeros((1, 8, 8, 4), dtype=np.uint8)}, "heightmap needs"),
        ({"intrinsics": np.eye(3)}, "heightmap needs"),
        ({"camera_to_world": np.eye(4)[None, :3]}, "heightmap needs"),
        ({"depth": np.zeros((1, 8, 8), dtype=bool)}, r"depth must be integers \(depth: mm\) or floats .*, not bool"),
        ({"depth": torch.zeros(1, 8, 8, dtype=torch.bool)}, "depth must be integers"),
        ({"depth": np.zeros((1, 8, 8), dtype=complex)}, "depth must be integers"),
        ({"depth": torch.zeros(1, 8, 8, dtype=torch.complex64)}, "depth must be integers"),
        ({"depth": np.full((1, 8, 8), "1.0")}, "depth must be integers"),
        ({"depth": None}, "depth must be integers"),
        ({"depth": np.zeros((1, 8, 8), dtype=np.longdouble)}, "at most 64 bits"),
        ({"intrinsics": np.zeros((1, 3, 3))}, "calibration is broken"),
        ({"intrinsics": np.full((1, 3, 3), np.nan)}, "calibration is broken"),
        ({"camera_to_world": np.full((1, 4, 4), np.inf)}, "calibration is broken"),
        ({"camera_to_world": np.full((1, 4, 4), 1e300)}, "calibration is broken"),
    ],
)
def test_wrong_shapes_types_and_calibrations_are_named(changes: dict[str, Any], told: str) -> None:
    arrays = {"color": np.zeros((1, 8, 8, 3), dtype=np.uint8), "depth": np.zeros((1, 8, 8))}
    calibration = {"intrinsics": np.eye(3)[None], "camera_to_world": np.eye(4)[None]}
    with pytest.raises(ValueError, match=told):
        heightmap(**{**arrays, **calibration, **changes}, grid=GRID)


@given(row=st.integers(0, 319), column=st.integers(0, 159), height=st.floats(0, 0.28))
def test_pixel_to_metre_and_back(row: int, column: int, height: float) -> None:
    grid = PixelGrid([[0.25, 0.75], [-0.5, 0.5], [0, 0.28]], 0.003125)
    point = grid.to_point(torch.tensor([row, column]), torch.tensor(height, dtype=torch.float64))
    assert grid.to_pixel(point).tolist() == [row, column]
    assert float(point[2]) == pytest.approx(height)


@pytest.mark.parametrize(
    ("bounds", "size"), [([[1, 0], [0, 1], [0, 1]], 0.1), ([[0, 1], [0, 1]], 0.1), ([[0, 1]] * 3, 0)]
)
def test_impossible_grids_are_refused(bounds: list[list[float]], size: float) -> None:
    with pytest.raises(ValueError, match=r"bounds|pixel_size"):
        PixelGrid(bounds, size)
