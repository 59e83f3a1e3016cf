"""Pictures of one's own: every format gives the same map, and what is wrong with them is said in one line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import xqmap
from tests.commands import call
from xqmap.envs import pictures
from xqmap.errors import UserError
from xqmap.runs.places import PRETRAINED

RAVENS = Path(__file__).parents[2].parent / "shared" / "data" / "ravens_scene_dev.npz"
# A camera straight above the middle of a table of 0.4 m, with a cube of 4 cm on it.
SIDE, FOCAL, HIGH = 200, 400.0, 0.8
LEVEL = 0.13


def scene(level: float = LEVEL, tilt: float = 0.0) -> dict[str, Any]:
    """The table at world z = ``level`` m, tilted by so many degrees."""
    rows, columns = np.indices((SIDE, SIDE)) + 0.5
    across, down = (columns - SIDE / 2) / FOCAL, (rows - SIDE / 2) / FOCAL
    depth = HIGH / (1 + np.tan(np.deg2rad(tilt)) * across)
    color = np.full((SIDE, SIDE, 3), 90, np.uint8)
    cube = (np.abs(across * (HIGH - 0.04)) < 0.02) & (np.abs(down * (HIGH - 0.04)) < 0.02)
    depth[cube], color[cube] = HIGH - 0.04, (78, 121, 167)
    pose = np.eye(4)
    # It looks down: its x is the world's, its y the world's -y.
    pose[:3, :3] = np.diag((1.0, -1.0, -1.0))
    pose[:3, 3] = 0.5, 0.1, level + HIGH
    intrinsics = np.array([[FOCAL, 0, SIDE / 2 - 0.5], [0, FOCAL, SIDE / 2 - 0.5], [0, 0, 1]])
    return {
        "color": color[None],
        "depth": depth[None].astype(np.float32),
        "intrinsics": intrinsics[None],
        "camera_to_world": pose[None],
        "bounds": np.array([[0.3, 0.7], [-0.1, 0.3], [level, level + 0.3]]),
    }


def kept(folder: Path, **parts: Any) -> Path:
    """What :func:`scene` has, as an npz file."""
    path = folder / "scene.npz"
    np.savez(path, **parts)
    return path


def seen(place: Path, table: float = 0.01, **told: Any) -> tuple[np.ndarray, np.ndarray, list[str]]:
    image, mask, _, said = pictures.seen(pictures.read(place, **told), 0.005, table)
    return image.numpy(), mask.numpy(), said


def test_the_table_is_put_where_training_had_it(tmp_path: Path) -> None:
    image, mask, said = seen(kept(tmp_path, **scene()))
    assert image.shape == (4, 80, 80)
    assert np.median(image[3]) == pytest.approx(0.01, abs=1e-3)
    assert image[3, 40, 40] == pytest.approx(0.05, abs=1e-3)
    assert image[:3, 40, 40].tolist() == [78, 121, 167]
    assert mask.all()
    (line,) = said
    assert "table lies at z = 0.130 m and the bounds begin at 0.130 m: the map's floor is put at 0.120 m" in line
    # Bounds that begin there already need no word.
    right = scene() | {"bounds": scene()["bounds"] - [[0, 0], [0, 0], [0.01, 0]]}
    again, _, said = seen(kept(tmp_path, **right))
    assert said == []
    assert np.abs(again - image).max() == pytest.approx(0, abs=1e-4)


def test_every_format_gives_the_same_map(tmp_path: Path) -> None:
    parts = scene()
    expected = seen(kept(tmp_path, **parts))[0]
    pose = parts.pop("camera_to_world")
    flip = np.diag((1.0, -1.0, -1.0, 1.0))
    assert np.array_equal(seen(kept(tmp_path, **parts, world_to_camera=np.linalg.inv(pose)))[0], expected)
    opengl = kept(tmp_path, **parts, camera_to_world=pose @ flip)
    assert np.array_equal(seen(opengl, axes="opengl")[0], expected)
    depth = np.round(parts["depth"][0] * 1000).astype(np.uint16)
    depth[:10] = 65535
    depth[-10:] = 0
    Image.fromarray(parts["color"][0]).save(tmp_path / "front.png")
    Image.fromarray(depth).save(tmp_path / "front-depth.png")
    camera = {
        "color": "front.png",
        "depth": "front-depth.png",
        "intrinsics": {"fx": FOCAL, "fy": FOCAL, "cx": SIDE / 2 - 0.5, "cy": SIDE / 2 - 0.5},
        "camera_to_world": pose[0].tolist(),
    }
    told = {"bounds": parts["bounds"].tolist(), "cameras": [camera], "reach": [0.5, 0.1, 0.1]}
    (tmp_path / "cameras.json").write_text(json.dumps(told))
    image, mask, _ = seen(tmp_path)
    there = (image != 0).any(0)
    assert there.mean() == pytest.approx(0.9, abs=0.02)
    assert np.abs(image[3] - expected[3])[there].max() < 2e-3
    assert np.array_equal(image[:3, there], expected[:3, there])
    # The arm reaches 20 cells far, and no farther.
    assert mask.sum() == pytest.approx(np.pi * 20**2, rel=0.02)


@pytest.mark.parametrize("hole", [0.0, -1.0, np.nan, np.inf])
def test_holes_are_no_depths(hole: float, tmp_path: Path) -> None:
    parts = scene()
    parts["depth"][0, :40] = hole
    image, mask, said = seen(kept(tmp_path, **parts))
    assert 0.75 < mask.mean() < 0.85
    assert np.isfinite(image).all()
    assert any("was seen by no camera" in line for line in said)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"depth": scene()["depth"] * 1000}, "depths are 800 m in the middle.* give depth_unit"),
        ({"depth": scene()["depth"] * 0}, "depths are 0 m in the middle"),
        ({"bounds": scene()["bounds"] + 5}, "0% of the workspace is seen"),
        ({"bounds": scene()["bounds"][:, ::-1]}, "lower end first"),
        ({"depth": scene(tilt=8)["depth"]}, "tilted by|no table is found"),
        ({"depth": scene()["depth"][:, :100]}, r"color is \[1, 200, 200, 3\]"),
        ({"color": scene()["color"].astype(float)}, "uint8"),
        ({"camera_to_world": scene()["camera_to_world"] * 1000}, "no rotation and translation"),
        ({"world_to_camera": scene()["camera_to_world"]}, "either camera_to_world or world_to_camera"),
        ({"reach": [9.0, 9.0, 0.1]}, "reach: nothing"),
        ({"bounds": np.array("here")}, "no numbers"),
    ],
)
def test_what_is_wrong_is_said(changes: dict[str, Any], message: str, tmp_path: Path) -> None:
    with pytest.raises(UserError, match=message):
        seen(kept(tmp_path, **scene() | changes))


def test_files_that_are_none_are_said(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="no such file or folder"):
        pictures.read(tmp_path / "none.npz")
    (tmp_path / "text.npz").write_text("no pictures")
    with pytest.raises(UserError, match="no npz file"):
        pictures.read(tmp_path / "text.npz")
    with pytest.raises(UserError, match=r"cameras.json: there is no such file"):
        pictures.read(tmp_path)
    (tmp_path / "cameras.json").write_text('{"cameras": [{"color": "../outside.png", "depth": "b.png"}]}')
    with pytest.raises(UserError, match=r"outside.png"):
        pictures.read(tmp_path)
    with pytest.raises(UserError, match="neither opencv nor opengl"):
        pictures.read(tmp_path, axes="ros")


def test_an_agent_decides_on_them_and_says_why(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    agent = xqmap.load("pretrained/grasping")
    decision = agent.decide_images(kept(tmp_path, **scene(), pixel_size=0.005), table=0.01)
    assert decision.selected.object == "blue cube"
    assert decision.selected.position == pytest.approx((0.5, 0.1, LEVEL + 0.04), abs=0.02)
    assert "I chose to pick the blue cube" in decision.why()
    assert decision.scene_seed is None
    said = capsys.readouterr().err
    assert "careful: the pictures name cells of 0.005 m, the agent knows 0.003125 m" in said


@pytest.mark.parametrize("command", ["explain", "chat"])
def test_the_commands_take_them(command: str, tmp_path: Path) -> None:
    kept(tmp_path, **scene())
    asked = ["question=Why this one?"] if command == "chat" else []
    told = [f"run={PRETRAINED / 'grasping'}", "images=scene.npz", "table=0.01", *asked]
    done = call(command, *told, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "I chose to pick the blue cube" in done.stdout
    assert "careful: the table lies at" in done.stderr
    assert (tmp_path / "figures" / "scene" / "explanation.html").exists()
    done = call(command, "images=scene.npz", cwd=tmp_path)
    assert done.returncode == 1
    assert "give run=DIR, too" in done.stderr


@pytest.mark.skipif(not RAVENS.exists(), reason="the scene of Ravens is not here")
def test_on_a_scene_that_ravens_drew_the_blue_cube_is_chosen() -> None:
    decision = xqmap.load("pretrained/grasping").decide_images(RAVENS, table=0.01)
    assert decision.selected.object == "blue cube"
    # Its shape is as sure as in a scene of the agent's own world.
    assert decision.selected.values["shape"] > 0.95
    assert any(thing.object == "cube of no known color" for thing in decision.objects)
