"""The UR5e with a suction cup: how it is driven, and where its cup can go."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces
from mani_skill.agents.base_agent import BaseAgent
from mani_skill.agents.controllers.base_controller import BaseController, ControllerConfig
from mani_skill.agents.registration import register_agent

from .kinematics import JOINT_LIMITS, inverse, reach

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
# Flange to the cup's rim, m.
TOOL = 0.12
# Torque limits, N m, and the drive's stiffness and damping (N m / rad, N m s / rad), joint by joint.
TORQUE = (150.0, 150.0, 150.0, 28.0, 28.0, 28.0)
STIFFNESS = (30000.0, 30000.0, 20000.0, 4000.0, 3000.0, 1000.0)
DAMPING = (1200.0, 1200.0, 600.0, 60.0, 40.0, 10.0)
# Of the eight inverse branches the one with the elbow up and the wrist outside.
BRANCH = 2


class JointController(BaseController):
    """Drives the joints to a target position with a target velocity, held until the next one."""

    def _initialize_action_space(self) -> None:
        self.single_action_space = spaces.Box(-np.inf, np.inf, (2 * len(JOINTS),), np.float32)

    def set_drive_property(self) -> None:
        """Gains and torque limits of the six joints."""
        self._joints = [joint._objs[0] for joint in self.joints]
        for joint, stiffness, damping, torque in zip(self._joints, STIFFNESS, DAMPING, TORQUE, strict=True):
            joint.set_friction(0.0)
            joint.set_drive_properties(stiffness, damping, torque, "force")

    def set_action(self, action: Any) -> None:
        """``[1, 12]``: six target angles (rad), then six target velocities (rad/s)."""
        target = np.asarray(action, dtype=np.float32).reshape(2, len(JOINTS))
        for index, joint in enumerate(self._joints):
            joint.set_drive_target(target[0, index])
            joint.set_drive_velocity_target(target[1, index])


@dataclass
class JointControllerConfig(ControllerConfig):
    """Settings of :class:`JointController`: none but the joints' names."""

    controller_cls = JointController


@register_agent()
class UR5e(BaseAgent):
    """Six joints, fixed to the table with its base frame turned by 180°: a shoulder at 0 then faces the table's +x."""

    uid = "xqmap_ur5e"
    urdf_path = str(Path(__file__).with_name("ur5e.urdf"))
    fix_root_link = True
    disable_self_collisions = True

    @property
    def _controller_configs(self) -> dict[str, Any]:
        return {"joints": JointControllerConfig(joint_names=list(JOINTS))}

    def _after_init(self) -> None:
        links = {link.name: link._objs[0] for link in self.robot.links}
        self.cup, self.tcp = links["cup"], links["tcp"]


def cup_reach(height: np.ndarray | float) -> np.ndarray:
    """Farthest horizontal distance (m) from the base axis of a cup that points down with its rim at ``height`` (m) over
    the table.
    """
    return reach(np.asarray(height) + TOOL)


def joints_at(points: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Joint angles ``[N, 6]`` (rad) along a path of the cup's rim, the tool pointing straight down.

    Args:
        points: ``[N, 3]``, the path in the world, m, dense enough that no joint turns more than half a turn from one
            point to the next.
        near: ``[6]``, the joint angles the path begins at: full turns are counted from there.

    Raises:
        ValueError: if a point is out of reach, or a joint would have to leave its limits.
    """
    points = np.asarray(points, dtype=np.float64)
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    c, s = np.cos(azimuth), np.sin(azimuth)
    pose = np.zeros((len(points), 4, 4))
    # In the base frame, which the world sees turned by 180°; the tool turns with the azimuth.
    pose[:, :3, :3] = np.moveaxis(np.array([[-s, c, 0 * c], [c, s, 0 * c], [0 * c, 0 * c, -1 - 0 * c]]), -1, 0)
    pose[:, :3, 3] = points * (-1, -1, 1) + (0, 0, TOOL)
    pose[:, 3, 3] = 1
    joints = np.unwrap(np.vstack((near, inverse(pose)[:, BRANCH])), axis=0)[1:]
    if not (np.abs(joints) <= JOINT_LIMITS).all():
        raise ValueError("the path leaves the arm's reach or its joint limits")
    return joints
