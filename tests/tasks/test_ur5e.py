"""The arm against the published pose, its own inverse, and the simulator's reading of its description."""

from __future__ import annotations

import numpy as np
import pytest
import sapien

from tasks.agents.kinematics import JOINT_LIMITS, forward, inverse
from tasks.agents.ur5e import JOINTS, TOOL, UR5e, joints_at


def test_flange_of_the_published_pose() -> None:
    pose = forward(np.deg2rad([0, -90, 90, -90, -90, 0]))
    assert pose[:3, 3] == pytest.approx([-0.4919, -0.1333, 0.4879], abs=1e-4)
    assert pose[:3, 2] == pytest.approx([0, 0, -1], abs=1e-9)


def test_inverse_finds_every_pose_again() -> None:
    joints = np.random.default_rng(0).uniform(-np.pi, np.pi, (500, 6))
    poses = forward(joints)
    solutions = inverse(poses)
    found = ~np.isnan(solutions).any(-1)
    assert found.any(-1).all()
    again = forward(np.nan_to_num(solutions))
    error = np.abs(again - poses[:, None]).max((-1, -2))
    assert error[found].max() < 1e-6


def test_a_path_over_the_table_is_followed_within_limits() -> None:
    line = np.linspace([0.3, -0.4, 0.1], [0.7, 0.4, 0.02], 200)
    start = joints_at(line[:1], np.zeros(6))[0]
    joints = joints_at(line, start)
    assert (np.abs(joints) <= JOINT_LIMITS).all()
    assert np.abs(np.diff(joints, axis=0)).max() < 0.1
    poses = forward(joints)
    tips = poses[:, :3, 3] + TOOL * poses[:, :3, 2]
    # The arm's base frame is turned by 180° against the world's.
    assert np.abs(tips * (-1, -1, 1) - line).max() < 1e-6
    with pytest.raises(ValueError, match="reach"):
        joints_at(np.array([[1.2, 0.0, 0.1]]), np.zeros(6))


@pytest.mark.sim
def test_the_description_is_the_same_arm() -> None:
    scene = sapien.Scene([sapien.physx.PhysxCpuSystem(), sapien.render.RenderSystem(sapien.Device("cpu"))])
    loader = scene.create_urdf_loader()
    loader.fix_root_link = True
    robot = loader.load(UR5e.urdf_path)
    assert tuple(joint.name for joint in robot.active_joints) == JOINTS
    links = {link.name: link for link in robot.links}
    root = links[robot.root.name].entity_pose.to_transformation_matrix()
    assert robot.root is not None
    for joints in np.random.default_rng(1).uniform(-2, 2, (20, 6)):
        robot.set_qpos(joints.astype(np.float32))
        tcp = links["tcp"].entity_pose.to_transformation_matrix()
        flange = forward(joints)
        tip = flange[:3, 3] + TOOL * flange[:3, 2]
        # Whatever way the base is set up, distances from its axis and height stay.
        seen = np.linalg.inv(root) @ tcp
        assert np.hypot(*seen[:2, 3]) == pytest.approx(np.hypot(*tip[:2]), abs=1e-4)
        assert seen[2, 3] == pytest.approx(tip[2], abs=1e-4)
