"""The motion primitive *land*: flight under control, counted in control steps, never by the clock. Lengths in
metres.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import sapien

from .agents.aircraft import Aircraft

CRUISE_SPEED = 10.0
# Height over the point below which the descent is slow, and how slow (m/s); so far below the point it ends.
SLOW_BELOW = 0.5
TOUCH_SPEED = 0.4
SETTLE_STEPS = 4
# Moving farther than this after the touch is sliding.
SLID = 0.1
# PhysX reports contacts a little early, and after one simulation step at most this deep.
CONTACT = 0.005
# Control steps a second, and how many a landing takes at most beside those of its way at cruise speed (measured: 15.1).
CONTROL_RATE = 5
MANOEUVRES = 17


@dataclass(frozen=True)
class Touch:
    """The first contact.

    Attributes:
        spot: ``[3]``, where it was, world.
        aircraft: ``[3]``, where the aircraft was.
        foot: whether it was the foot's.
        other: what was touched.
    """

    spot: np.ndarray
    aircraft: np.ndarray
    foot: bool
    other: sapien.Entity


@dataclass(frozen=True)
class Landing:
    """How a landing went.

    Attributes:
        touch: None: there was none in time.
        tilt_deg: of the aircraft at rest.
        slid: whether it moved on after the touch.
        steps: control steps in all.
    """

    touch: Touch | None
    tilt_deg: float
    slid: bool
    steps: int


class Flight:
    """Flies the aircraft.

    Args:
        agent: the aircraft.
        control_step: runs one control step towards ``[1, 4]``: a target and the highest speed; speed 0: motors off.
        altitude: of the way to above the point.
    """

    def __init__(self, agent: Aircraft, control_step: Callable[[np.ndarray], None], altitude: float) -> None:
        self.agent, self._control_step, self.altitude = agent, control_step, altitude
        self._touch: Touch | None = None
        self.begin(np.zeros(2))

    def begin(self, place: np.ndarray) -> None:
        """Puts the aircraft, at rest and level, above ``place`` ``[2]``."""
        self._place, self._rehearsed = place, dict[tuple[float, ...], Touch | None]()
        self._hover()

    def rehearse(self, point: np.ndarray, limit: int) -> Touch | None:
        """The first contact of a landing at ``point`` from where the aircraft began: it is made, and undone."""
        key = tuple(point)
        if key not in self._rehearsed:
            self._rehearsed[key] = self.land(point, limit).touch
            self._hover()
        return self._rehearsed[key]

    def _hover(self) -> None:
        body = self.agent.robot._objs[0]
        body.set_root_pose(sapien.Pose([*self._place, self.altitude]))
        body.set_root_linear_velocity(np.zeros(3))
        body.set_root_angular_velocity(np.zeros(3))
        self.agent.controller.reset()

    def land(self, point: np.ndarray, limit: int) -> Landing:
        """Flies to above ``point`` ``[3]``, descends until contact, lets the aircraft come to rest with its motors off;
        ``limit``: the most control steps until contact.
        """
        link = self.agent.robot.links[0]._objs[0]
        target, speed, steps = np.array([point[0], point[1], self.altitude]), CRUISE_SPEED, 0
        self._touch = None
        while steps < limit and self._touch is None:
            offset, drift = np.linalg.norm(link.entity_pose.p[:2] - point[:2]), np.linalg.norm(link.linear_velocity[:2])
            if target[2] == self.altitude and offset < 0.03 and drift < 0.2:
                target[2] = point[2] + SLOW_BELOW / 2
            if target[2] < self.altitude and link.entity_pose.p[2] < point[2] + SLOW_BELOW:
                target[2], speed = point[2] - SLOW_BELOW, TOUCH_SPEED
            self._control_step(np.array([[*target, speed]]))
            steps += 1
        slid = False
        if touch := self._touch:
            for _ in range(SETTLE_STEPS):
                self._control_step(np.zeros((1, 4)))
            steps += SETTLE_STEPS
            slid = bool(np.linalg.norm(link.entity_pose.p[:2] - touch.aircraft[:2]) > SLID)
        up = np.clip(link.entity_pose.to_transformation_matrix()[2, 2], -1, 1)
        return Landing(touch, float(np.rad2deg(np.arccos(up))), slid, steps)

    def feel(self, contacts: list[sapien.physx.PhysxContact]) -> None:
        """Looks among the contacts of a simulation step for the first touch, and switches the motors off."""
        if self._touch is not None:
            return
        hull, foot = (link._objs[0] for link in self.agent.robot.links)
        for contact in contacts:
            touching = [point.position for point in contact.points if point.separation < CONTACT]
            own, other = sorted(contact.bodies, key=lambda body: body not in (hull, foot))
            if touching:
                self._touch = Touch(np.mean(touching, axis=0), hull.entity_pose.p, own == foot, other.entity)
                self.agent.controller.reset()
                return


def steps_needed(distance: float, altitude: float) -> int:
    """Control steps within which contact comes at the latest, ``distance`` away from where the flight begins."""
    return int(np.ceil((distance + altitude) / CRUISE_SPEED * CONTROL_RATE + MANOEUVRES))
