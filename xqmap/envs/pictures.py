"""Pictures of one's own: calibrated RGB-D images from a file or a folder, checked, and made into the heightmap that an
agent knows.

A file is an npz, a folder holds ``cameras.json`` and PNG images; ``docs/own_pictures.md`` has both formats.
"""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from xqmap.envs.heightmap import PixelGrid, heightmap, metres
from xqmap.errors import UserError, brief
from xqmap.files import read_bytes

_LARGEST = 500_000_000
DESCRIPTION = "cameras.json"
# Of a table, degrees and metres: more is no table that a camera of this pose sees, or one that has to be told of.
_STEEPEST, _SHIFTED = 2.0, 0.002
# Around the table's plane, m; what of the map has to be table, or seen at all.
_NEAR, _LEAST_TABLE, _LEAST_SEEN = 0.004, 0.25, 0.05
# How far below and above the stated bounds a table is looked for, m.
_BELOW = 0.1
# Between these (m) lies what a camera over a workspace sees, in the middle.
_NEAREST, _FARTHEST = 0.05, 20.0


@dataclass
class Pictures:
    """N calibrated RGB-D images of one workspace.

    Attributes:
        color: ``[N, h, w, 3]`` uint8.
        depth: ``[N, h, w]`` along the optical axis, m; 0 is a hole.
        intrinsics: ``[N, 3, 3]``, pixels.
        camera_to_world: ``[N, 4, 4]``, m; camera axes x right, y down, z forward.
        bounds: ``[3, 2]``, m: of the workspace; z from the table up.
        pixel_size: edge of a cell, m; None where nothing is said of it.
        reach: x, y and radius (m) of the circle that the arm reaches; None for everywhere.
    """

    color: np.ndarray
    depth: np.ndarray
    intrinsics: np.ndarray
    camera_to_world: np.ndarray
    bounds: np.ndarray
    pixel_size: float | None
    reach: tuple[float, float, float] | None


def read(place: str | Path, depth_unit: float | None = None, axes: str = "opencv") -> Pictures:
    """The images of an npz file or of a folder.

    Args:
        place: the file or folder.
        depth_unit: metres per number of the depth images; None: integers are millimetres, others metres.
        axes: of the cameras: ``"opencv"`` (x right, y down, z forward) or ``"opengl"`` (x right, y up, z backward).

    Raises:
        UserError: naming the file and what is missing or wrong in it.
    """
    path = Path(place)
    if axes not in ("opencv", "opengl"):
        raise UserError(f"camera_axes={axes} is neither opencv nor opengl")
    if not path.exists():
        raise UserError(f"images={path}: there is no such file or folder")
    found = _folder(path) if path.is_dir() else _npz(path)
    try:
        color = np.asarray(found["color"])[..., :3]
        depth = np.asarray(found["depth"])
        count = len(color)
        intrinsics = np.asarray(found["intrinsics"], dtype=float)
        if ("camera_to_world" in found) == ("world_to_camera" in found):
            raise UserError(f"{path}: must hold either camera_to_world or world_to_camera")
        pose = np.asarray(found.get("camera_to_world", found.get("world_to_camera")), dtype=float)
        bounds = np.asarray(found["bounds"], dtype=float)
        reach = None if found.get("reach") is None else tuple(map(float, found["reach"]))
        pixel_size = None if found.get("pixel_size") is None else float(found["pixel_size"])
    except KeyError as error:
        raise UserError(f"{path}: lacks {error.args[0]}, one of color, depth, intrinsics, bounds") from None
    except (TypeError, ValueError) as error:
        raise UserError(f"{path}: holds no numbers that can be read ({brief(error)})") from None
    shapes = {"color": color, "depth": depth, "intrinsics": intrinsics, "camera pose": pose, "bounds": bounds}
    wanted = (
        (count, *depth.shape[1:], 3), (count, *color.shape[1:3]), (count, 3, 3), (count, 4, 4), (3, 2)
    )  # fmt: skip
    for (name, array), shape in zip(shapes.items(), wanted, strict=True):
        if array.shape != shape or color.dtype != np.uint8 or (reach is not None and len(reach) != 3):
            raise UserError(
                f"{path}: {name} is {list(array.shape)}; color must be [N, h, w, 3] uint8, depth [N, h, w], intrinsics "
                "[N, 3, 3], poses [N, 4, 4], bounds [3, 2], reach x, y, radius"
            )
    if (
        not all(np.isfinite(array).all() for array in (intrinsics, pose, bounds))
        or (bounds[:, 0] >= bounds[:, 1]).any()
    ):
        raise UserError(f"{path}: calibration and bounds must be finite, each bound's lower end first")
    if "world_to_camera" in found:
        pose = np.linalg.inv(pose)
    if axes == "opengl":
        pose = pose @ np.diag((1.0, -1.0, -1.0, 1.0))
    if np.abs(pose[:, :3, :3] @ pose[:, :3, :3].swapaxes(1, 2) - np.eye(3)).max() > 1e-2:
        raise UserError(f"{path}: a camera pose is no rotation and translation: give 4 x 4 rigid transforms in metres")
    try:
        far = metres(depth, depth_unit if depth_unit is not None else found.get("depth_unit")).numpy()
    except ValueError as error:
        raise UserError(f"{path}: {error}") from None
    far = np.where(np.isfinite(far) & (far > 0), far, 0).astype(np.float32)
    middle = float(np.median(far[far > 0])) if (far > 0).any() else 0.0
    if not _NEAREST < middle < _FARTHEST:
        raise UserError(
            f"{path}: depths are {middle:g} m in the middle, which no camera over a workspace sees: give depth_unit, "
            "metres per number (0.001 for millimetres)"
        )
    return Pictures(color, far, intrinsics, pose, bounds, pixel_size, reach)  # type: ignore[arg-type]


def seen(pictures: Pictures, pixel_size: float, table: float) -> tuple[Tensor, Tensor, PixelGrid, list[str]]:
    """The heightmap that an agent would have been shown, with the table where training had it.

    Args:
        pictures: of one workspace.
        pixel_size: of the agent's cells, m.
        table: how high the table lay above the map's floor in training, m.

    Returns:
        ``[4, H, W]``, ``[H · W]`` bool (what was seen and can be reached), the grid, and a line for each thing that a
        person should know.

    Raises:
        UserError: if no level table is found, or next to nothing lies in the bounds.
    """
    (x0, x1), (y0, y1), (z0, z1) = pictures.bounds
    said = []
    if pictures.pixel_size is not None and abs(pictures.pixel_size / pixel_size - 1) > 0.01:
        said.append(
            f"the pictures name cells of {pictures.pixel_size:g} m, the agent knows {pixel_size:g} m: its own are used"
        )

    def fused(low: float) -> tuple[Tensor, PixelGrid]:
        grid = PixelGrid(((x0, x1), (y0, y1), (low, z1)), pixel_size)
        parts = (pictures.color, pictures.depth, pictures.intrinsics, pictures.camera_to_world)
        return heightmap(*parts, grid), grid

    level = _table(*fused(z0 - _BELOW))
    if abs(level - z0 - table) > _SHIFTED:
        said.append(
            f"the table lies at z = {level:.3f} m and the bounds begin at {z0:.3f} m: the map's floor is put at "
            f"{level - table:.3f} m, {table:g} m below the table, as in training"
        )
    image, grid = fused(level - table)
    # As the environment rounds it.
    image[3] = image[3].half().float()
    mask = (image != 0).any(0)
    if pictures.reach is not None:
        x, y, radius = pictures.reach
        rows, columns = np.indices(grid.shape)
        far = np.hypot(x0 + (columns + 0.5) * pixel_size - x, y0 + (rows + 0.5) * pixel_size - y)
        mask &= torch.from_numpy(far <= radius)
    if not bool(mask.any()):
        raise UserError("reach: nothing that the cameras see lies within it")
    holes = 1 - float((image != 0).any(0).float().mean())
    if holes > 0.1:
        said.append(f"{holes:.0%} of the map was seen by no camera: nothing is chosen there")
    return image, mask.reshape(-1), grid, said


def _table(image: Tensor, grid: PixelGrid) -> float:
    """World z (m) of the table: the level that most of the map lies on."""
    height, there = image[3].double().numpy(), (image != 0).any(0).numpy()
    if there.mean() < _LEAST_SEEN:
        raise UserError(
            f"{there.mean():.0%} of the workspace is seen: are the bounds in the cameras' world, and the poses "
            "camera-to-world, with axes as camera_axes says?"
        )
    edges = np.arange(0, height.max() + 3e-3, 1e-3)
    counts, _ = np.histogram(height[there], edges)
    # Of three millimetres together, since noise spreads a table over its neighbours.
    middle = edges[int(np.convolve(counts, np.ones(3), "same").argmax())] + 5e-4
    flat = there & (np.abs(height - middle) < _NEAR)
    if flat.sum() < _LEAST_TABLE * there.sum():
        raise UserError("no table is found: less than a quarter of what is seen lies on one level; check the poses")
    rows, columns = np.nonzero(flat)
    plane, *_ = np.linalg.lstsq(np.column_stack((rows, columns, np.ones(len(rows)))), height[flat], rcond=None)
    tilt = float(np.rad2deg(np.arctan(np.hypot(plane[0], plane[1]) / grid.pixel_size)))
    if tilt > _STEEPEST:
        raise UserError(f"the table is tilted by {tilt:.1f} degrees: the camera poses are off, or z does not point up")
    return float(grid.bounds[2][0] + np.median(height[flat]))


def _npz(path: Path) -> dict[str, Any]:
    content = io.BytesIO(read_bytes(path, _LARGEST))
    try:
        with zipfile.ZipFile(content) as packed:
            if sum(entry.file_size for entry in packed.infolist()) > 4 * _LARGEST:
                raise UserError(f"{path}: larger than any pictures of a workspace")
        with np.load(content, allow_pickle=False) as arrays:
            return {name: arrays[name] for name in arrays.files}
    except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
        raise UserError(f"{path}: no npz file that can be read ({brief(error)})") from None


def _folder(path: Path) -> dict[str, Any]:
    file = path / DESCRIPTION
    try:
        told = json.loads(read_bytes(file, 10_000_000))
        cameras = told["cameras"]
        found = {name: value for name, value in told.items() if name != "cameras"}
        found["color"] = np.stack([_image(path, camera["color"], "RGB") for camera in cameras])
        found["depth"] = np.stack([_image(path, camera["depth"]) for camera in cameras])
        for name in ("intrinsics", "camera_to_world", "world_to_camera"):
            values = [camera[name] for camera in cameras if name in camera]
            if values and len(values) != len(cameras):
                raise UserError(f"{file}: {name} stands at some cameras only")
            if values:
                found[name] = [_matrix(value) for value in values]
        return found
    except KeyError as error:
        raise UserError(f"{file}: lacks {error.args[0]}") from None
    except (ValueError, TypeError, AttributeError, RecursionError) as error:
        raise UserError(f"{file}: is not as docs/own_pictures.md has it ({brief(error)})") from None


def _matrix(value: Any) -> Any:
    if isinstance(value, Mapping):
        return [[value["fx"], 0, value["cx"]], [0, value["fy"], value["cy"]], [0, 0, 1]]
    return value


def _image(folder: Path, name: str, mode: str | None = None) -> np.ndarray:
    file = folder / name
    content = io.BytesIO(read_bytes(file, _LARGEST, inside=folder))
    try:
        with Image.open(content, formats=("PNG",)) as image:
            return np.asarray(image.convert(mode) if mode else image)
    except (OSError, Image.DecompressionBombError, SyntaxError, ValueError) as error:
        raise UserError(f"{file}: no PNG that can be read ({brief(error)})") from None
