"""Fusion against the published reference scene, brute force, and hand-made views; pixels to metres and back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from xqmap.benchmarks.references import plain_heightmap
from xqmap.envs.heightmap import PixelGrid, heightmap, unproject

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


@pytest.mark.parametrize("broken", [float("nan"), float("inf"), -float("inf"), 0.0])
def test_depths_that_are_no_numbers_are_left_out(broken: float) -> None:
    intrinsics, pose = from_above()
    color, depth = torch.full((1, 64, 64, 3), 9, dtype=torch.uint8), torch.full((1, 64, 64), 1.8)
    whole = heightmap(color, depth, intrinsics, pose, GRID)
    depth[0, 28:36] = broken
    fused = heightmap(color, depth, intrinsics, pose, GRID)
    assert bool(fused.isfinite().all())
    assert 0 < int((fused != 0).sum()) < int((whole != 0).sum())


def test_equals_brute_force() -> None:
    generator = torch.Generator().manual_seed(0)
    color = torch.randint(1, 256, (2, 16, 16, 3), dtype=torch.uint8, generator=generator)
    depth = 1.0 + torch.rand(2, 16, 16, generator=generator)
    intrinsics, pose = from_above(size=16, focal=30.0)
    intrinsics, pose = intrinsics.repeat(2, 1, 1), pose.repeat(2, 1, 1)
    pose[1, 0, 3] += 0.1
    expected = np.zeros((4, *GRID.shape), dtype=np.float32)
    points = unproject(depth, intrinsics, pose).reshape(-1, 3).numpy()
    for point, shade in zip(points, color.reshape(-1, 3).numpy(), strict=True):
        if all(low <= value < high for value, (low, high) in zip(point, GRID.bounds, strict=True)):
            column, row = int(point[0] / 0.05), int(point[1] / 0.05)
            if point[2] > expected[3, row, column]:
                expected[3, row, column] = point[2]
                expected[:3, row, column] = shade
    assert np.allclose(heightmap(color, depth, intrinsics, pose, GRID).numpy(), expected, atol=1e-5)


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


def test_wrong_shapes_are_named() -> None:
    intrinsics, pose = from_above()
    with pytest.raises(ValueError, match="heightmap needs"):
        heightmap(torch.zeros(1, 8, 8, 3), torch.zeros(1, 8, 9), intrinsics, pose, GRID)


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
