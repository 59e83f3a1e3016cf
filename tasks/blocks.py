"""The field of blocks: what one is, how a field is drawn at random, and its geometry. Lengths in metres, angles in
degrees.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import sapien

COLORS: dict[str, tuple[int, int, int]] = {
    "green": (72, 150, 62),
    "red": (196, 58, 52),
    "blue": (52, 92, 178),
    "gray": (128, 128, 128),
}
FLAT_DEG = 5.0
# The lowest edge of a top, and the highest: below 4 m half precision stores heights to 2 mm.
LOW = (0.4, 1.4)
MAX_TOP = 3.8
# Least distance between the circles around two footprints.
GAP = 0.6
# Faces of the hexahedron below, counter-clockwise from outside; the last is the top.
FACES = ((0, 3, 2, 1), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7), (4, 5, 6, 7))
CORNERS = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) / 2


@dataclass(frozen=True)
class Block:
    """A box whose top may be inclined along its own length axis.

    Attributes:
        x: middle, world.
        y: middle, world.
        yaw: of the length axis, degrees.
        length: along the axis the top may rise.
        width: across it.
        height: of the top's middle.
        incline: of the top, degrees; 0 is flat.
        color: a name of ``COLORS``.
        shade: factor on the color.
    """

    x: float
    y: float
    yaw: float
    length: float
    width: float
    height: float
    incline: float
    color: str
    shade: float = 1.0

    @property
    def flat(self) -> bool:
        """Whether the angle between the vertical and the top's normal is at most ``FLAT_DEG``."""
        return self.incline <= FLAT_DEG

    @property
    def kind(self) -> str:
        """``"flat block"`` or ``"inclined block"``."""
        return "flat block" if self.flat else "inclined block"

    @property
    def name(self) -> str:
        """What a person calls it: "red flat block", "gray inclined block"."""
        return f"{self.color} {self.kind}"

    @property
    def axes(self) -> np.ndarray:
        """``[2, 2]``: unit vectors of length and width, world."""
        angle = np.deg2rad(self.yaw)
        return np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])

    @property
    def radius(self) -> float:
        """Of the circle around the footprint."""
        return float(np.hypot(self.length, self.width) / 2)

    @property
    def footprint(self) -> np.ndarray:
        """``[4, 2]``: corners, world, counter-clockwise."""
        return CORNERS * (self.length, self.width) @ self.axes + (self.x, self.y)

    @property
    def vertices(self) -> np.ndarray:
        """``[8, 3]``: four corners on the ground, then the four of the top."""
        corners = self.footprint
        top = np.column_stack((corners, self.top_at(corners)))
        return np.vstack((np.column_stack((corners, np.zeros(4))), top))

    def local(self, points: np.ndarray) -> np.ndarray:
        """World ``[M, 2]`` → along length and width ``[M, 2]`` from the middle."""
        return (np.asarray(points)[:, :2] - (self.x, self.y)) @ self.axes.T

    def top_at(self, points: np.ndarray) -> np.ndarray:
        """``[M]``: z of the top's plane above the world points ``[M, 2]``."""
        return self.height + np.tan(np.deg2rad(self.incline)) * self.local(points)[:, 0]

    def distance(self, points: np.ndarray) -> np.ndarray:
        """``[M]``: from the world points ``[M, 2]`` to the footprint's edge, negative inside."""
        beyond = np.abs(self.local(points)) - (self.length / 2, self.width / 2)
        return np.linalg.norm(np.maximum(beyond, 0), axis=1) + np.minimum(beyond.max(1), 0)

    def highest_within(self, points: np.ndarray, radii: np.ndarray) -> np.ndarray:
        """``[R, M]``: z of the top's highest point within each of the ``radii`` ``[R]`` of the world points
        ``[M, 2]``, seen from above; −inf where there is none.
        """
        reach = np.asarray(radii)[:, None]
        along, across = self.local(points).T
        beside = np.maximum(np.abs(across) - self.width / 2, 0)
        up = np.minimum(along + np.sqrt(np.maximum(reach**2 - beside**2, 0)), self.length / 2)
        highest = self.height + np.tan(np.deg2rad(self.incline)) * up
        return np.where(self.distance(points) <= reach, highest, -np.inf)

    def to_dict(self) -> dict[str, Any]:
        """Plain values, from which ``Block(**values)`` makes the same block."""
        return asdict(self)


def sample_field(
    rng: np.random.RandomState,
    half_size: float,
    count: int,
    incline_range: tuple[float, float],
    inclined_share: float,
    shades: tuple[float, float],
) -> list[Block]:
    """Up to ``count`` blocks, drawn at random, none closer than ``GAP`` to another (more do not always fit).

    Args:
        rng: source of the draw.
        half_size: the field reaches from −half_size to half_size in x and y.
        count: blocks to try for.
        incline_range: least and greatest angle of an inclined top.
        inclined_share: share of blocks with an inclined top.
        shades: least and greatest shade.
    """
    blocks: list[Block] = []
    for _ in range(20 * count):
        if len(blocks) == count:
            break
        length, width = rng.uniform(1.8, 4.5, 2)
        incline = float(rng.uniform(*incline_range)) if rng.rand() < inclined_share else 0.0
        slope = np.tan(np.deg2rad(incline))
        length = min(length, (MAX_TOP - LOW[1]) / slope) if slope > 0 else length
        x, y = rng.uniform(-half_size, half_size, 2)
        block = Block(
            x=float(x),
            y=float(y),
            yaw=float(rng.uniform(0, 360)),
            length=float(length),
            width=float(width),
            height=float(rng.uniform(*LOW) + slope * length / 2),
            incline=incline,
            color=str(rng.choice(list(COLORS))),
            shade=float(rng.uniform(*shades)),
        )
        if all(np.hypot(block.x - other.x, block.y - other.y) > block.radius + other.radius + GAP for other in blocks):
            blocks.append(block)
    return blocks


def material(color: str, shade: float) -> sapien.render.RenderMaterial:
    """A dull material that looks like the 8-bit color of that name, ``shade`` times as bright (the renderer computes in
    linear light).
    """
    base = [min((value / 255) ** 2.2 * shade, 1.0) for value in COLORS[color]]
    return sapien.render.RenderMaterial(base_color=(*base, 1.0), roughness=1.0)


def entity(block: Block) -> sapien.Entity:
    """The block as a static body with its picture, not yet part of a scene."""
    vertices, triangles, normals = _mesh(block)
    drawn = sapien.render.RenderBodyComponent()
    uvs = np.zeros((len(vertices), 2), dtype=np.float32)
    look = material(block.color, block.shade)
    drawn.attach(sapien.render.RenderShapeTriangleMesh(vertices, triangles, normals, uvs, look))
    body = sapien.physx.PhysxRigidStaticComponent()
    corners, scale = block.vertices.astype(np.float32), np.ones(3, dtype=np.float32)
    body.attach(sapien.physx.PhysxCollisionShapeConvexMesh(corners, scale, sapien.physx.get_default_material()))
    built = sapien.Entity()
    built.set_name(block.name)
    built.add_component(drawn)
    built.add_component(body)
    return built


def _mesh(block: Block) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Triangles for drawing, each face with its own corners so that its edges are sharp: vertices, triangles,
    normals.
    """
    corners = block.vertices
    vertices = np.vstack([corners[list(face)] for face in FACES])
    normals = []
    for face in FACES:
        a, b, c = corners[list(face[:3])]
        normal = np.cross(b - a, c - b)
        normals += [normal / np.linalg.norm(normal)] * 4
    triangles = [[4 * i + a, 4 * i + b, 4 * i + c] for i in range(len(FACES)) for a, b, c in ((0, 1, 2), (0, 2, 3))]
    return vertices.astype(np.float32), np.array(triangles, dtype=np.uint32), np.array(normals, dtype=np.float32)
