"""The work cell around the arm: workspace, cameras, table and bin. Lengths in metres, angles in radians."""

from __future__ import annotations

from typing import Any

import numpy as np
import sapien
from mani_skill.envs.scene import ManiSkillScene
from mani_skill.sensors.camera import CameraConfig

from .tabletop import material

# The workspace of Ravens. Its floor lies below the table, so that table and unseen cells differ in height as well (m).
BOUNDS = np.array([[0.25, 0.75], [-0.5, 0.5], [-0.01, 0.28]])
PIXEL_SIZE = 0.003125
# Ravens' cameras: positions (m) and their axes x right, y down, z forward as Euler angles about the fixed x, y, z
# (rad).
CAMERAS = {
    "front": ((1.0, 0.0, 0.75), (np.pi / 4, np.pi, -np.pi / 2)),
    "left": ((0.0, 0.5, 0.75), (np.pi / 4.5, np.pi, np.pi / 4)),
    "right": ((0.0, -0.5, 0.75), (np.pi / 4.5, np.pi, 3 * np.pi / 4)),
}
IMAGE = (640, 480)
INTRINSICS = np.array([[450.0, 0, 320], [0, 450, 240], [0, 0, 1]])
# The bin's middle (world x, y), its edges and the thickness of its walls; the arm's home is this high over it (m).
BIN, BIN_SIZE, WALL = np.array([-0.32, 0.42]), np.array([0.24, 0.34, 0.12]), 0.006
HOME_HEIGHT = 0.26
TABLE, TRAY = (51, 51, 51), (140, 140, 145)


def cameras() -> list[CameraConfig]:
    """The three that see the table."""
    width, height = IMAGE
    return [
        CameraConfig(
            name, camera_pose(*where), width, height, None, 0.01, 10.0, intrinsic=INTRINSICS, shader_pack="minimal"
        )
        for name, where in CAMERAS.items()
    ]


def onlooker() -> CameraConfig:
    """The one that films the arm, from beside the table."""
    eye, target = np.array([1.3, -0.85, 0.85]), np.array([0.2, 0.05, 0.16])
    return CameraConfig("beside", looking(eye, target), 960, 640, 0.8, 0.01, 10.0, shader_pack="default")


def build(scene: ManiSkillScene) -> None:
    """Puts table and bin into the scene."""
    table = scene.create_actor_builder()
    _box(table, (0.25, 0.0, -0.02), (1.5, 1.6, 0.04), TABLE)
    table.initial_pose = sapien.Pose()
    table.build_static("table")
    tray = scene.create_actor_builder()
    (x, y), (length, width, height) = BIN, BIN_SIZE
    _box(tray, (x, y, WALL / 2), (length, width, WALL), TRAY)
    for side in (-1, 1):
        _box(tray, (x + side * length / 2, y, height / 2), (WALL, width, height), TRAY)
        _box(tray, (x, y + side * width / 2, height / 2), (length, WALL, height), TRAY)
    tray.initial_pose = sapien.Pose()
    tray.build_static("bin")


def _box(
    builder: Any, middle: tuple[float, float, float], size: tuple[float, float, float], color: tuple[int, int, int]
) -> None:
    pose, half = sapien.Pose(middle), np.array(size) / 2
    builder.add_box_collision(pose, half)
    builder.add_box_visual(pose, half, material=material(color))


def camera_pose(position: tuple[float, float, float], euler: tuple[float, float, float]) -> sapien.Pose:
    """A SAPIEN camera (x forward, y left, z up) from place and Euler angles (fixed axes, rad) of one with x right, y
    down, z forward.
    """
    rotation = np.eye(3)
    for axis, angle in enumerate(euler):
        a, b = [i for i in range(3) if i != axis]
        turn = np.eye(3)
        sign = -1 if axis == 1 else 1
        turn[a, a] = turn[b, b] = np.cos(angle)
        turn[b, a], turn[a, b] = sign * np.sin(angle), -sign * np.sin(angle)
        rotation = turn @ rotation
    return _posed(np.column_stack((rotation[:, 2], -rotation[:, 0], -rotation[:, 1])), np.array(position))


def looking(eye: np.ndarray, target: np.ndarray) -> sapien.Pose:
    """A SAPIEN camera at ``eye`` ``[3]`` that looks at ``target`` ``[3]``, upright."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    left = np.cross((0, 0, 1), forward)
    left /= np.linalg.norm(left)
    return _posed(np.column_stack((forward, left, np.cross(forward, left))), eye)


def _posed(rotation: np.ndarray, position: np.ndarray) -> sapien.Pose:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, position
    return sapien.Pose(matrix)
