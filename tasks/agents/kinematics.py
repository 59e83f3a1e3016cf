"""Kinematics of the UR5e in closed form: forward, and all eight inverse branches. Lengths in metres, angles in radians.

Frames follow the Denavit-Hartenberg table that Universal Robots publishes; the base frame is the one of that table (an
arm with its first joint at 0 points along −x). Everything is batched over leading axes.
"""

from __future__ import annotations

import numpy as np

D1, D4, D5, D6 = 0.1625, 0.1333, 0.0997, 0.0996
A2, A3 = -0.425, -0.3922
# (a, d, α) of the six joints.
DH = ((0.0, D1, np.pi / 2), (A2, 0.0, 0.0), (A3, 0.0, 0.0), (0.0, D4, np.pi / 2), (0.0, D5, -np.pi / 2), (0.0, D6, 0.0))
# ±360°, the elbow ±180°.
JOINT_LIMITS = np.array([2, 2, 1, 2, 2, 2]) * np.pi
# Rounding may put a reachable pose this far outside the domain of an arc cosine.
ROUNDING = 1e-9


def joint_transform(joint: int, angle: np.ndarray) -> np.ndarray:
    """``[..., 4, 4]``: from the frame before ``joint`` (0 to 5) to the one after it, for angles ``[...]``."""
    a, d, alpha = DH[joint]
    c, s, zero = np.cos(angle), np.sin(angle), np.zeros_like(angle)
    ca, sa, one = np.cos(alpha), np.sin(alpha), np.ones_like(angle)
    rows = [
        [c, -s * ca, s * sa, a * c],
        [s, c * ca, -c * sa, a * s],
        [zero, sa * one, ca * one, d * one],
        [zero, zero, zero, one],
    ]
    return np.stack([np.stack(row, -1) for row in rows], -2)


def forward(joints: np.ndarray) -> np.ndarray:
    """Joint angles ``[..., 6]`` → the flange in the base frame ``[..., 4, 4]``."""
    joints = np.asarray(joints, dtype=np.float64)
    pose = joint_transform(0, joints[..., 0])
    for joint in range(1, 6):
        pose = pose @ joint_transform(joint, joints[..., joint])
    return pose


def inverse(pose: np.ndarray) -> np.ndarray:
    """Flange poses in the base frame ``[..., 4, 4]`` → joint angles ``[..., 8, 6]`` in (−π, π].

    The eight branches are shoulder × wrist × elbow, always in that order, so that one branch followed along a path is
    continuous. A branch that does not reach the pose is NaN. In the wrist's singularity (joint 5 at 0 or π) joint 6 is
    put to 0.
    """
    pose = np.asarray(pose, dtype=np.float64)
    solutions = []
    with np.errstate(invalid="ignore"):
        wrist = pose[..., :2, 3] - D6 * pose[..., :2, 2]
        lead = np.arctan2(wrist[..., 1], wrist[..., 0]) + np.pi / 2
        side = _arccos(D4 / np.hypot(wrist[..., 0], wrist[..., 1]))
        for shoulder in (1, -1):
            q1 = lead + shoulder * side
            s1, c1 = np.sin(q1), np.cos(q1)
            bend = _arccos((pose[..., 0, 3] * s1 - pose[..., 1, 3] * c1 - D4) / D6)
            for flip in (1, -1):
                q5 = flip * bend
                s5 = np.sin(q5)
                sign = np.sign(np.where(np.abs(s5) < ROUNDING, 0, s5))
                q6 = np.arctan2(
                    sign * (pose[..., 1, 1] * c1 - pose[..., 0, 1] * s1),
                    sign * (pose[..., 0, 0] * s1 - pose[..., 1, 0] * c1),
                )
                hand = joint_transform(4, q5) @ joint_transform(5, q6)
                # From the frame after joint 1 to the one after joint 4; upper arm and forearm are a chain of two in its
                # x-y plane.
                middle = _inverse(joint_transform(0, q1)) @ pose @ _inverse(hand)
                x, y = middle[..., 0, 3], middle[..., 1, 3]
                fold = _arccos((x * x + y * y - A2 * A2 - A3 * A3) / (2 * A2 * A3))
                for elbow in (1, -1):
                    q3 = elbow * fold
                    q2 = np.arctan2(y, x) - np.arctan2(A3 * np.sin(q3), A2 + A3 * np.cos(q3))
                    rest = _inverse(joint_transform(1, q2) @ joint_transform(2, q3)) @ middle
                    q4 = np.arctan2(rest[..., 1, 0], rest[..., 0, 0])
                    solutions.append(np.stack([q1, q2, q3, q4, q5, q6], -1))
    joints = np.stack(solutions, -2)
    joints = np.pi - np.mod(np.pi - joints, 2 * np.pi)
    return np.where(np.isnan(joints).any(-1, keepdims=True), np.nan, joints)


def reach(height: np.ndarray | float) -> np.ndarray:
    """Farthest distance of a flange that points straight down from the axis of joint 1, ``height`` above the base; NaN
    if there is none.
    """
    with np.errstate(invalid="ignore"):
        stretched = np.sqrt((A2 + A3) ** 2 - (np.asarray(height) + D6 - D1) ** 2)
    return np.hypot(stretched + D5, D4)


def _arccos(cosine: np.ndarray) -> np.ndarray:
    return np.arccos(np.where(np.abs(cosine) <= 1 + ROUNDING, np.clip(cosine, -1, 1), np.nan))


def _inverse(transform: np.ndarray) -> np.ndarray:
    rotation = np.swapaxes(transform[..., :3, :3], -1, -2)
    inverse = np.zeros_like(transform)
    inverse[..., :3, :3] = rotation
    inverse[..., :3, 3] = -(rotation @ transform[..., :3, 3:])[..., 0]
    inverse[..., 3, 3] = 1
    return inverse
