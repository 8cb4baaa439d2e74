"""The arm's chain in compiled code against MuJoCo's kinematics of the same arm, and scipy's interpolation."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation, Slerp

from extremal.estimator.poses import pose_exp
from extremal.sim import NOMINAL, ArmGeometry, ArmKinematics, get_arm
from extremal.tasks.arm_chain import Chain, flange_frames, line, missing, reached
from extremal.tasks.grasp_motion import T_TABLE_BASE


@pytest.mark.parametrize("geometry", [NOMINAL, get_arm("poor").draw(np.random.default_rng(0), NOMINAL)])
def test_pose_and_jacobian_are_those_of_mujoco(geometry: ArmGeometry) -> None:
    arm, chain = ArmKinematics(T_TABLE_BASE, geometry), Chain.of(T_TABLE_BASE, geometry)
    for q in np.random.default_rng(1).uniform(-3, 3, (20, 6)):
        pose, jacobian = arm.flange_motion(q)
        np.testing.assert_allclose(flange_frames(chain, q)[-1], pose, atol=1e-13)
        twist, found = missing(chain, q, pose)
        np.testing.assert_allclose(twist, 0.0, atol=1e-13)
        np.testing.assert_allclose(found, jacobian, atol=1e-13)


def test_what_is_missing_is_a_small_twist() -> None:
    chain, rng = Chain.of(T_TABLE_BASE, NOMINAL), np.random.default_rng(2)
    q, twist = rng.uniform(-2, 2, 6), 1e-4 * rng.normal(size=6)
    goal = flange_frames(chain, q)[-1] @ pose_exp(twist).as_matrix()
    np.testing.assert_allclose(missing(chain, q, goal)[0], twist, atol=1e-7)


def test_a_straight_line() -> None:
    start, end = (
        pose_exp(v)
        for v in np.random.default_rng(3).normal(scale=[0.1, 0.1, 0.1, 0.5, 0.5, 0.5], size=(2, 6))
    )
    found = line(start.as_matrix(), end.as_matrix(), 0.01, 0.05)
    s = (np.arange(len(found)) + 1) / len(found)
    turns = Slerp([0, 1], Rotation.concatenate([start.rotation, end.rotation]))(s)
    np.testing.assert_allclose(found[:, :3, :3], turns.as_matrix(), atol=1e-13)
    way = end.translation - start.translation
    np.testing.assert_allclose(found[:, :3, 3], start.translation + s[:, None] * way, atol=1e-14)
    far = (start.rotation.inv() * end.rotation).magnitude()
    assert len(found) == np.ceil(max(np.linalg.norm(way) / 0.01, far / 0.05))
    here = RigidTransform.identity().as_matrix()
    np.testing.assert_array_equal(line(here, here, 0.01, 0.05), here[None])


def test_newton_reaches_a_pose_nearby_and_nothing_far_off() -> None:
    chain, rng = Chain.of(T_TABLE_BASE, NOMINAL), np.random.default_rng(4)
    starts = rng.uniform([-1, -2, 0.5, -1, 0.5, -1], [1, -1, 2, 1, 2, 1], (20, 6))
    for q in starts:
        wanted = q + rng.uniform(-0.02, 0.02, 6)
        found, is_there = reached(chain, q, flange_frames(chain, wanted)[-1], 1e-10, 0.4)
        assert is_there
        np.testing.assert_allclose(found, wanted, atol=1e-8)
    q = starts[0]
    assert not reached(chain, q, RigidTransform.from_translation([5.0, 0, 0]).as_matrix(), 1e-10, 0.4)[1]
    no_arm = chain._replace(a=np.zeros(6), d=np.zeros(6))
    with pytest.raises(np.linalg.LinAlgError):
        reached(no_arm, q, np.eye(4), 1e-10, 0.4)
