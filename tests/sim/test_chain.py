"""The Denavit-Hartenberg chain: against MuJoCo's kinematics of the same arm; derivatives against finite differences."""

import numpy as np
import pytest
from jacobian import assert_jacobian
from scipy.spatial.transform import RigidTransform, Rotation

from extremal.estimator import InvalidInput
from extremal.estimator.poses import pose_exp
from extremal.estimator.projection import adjoint
from extremal.sim import NOMINAL, ArmErrors, ArmGeometry, ArmKinematics
from extremal.sim.arm import JOINT_LIMITS
from extremal.sim.chain import ARM_PARAMETERS

T_WORLD_BASE = RigidTransform.from_components([0.3, -0.2, 0.5], Rotation.from_rotvec([0.4, -0.3, 0.8]))
# An arm on which nothing is as on the data sheet, by much more than on any real one.
ODD = ArmErrors(joint_offset=0.1, link_length=0.02, hand_eye_position=0.03, hand_eye_rotation=0.2).draw(
    np.random.default_rng(1)
)


def readings(count: int) -> np.ndarray:
    return np.random.default_rng(0).uniform(JOINT_LIMITS[:, 0], JOINT_LIMITS[:, 1], (count, 6))


def twists(poses: RigidTransform) -> np.ndarray:
    """(V, 6) = (translation, rotation vector), the logarithm of `pose_exp`."""
    return np.roll(poses.as_exp_coords(), 3, axis=-1)


@pytest.mark.parametrize("geometry", [NOMINAL, ODD], ids=["nominal", "odd"])
def test_camera_poses_agree_with_mujoco(geometry: ArmGeometry) -> None:
    q = readings(50)
    expected = ArmKinematics(T_WORLD_BASE, geometry).camera_poses(q)
    found = T_WORLD_BASE * geometry.camera_poses(q)
    np.testing.assert_allclose(found.as_matrix(), expected.as_matrix(), atol=1e-12)


@pytest.mark.parametrize("geometry", [NOMINAL, ODD], ids=["nominal", "odd"])
def test_derivatives(geometry: ArmGeometry) -> None:
    q = readings(5)
    here = geometry.flange_poses(q).inv()

    def moved(parameters: np.ndarray) -> np.ndarray:
        return twists(here * geometry.with_parameters(parameters).flange_poses(q))

    assert_jacobian(moved, geometry.derivatives(q), geometry.parameters, rtol=1e-9, step=1e-3)


def test_derivatives_of_camera_poses() -> None:
    q = readings(5)
    here = ODD.camera_poses(q).inv()

    def moved(change: np.ndarray) -> np.ndarray:
        chain = ODD.with_parameters(ODD.parameters + change[:18])
        mounting = ODD.T_flange_camera * pose_exp(change[18:])
        return twists(here * chain.flange_poses(q) * mounting)

    assert_jacobian(moved, ODD.camera_derivatives(q), np.zeros(24), rtol=1e-9, step=1e-3)


def test_the_first_columns_are_the_jacobian() -> None:
    """An encoder reading and a joint's zero move the flange alike."""
    q = readings(1)
    here = ODD.flange_poses(q).inv()
    assert_jacobian(
        lambda r: twists(here * ODD.flange_poses(r[None]))[0],
        ODD.derivatives(q)[0, :, :6],
        q[0],
        rtol=1e-9,
        step=1e-3,
    )


def test_adjoint() -> None:
    twist = np.random.default_rng(2).normal(size=6)
    left = T_WORLD_BASE * pose_exp(twist)
    right = pose_exp(adjoint(T_WORLD_BASE) @ twist) * T_WORLD_BASE
    np.testing.assert_allclose(left.as_matrix(), right.as_matrix(), atol=1e-14)


def test_parameters_by_name() -> None:
    values = np.arange(18.0) / 1000
    arm = NOMINAL.with_parameters(values)
    np.testing.assert_array_equal(arm.parameters, values)
    assert arm.link_a[1] == values[ARM_PARAMETERS.index("link_a_2")]
    assert arm.link_d[5] == values[ARM_PARAMETERS.index("link_d_6")]
    assert arm.joint_offset[0] == values[ARM_PARAMETERS.index("joint_offset_1")]


def test_published_numbers() -> None:
    """The UR5e at zero: stretched along -x, the flange at (a2 + a3, -(d4 + d6), d1 - d5)."""
    flange = NOMINAL.flange_poses(np.zeros((1, 6)))[0]
    np.testing.assert_allclose(flange.translation, [-0.8172, -0.2329, 0.0628], atol=1e-12)


def test_bad_values_are_named() -> None:
    with pytest.raises(InvalidInput, match="joint readings are"):
        NOMINAL.flange_poses([[0.0, 0, 0, 0, 0, np.nan]])
    with pytest.raises(InvalidInput, match="joint readings are"):
        NOMINAL.camera_poses(np.zeros(6))
    with pytest.raises(InvalidInput, match="link_a is"):
        ArmGeometry(link_a=np.zeros(5))
    with pytest.raises(InvalidInput, match="T_flange_camera"):
        ArmGeometry(T_flange_camera=RigidTransform.identity(3))
