"""The flying agent: a free rigid body that thrust and torque steer to a point."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from mani_skill.agents.base_agent import BaseAgent
from mani_skill.agents.controllers.base_controller import BaseController, ControllerConfig
from mani_skill.agents.registration import register_agent

GRAVITY = 9.81
# As in aircraft.urdf: radius of the round foot, half an edge of the square hull, its height over the foot's sole (m).
FOOT_RADIUS, HULL_HALF, HULL_UNDERSIDE = 0.12, 0.25, 0.26


class ThrustController(BaseController):
    """Flies towards a target ``[3]`` (world, m) at limited speed and keeps level."""

    config: ThrustControllerConfig

    def _initialize_joints(self) -> None:
        self.joints: list[Any] = []
        self.active_joint_indices = torch.zeros(0, dtype=torch.int64)

    def _initialize_action_space(self) -> None:
        self.single_action_space = spaces.Box(-np.inf, np.inf, (4,), np.float32)

    def set_drive_property(self) -> None:
        """A free body has no joints to drive."""
        self._link = self.articulation.links[0]._objs[0]
        self._mass = sum(link._objs[0].mass for link in self.articulation.links)
        self._motors_on = False

    def reset(self) -> None:
        """Motors off until a target comes."""
        self._motors_on = False

    def set_action(self, action: Any) -> None:
        """``[1, 4]``: the target x, y, z (m) and the highest speed (m/s); a speed of 0 switches the motors off."""
        self._target = np.asarray(action, dtype=np.float64).reshape(4)
        self._motors_on = self._target[3] > 0

    def before_simulation_step(self) -> None:
        """Applies thrust against gravity and velocity error, and a torque that levels the body."""
        if not self._motors_on:
            return
        config, pose = self.config, self._link.entity_pose
        wanted = (self._target[:3] - pose.p) * config.position_gain
        speed = np.linalg.norm(wanted)
        if speed > self._target[3]:
            wanted *= self._target[3] / speed
        acceleration = (wanted - self._link.linear_velocity) * config.velocity_gain
        size = np.linalg.norm(acceleration)
        if size > config.max_acceleration:
            acceleration *= config.max_acceleration / size
        force = self._mass * (acceleration + np.array([0, 0, GRAVITY]))
        up = pose.to_transformation_matrix()[:3, 2]
        lean = np.cross(up, (0, 0, 1))
        torque = config.attitude_gain * lean - config.rate_gain * self._link.angular_velocity
        self._link.add_force_torque(force.astype(np.float32), torque.astype(np.float32))


@dataclass
class ThrustControllerConfig(ControllerConfig):
    """Gains of :class:`ThrustController`: per second, per second, m/s², N m per radian, N m s per radian."""

    position_gain: float = 2.5
    velocity_gain: float = 6.0
    max_acceleration: float = 12.0
    attitude_gain: float = 4.0
    rate_gain: float = 0.8
    controller_cls = ThrustController


@register_agent()
class Aircraft(BaseAgent):
    """A quadrotor with a landing pad, 2 kg, free in space."""

    uid = "xqmap_aircraft"
    urdf_path = str(Path(__file__).with_name("aircraft.urdf"))
    fix_root_link = False

    @property
    def _controller_configs(self) -> dict[str, Any]:
        return {"thrust": ThrustControllerConfig(joint_names=[])}

    def _after_init(self) -> None:
        # ManiSkill switches an agent's gravity off; this one has to fly.
        for link in self.robot.links:
            link.disable_gravity = False
