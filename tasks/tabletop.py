"""What lies on the table: cubes and bowls, their shapes, their layout. Lengths in metres, angles in degrees."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import sapien

# In the order of the rainbow: the rank of a color is its place, red 0 to purple 1.
COLORS: dict[str, tuple[int, int, int]] = {
    "red": (255, 87, 89),
    "orange": (242, 142, 43),
    "yellow": (237, 201, 72),
    "green": (89, 169, 79),
    "blue": (78, 121, 167),
    "purple": (176, 122, 161),
}
RANK = {color: place / (len(COLORS) - 1) for place, color in enumerate(COLORS)}
CUBE = 0.04
# A bowl's wall, seen in a cut: (radius, height) inside from the middle to the rim, and outside.
INSIDE = np.array([(0.0, 0.004), (0.010, 0.0077), (0.028, 0.0175), (0.0545, 0.035)])
OUTSIDE = np.array([(0.0, 0.0), (0.022, 0.0), (0.034, 0.0095), (0.0575, 0.035)])
SECTORS = 24
# Of a convex part: its corners by face, counter-clockwise from outside.
FACES = ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7))
MASS = {"cube": 0.01, "bowl": 0.1}
TOP = {"cube": CUBE, "bowl": float(OUTSIDE[-1, 1])}
RADIUS = {"cube": CUBE / np.sqrt(2), "bowl": float(OUTSIDE[-1, 0])}
FRICTION = 1.0


@dataclass(frozen=True)
class Thing:
    """A cube or a bowl where it was put down.

    Attributes:
        kind: ``"cube"`` or ``"bowl"``.
        color: a name of ``COLORS``.
        x: middle, world.
        y: middle, world.
        yaw: degrees.
        tint: what is added to its red, green and blue, 8-bit.
        level: how many cubes it stands on.
    """

    kind: str
    color: str
    x: float
    y: float
    yaw: float = 0.0
    tint: tuple[float, float, float] = (0.0, 0.0, 0.0)
    level: int = 0

    def __post_init__(self) -> None:
        if self.kind not in MASS or self.color not in COLORS:
            raise ValueError(
                f"an object is one of {', '.join(MASS)} in one of {', '.join(COLORS)}, not a {self.color} {self.kind}"
            )

    @property
    def name(self) -> str:
        """What a person calls it: "blue cube", "red bowl"."""
        return f"{self.color} {self.kind}"

    @property
    def rank(self) -> float:
        """Of its color, 0 to 1."""
        return RANK[self.color]

    def to_dict(self) -> dict[str, Any]:
        """Plain values, from which ``Thing(**values)`` makes the same object."""
        return asdict(self)


@cache
def pieces(kind: str) -> tuple[np.ndarray, ...]:
    """The convex parts ``[8, 3]`` that make up an object's body, in its own frame (on the table, z from 0): a bowl is
    hollow.
    """
    if kind == "cube":
        half = CUBE / 2
        corners = np.array(
            [[x, y, z] for z in (0, CUBE) for x, y in ((-half, -half), (half, -half), (half, half), (-half, half))]
        )
        return (corners,)
    angles = np.linspace(0, 2 * np.pi, SECTORS + 1)
    parts = []
    for first, second in pairwise(angles):
        for ring in range(len(INSIDE) - 1):
            # Lower quadrilateral and upper one, each around the piece in the same sense.
            quads = [
                [(wall[ring], first), (wall[ring + 1], first), (wall[ring + 1], second), (wall[ring], second)]
                for wall in (OUTSIDE, INSIDE)
            ]
            parts.append(np.array([[r * np.cos(a), r * np.sin(a), z] for quad in quads for (r, z), a in quad]))
    return tuple(parts)


@cache
def planes(kind: str) -> np.ndarray:
    """``[pieces, 6, 4]``: outward normal and offset of the faces of :func:`pieces` (n·x ≤ d inside)."""
    result = []
    for corners in pieces(kind):
        middle = corners.mean(0)
        for face in FACES:
            quad = corners[list(face)]
            # Of a quadrilateral that is a triangle, or a line, the diagonals still tell what plane there is.
            normal = np.cross(quad[2] - quad[0], quad[3] - quad[1])
            size = np.linalg.norm(normal)
            normal = normal / size if size > 1e-12 else np.zeros(3)
            offset = normal @ quad.mean(0)
            if normal @ middle > offset:
                normal, offset = -normal, -offset
            result.append([*normal, offset])
    return np.array(result).reshape(-1, 6, 4)


def footprint(kind: str, position: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """``[P, 2]``: outline from above of an object at ``position`` ``[3]`` with ``rotation`` ``[3, 3]``,
    counter-clockwise, convex.
    """
    if kind == "bowl":
        angles = np.arange(SECTORS) * 2 * np.pi / SECTORS
        outline = RADIUS["bowl"] * np.column_stack((np.cos(angles), np.sin(angles), np.zeros(SECTORS)))
    else:
        # The face that looks up most, so that a cube that was tipped over has a square outline too.
        axes = sorted(rotation.T, key=lambda axis: abs(axis[2]))[:2]
        outline = (
            CUBE / 2 * np.array([a * axes[0] + b * axes[1] for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]) @ rotation
        )
    flat = (outline @ rotation.T)[:, :2] + position[:2]
    x, y = flat.T
    area = (x * np.roll(y, -1) - y * np.roll(x, -1)).sum()
    return flat if area > 0 else flat[::-1]


def cube_top(pose: np.ndarray) -> np.ndarray:
    """``[3]``: the middle of the face that looks up most, of a cube at ``pose`` ``[4, 4]``."""
    middle = pose[:3, 3] + CUBE / 2 * pose[:3, 2]
    axis = pose[:3, int(np.abs(pose[2, :3]).argmax())]
    return middle + CUBE / 2 * axis * np.sign(axis[2])


def carried(poses: Sequence[np.ndarray]) -> list[int | None]:
    """For each of some cubes at ``poses`` ``[4, 4]`` the place of the one that it stands on; None for the table."""
    tops = [cube_top(pose) for pose in poses]

    def below(pose: np.ndarray) -> int | None:
        middle = cube_top(pose) - np.array([0, 0, CUBE])
        near = [i for i, top in enumerate(tops) if np.abs(top - middle).max() < CUBE / 2]
        return near[0] if near else None

    return [below(pose) for pose in poses]


def material(
    color: tuple[int, int, int], tint: tuple[float, float, float] = (0, 0, 0), roughness: float = 0.9
) -> sapien.render.RenderMaterial:
    """A material that looks like the 8-bit ``color`` + ``tint`` (the renderer computes in linear light)."""
    base = [(min(max(value + shift, 0), 255) / 255) ** 2.2 for value, shift in zip(color, tint, strict=True)]
    return sapien.render.RenderMaterial(base_color=(*base, 1.0), roughness=roughness)


def entity(thing: Thing) -> sapien.Entity:
    """The object as a rigid body with its picture, not yet part of a scene."""
    body = sapien.physx.PhysxRigidDynamicComponent()
    surface = sapien.physx.PhysxMaterial(FRICTION, FRICTION, 0.0)
    for corners in pieces(thing.kind):
        body.attach(
            sapien.physx.PhysxCollisionShapeConvexMesh(
                corners.astype(np.float32), np.ones(3, dtype=np.float32), surface
            )
        )
    inertia = body.inertia * MASS[thing.kind] / body.mass
    body.mass, body.inertia = MASS[thing.kind], inertia
    drawn = sapien.render.RenderBodyComponent()
    vertices, triangles, normals = _mesh(thing.kind)
    uvs = np.zeros((len(vertices), 2), dtype=np.float32)
    drawn.attach(
        sapien.render.RenderShapeTriangleMesh(
            vertices, triangles, normals, uvs, material(COLORS[thing.color], thing.tint)
        )
    )
    built = sapien.Entity()
    built.set_name(thing.name)
    built.add_component(body)
    built.add_component(drawn)
    angle = np.deg2rad(thing.yaw) / 2
    built.set_pose(sapien.Pose([thing.x, thing.y, CUBE * thing.level], [np.cos(angle), 0, 0, np.sin(angle)]))
    return built


def body_of(built: sapien.Entity) -> sapien.physx.PhysxRigidDynamicComponent:
    """The rigid body of an object."""
    return built.find_component_by_type(sapien.physx.PhysxRigidDynamicComponent)


def pose_of(built: sapien.Entity) -> np.ndarray:
    """``[4, 4]``: of an object in the world."""
    return np.asarray(built.pose.to_transformation_matrix(), dtype=np.float64)


@cache
def _mesh(kind: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Triangles for drawing: vertices, triangles, normals; round where a bowl is round, sharp at edges."""
    if kind == "cube":
        (corners,) = pieces(kind)
        sides = corners[np.array(FACES)]
        across = np.cross(sides[:, 1] - sides[:, 0], sides[:, 2] - sides[:, 0])
        return _triangles(sides, np.repeat(across[:, None], 4, axis=1))
    angles = np.linspace(0, 2 * np.pi, 2 * SECTORS + 1)
    spokes = np.stack((np.cos(angles), np.sin(angles)), -1)
    # Up the outside, over the rim, down the inside.
    wall = np.vstack((OUTSIDE, INSIDE[::-1]))
    quads, normals = [], []
    for (r0, z0), (r1, z1) in pairwise(wall):
        for first, second in pairwise(spokes):
            quads.append(
                [
                    [*(r * spoke), z]
                    for r, z, spoke in ((r0, z0, first), (r0, z0, second), (r1, z1, second), (r1, z1, first))
                ]
            )
            normals.append([[*((z1 - z0) * spoke), r0 - r1] for spoke in (first, second, second, first)])
    return _triangles(np.array(quads), np.array(normals))


def _triangles(quads: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    normals = normals.reshape(-1, 3)
    corners = 4 * np.arange(len(quads))[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])
    unit = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    return quads.reshape(-1, 3).astype(np.float32), corners.reshape(-1, 3).astype(np.uint32), unit.astype(np.float32)
