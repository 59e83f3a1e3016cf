"""The motion primitive *pick*: joint motion under control, counted in control steps, never by the clock. Metres,
radians.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import sapien

from .agents.kinematics import forward
from .agents.ur5e import TOOL, UR5e, joints_at
from .suction import SLIP, Suction
from .tabletop import body_of

# The fastest a joint turns on a way through the air (rad/s; the arm's own limit is π), and the shortest such way (s).
JOINT_SPEED = 2.6
SHORTEST = 0.2
# The cup's speed (m/s) on a straight way up or down, and close above the point, where it feels for contact.
SPEED = 0.4
TOUCH_SPEED = 0.06
# So far above the point (m) it slows down, and so far below it gives up.
FEEL_ABOVE, FEEL_BELOW = 0.012, 0.012
# Seconds the cup draws air before it lifts, and rests after it let go.
DRAW, REST = 0.06, 0.1


class Arm:
    """Moves the cup, one target per control step.

    Args:
        agent: the robot.
        control_step: runs one control step towards ``[12]``: six angles, six angular velocities.
        period: of a control step, s.
        limit: the most control steps of a pick; a motion that would need more stops where it is.

    Attributes:
        joints: ``[6]``, the angles last commanded.
        steps: control steps since :meth:`start`.
        late: whether the limit has stopped the arm since then.
    """

    def __init__(self, agent: UR5e, control_step: Callable[[np.ndarray], None], period: float, limit: int) -> None:
        self.agent, self._control_step, self.period = agent, control_step, period
        self.limit: float = limit
        self.joints, self.steps, self.late = np.zeros(6), 0, False

    def start(self) -> None:
        """Begins a pick: the count of control steps starts anew."""
        self.steps, self.late = 0, False

    def park(self, hover: float, home: np.ndarray) -> None:
        """Straight up to ``hover`` (m) and to the joint angles ``home``, uncounted: the arm must not stand in the next
        picture.
        """
        counted = self.steps, self.limit, self.late
        self.limit = np.inf
        self.hold()
        if self.sent[2] < hover:
            self.line(np.array([*self.sent[:2], hover]), SPEED)
        self.travel(home)
        self.steps, self.limit, self.late = counted

    @property
    def tip(self) -> np.ndarray:
        """``[4, 4]``: the cup's rim in the world, z out of the cup."""
        return np.asarray(self.agent.tcp.entity_pose.to_transformation_matrix(), dtype=np.float64)

    def travel(self, goal: np.ndarray, until: Callable[[], bool] = lambda: False) -> bool:
        """Turns all joints to ``goal`` ``[6]`` together, from rest to rest, or until ``until()``; returns whether that
        was why.
        """
        start, way = self.joints, goal - self.joints
        # The smoothest polynomial between two rests is 1.875 times as fast in its middle as on average.
        duration = max(SHORTEST, 1.875 * float(np.abs(way).max()) / JOINT_SPEED)
        count = max(2, round(duration / self.period))
        s = np.arange(1, count + 1)[:, None] / count
        return self._follow(start + s**3 * (10 - 15 * s + 6 * s * s) * way, until)

    def line(self, goal: np.ndarray, speed: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Moves the rim straight from where it was sent last to ``goal`` ``[3]``, or until ``until()``; returns whether
        that was why.
        """
        start = self.sent
        count = max(1, round(float(np.linalg.norm(goal - start)) / speed / self.period))
        s = np.arange(1, count + 1)[:, None] / count
        return self._follow(joints_at(start + s * (goal - start), self.joints), until)

    def wait(self, seconds: float) -> None:
        """Holds still."""
        self._follow(np.repeat(self.joints[None], max(1, round(seconds / self.period)), axis=0))

    def hold(self) -> None:
        """Stops where the arm is now: what was commanded and not reached is forgotten."""
        self.joints = np.asarray(self.agent.robot._objs[0].get_qpos(), dtype=np.float64)

    @property
    def sent(self) -> np.ndarray:
        """``[3]``: where the rim is when the commanded angles are reached."""
        flange = forward(self.joints)
        return (flange[:3, 3] + TOOL * flange[:3, 2]) * (-1, -1, 1)

    def _follow(self, path: np.ndarray, until: Callable[[], bool] = lambda: False) -> bool:
        for joints in path:
            if self.steps >= self.limit:
                self.late = True
                return False
            velocity = (joints - self.joints) / self.period
            self._control_step(np.concatenate((joints, velocity)))
            self.joints, self.steps = joints, self.steps + 1
            if until():
                return True
        return False


@dataclass(frozen=True)
class Attempt:
    """How a pick went.

    Attributes:
        touched: the body the cup met; None: nothing within its limits.
        sealed: whether the suction took hold.
        delivered: whether the body still hung on the cup over the bin.
        slip: the most the body moved against the cup, m.
        steps: control steps in all.
    """

    touched: sapien.Entity | None
    sealed: bool
    delivered: bool
    slip: float
    steps: int


def pick(
    arm: Arm,
    suction: Suction,
    point: np.ndarray,
    hover: float,
    home: np.ndarray,
    feel: Callable[[], sapien.Entity | None],
    seals: Callable[[sapien.Entity], bool],
) -> Attempt:
    """Moves above ``point``, steps down until contact, tries the suction, lifts, puts what hangs on the cup into the
    bin below its home.

    Args:
        arm: at its home.
        suction: of its cup.
        point: ``[3]``, world, m.
        hover: height (m) of the rim over the table on the way.
        home: ``[6]``, the joint angles over the bin (rad).
        feel: what the cup touches now.
        seals: whether the suction takes hold of that.

    Raises:
        ValueError: if the point is out of the arm's reach.
    """
    arm.start()
    over = np.array([point[0], point[1], hover])
    above = np.array([point[0], point[1], min(point[2] + FEEL_ABOVE, hover)])
    arm.travel(joints_at(over[None], arm.joints)[0])
    touched = None
    if arm.line(above, SPEED, lambda: feel() is not None) or arm.line(
        point - (0, 0, FEEL_BELOW), TOUCH_SPEED, lambda: feel() is not None
    ):
        touched = feel()
    arm.hold()
    slips = [0.0]

    def lost() -> bool:
        slips.append(suction.slip())
        return slips[-1] > SLIP

    sealed = touched is not None and seals(touched)
    if touched is not None and sealed:
        suction.activate(body_of(touched))
        arm.wait(DRAW)
    dropped = False
    for way in (lambda: arm.line(over, SPEED, lost), lambda: arm.travel(home, lost)):
        if way():
            dropped = True
            suction.release()
            # Without its load the arm goes on: it must not stand in the next picture.
            way()
    delivered = sealed and not dropped and not arm.late
    suction.release()
    arm.wait(REST)
    if arm.late:
        arm.park(hover, home)
    return Attempt(touched, sealed, delivered, max(slips), arm.steps)
