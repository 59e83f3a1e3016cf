"""The suction cup: when it seals, and how it holds. Lengths in metres, angles in degrees."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import sapien

from .tabletop import planes

RIM_RADIUS = 0.01
RIM_POINTS = 24
# The lip bends this much to lie on a surface, and bears this much of an incline; beyond that air leaks in.
LIP = 0.002
TILT_DEG = 15.0
# A body that has moved this far from where the cup took hold of it is lost.
SLIP = 0.005


@dataclass(frozen=True)
class Hits:
    """Where rays meet a body: distance along each ``[N]`` (inf: nowhere), and the surface's outward unit normal there
    ``[N, 3]``, world.
    """

    distance: np.ndarray
    normal: np.ndarray


def cast(kind: str, pose: np.ndarray, origins: np.ndarray, direction: np.ndarray) -> Hits:
    """Parallel rays against one body, exactly: it is a union of convex pieces.

    Args:
        kind: the body's, ``"cube"`` or ``"bowl"``.
        pose: ``[4, 4]``, of the body in the world.
        origins: ``[N, 3]``, where the rays begin, world, outside the body.
        direction: ``[3]``, theirs, world, unit.
    """
    rotation, position = pose[:3, :3], pose[:3, 3]
    start, along = (origins - position) @ rotation, direction @ rotation
    normals, offsets = planes(kind)[..., :3], planes(kind)[..., 3]
    rate = normals @ along
    outside = np.einsum("pfc,nc->npf", normals, start) - offsets
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = -outside / rate
    entering = np.where(rate < 0, crossing, -np.inf)
    first, last = entering.max(-1), np.where(rate > 0, crossing, np.inf).min(-1)
    missed = ((rate == 0) & (outside > 0)).any(-1) | (first > last) | (last < 0)
    distance = np.where(missed, np.inf, first)
    piece = distance.argmin(-1)
    rows = np.arange(len(start))
    face = entering[rows, piece].argmax(-1)
    return Hits(distance[rows, piece], normals[piece, face] @ rotation.T)


def rim(radius: float = RIM_RADIUS) -> np.ndarray:
    """``[RIM_POINTS, 3]``: points of the rim around the cup's axis z, in the frame of the tcp."""
    angles = np.arange(RIM_POINTS) * 2 * np.pi / RIM_POINTS
    return radius * np.column_stack((np.cos(angles), np.sin(angles), np.zeros(RIM_POINTS)))


def seals(kind: str, pose: np.ndarray, tcp: np.ndarray) -> bool:
    """Whether the whole rim lies on the body, within the lip's compliance of a plane; neither that nor the surface may
    tilt too far.

    Args:
        kind: the touched body's.
        pose: ``[4, 4]``, of the body in the world.
        tcp: ``[4, 4]``, of the cup's rim in the world, z out of the cup.
    """
    axis, room = tcp[:3, 2], 2 * LIP
    points = rim() @ tcp[:3, :3].T + tcp[:3, 3]
    hits = cast(kind, pose, points - room * axis, axis)
    gap = hits.distance - room
    if not np.isfinite(gap).all():
        return False
    local = rim()[:, :2]
    # Around a full ring the best plane's slopes are the first Fourier coefficients of the gap.
    slopes = 2 / RIM_POINTS * gap @ local / RIM_RADIUS**2
    uneven = np.abs(gap - gap.mean() - local @ slopes)
    steepest = min(float(np.cos(np.arctan(np.hypot(*slopes)))), float((-hits.normal @ axis).min()))
    return bool(uneven.max() <= LIP and gap.min() <= LIP and steepest >= np.cos(np.deg2rad(TILT_DEG)))


class Suction:
    """Holds a body at the cup with a drive whose limits are all zero.

    Args:
        tcp: the link at the cup's rim.
    """

    def __init__(self, tcp: sapien.physx.PhysxArticulationLinkComponent) -> None:
        self.tcp = tcp
        self.body: sapien.physx.PhysxRigidDynamicComponent | None = None

    def activate(self, body: sapien.physx.PhysxRigidDynamicComponent) -> None:
        """Takes hold of ``body`` as it lies."""
        self.body = body
        self._held_at = self.tcp.entity_pose.inv() * body.entity_pose
        self._drive = sapien.physx.PhysxDriveComponent(body)
        self._drive.parent = self.tcp
        self._drive.pose_in_parent, self._drive.pose_in_child = self._held_at, sapien.Pose()
        for limit in (
            self._drive.set_limit_x,
            self._drive.set_limit_y,
            self._drive.set_limit_z,
            self._drive.set_limit_twist,
        ):
            limit(0.0, 0.0)
        self._drive.set_limit_cone(0.0, 0.0)
        body.entity.add_component(self._drive)

    def release(self) -> None:
        """Lets go, if anything is held."""
        if self.body is not None:
            self.body.entity.remove_component(self._drive)
            self.body = None

    def slip(self) -> float:
        """How far (m) the body has moved from where it was taken hold of; 0 without a body."""
        if self.body is None:
            return 0.0
        return float(np.linalg.norm((self.tcp.entity_pose.inv() * self.body.entity_pose).p - self._held_at.p))
