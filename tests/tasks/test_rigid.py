"""Rigid motions in compiled code against scipy's, and a step's motion."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from extremal.estimator.poses import pose_exp
from extremal.tasks import rigid
from extremal.tasks.spaces import DT, SPEED, TURN, moved, pose_values

NONE = (0.0, 0.0, 0.0)


@pytest.mark.parametrize("size", [1e-12, 1e-6, 9e-4, 1.1e-3, 0.01, 0.3, 1.5])
def test_exponential_and_its_inverse(size: float) -> None:
    rng = np.random.default_rng(1)
    for twist in size * rng.uniform(-1, 1, (20, 6)):
        move, turn = tuple(twist[:3].tolist()), tuple(twist[3:].tolist())
        found = rigid.exponential(move, turn)
        np.testing.assert_allclose(found, pose_exp(twist).as_matrix(), atol=1e-14)
        np.testing.assert_allclose(rigid.rotation_vector(found), turn, atol=1e-14 * max(size, 1))
        np.testing.assert_allclose(rigid.product(found, rigid.inverse(found)), np.eye(4), atol=1e-14)


def test_quaternions_of_all_rotations() -> None:
    """By each of the four largest components, half a turn included."""
    axes = [*np.eye(3), *-np.eye(3), *np.random.default_rng(2).normal(size=(50, 3))]
    for axis in axes:
        for angle in (0.0, 1.0, 2.0, np.pi - 1e-9, np.pi):
            R = Rotation.from_rotvec(angle * np.asarray(axis) / np.linalg.norm(axis))
            pose = RigidTransform.from_rotation(R).as_matrix()
            found = np.array(rigid.quaternion(pose))
            assert found[3] >= 0
            np.testing.assert_allclose(Rotation.from_quat(found).as_matrix(), R.as_matrix(), atol=1e-14)
            np.testing.assert_allclose(pose_values(pose)[3:], found, atol=1e-7)


def test_a_rotation_becomes_orthonormal() -> None:
    pose = rigid.exponential((1.0, 2.0, 3.0), (0.5, -1.0, 0.3))
    off = pose.copy()
    off[:3, :3] += 1e-9 * np.random.default_rng(3).normal(size=(3, 3))
    rigid.orthonormal(off)
    np.testing.assert_allclose(off[:3, :3].T @ off[:3, :3], np.eye(3), atol=1e-15)
    np.testing.assert_allclose(off, pose, atol=1e-8)


def test_a_step_goes_as_far_as_it_may() -> None:
    pose = rigid.exponential((0.1, 0.2, 0.3), (0.5, -1.0, 0.3))
    action = np.array([0.0, 0.6, 0.8, 0.0, 0.5, 0.0])
    T = RigidTransform.from_matrix(moved(pose, action, "velocity"))
    off = RigidTransform.from_matrix(pose).inv() * T
    np.testing.assert_allclose(T.translation - pose[:3, 3], DT * SPEED * action[:3], atol=1e-15)
    np.testing.assert_allclose(off.rotation.as_rotvec(), DT * TURN * action[3:], atol=1e-15)
    assert np.linalg.norm(moved(pose, np.full(6, 1.0), "velocity")[:3, 3] - pose[:3, 3]) == pytest.approx(
        DT * SPEED
    )


def test_steps_towards_a_pose_arrive_there() -> None:
    pose = rigid.exponential((0.1, 0.2, 0.3), (0.5, -1.0, 0.3))
    goal = np.array([0.15, 0.2, 0.25, 0.9, -0.8, 0.2])
    for _ in range(40):
        before, pose = pose, moved(pose, goal, "pose")
        turn = rigid.rotation_vector(rigid.product(rigid.inverse(before), pose))
        assert np.linalg.norm(turn) <= DT * TURN + 1e-12
        assert np.linalg.norm(pose[:3, 3] - before[:3, 3]) <= DT * SPEED + 1e-12
    np.testing.assert_allclose(pose[:3, 3], goal[:3], atol=1e-12)
    np.testing.assert_allclose(pose[:3, :3], Rotation.from_rotvec(goal[3:]).as_matrix(), atol=1e-12)
