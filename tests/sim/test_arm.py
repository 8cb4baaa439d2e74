"""Forward kinematics against the Denavit-Hartenberg formula; the hand; inverse kinematics along paths."""

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from extremal.estimator import Camera, ExtremalError
from extremal.sim import ArmKinematics, LinearMotion, UnreachablePose
from extremal.sim.arm import CAMERA, CUP_LENGTH, CUP_TIP, JOINT_LIMITS, JOINTS, add_arm
from extremal.sim.chain import DH_A, DH_ALPHA, DH_D, T_FLANGE_CAMERA, ArmGeometry

TARGET = np.array([0.0, 0.0, 0.1])


def dh_flange(q: NDArray[np.floating]) -> NDArray[np.floating]:
    """T_base_flange (4, 4), by the textbook's matrices."""
    T = np.eye(4)
    for theta, a, d, alpha in zip(q, DH_A, DH_D, DH_ALPHA, strict=True):
        ct, st, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
        T = T @ np.array(
            [
                [ct, -st * ca, st * sa, a * ct],
                [st, ct * ca, -ct * sa, a * st],
                [0, sa, ca, d],
                [0, 0, 0, 1],
            ]
        )
    return T


def test_forward_kinematics_is_the_denavit_hartenberg_formula() -> None:
    rng = np.random.default_rng(0)
    T_world_base = RigidTransform.from_components([0.3, -0.2, 0.5], Rotation.random(rng=rng))
    arm = ArmKinematics(T_world_base)
    q = rng.uniform(JOINT_LIMITS[:, 0], JOINT_LIMITS[:, 1], (50, 6))
    poses = arm.camera_poses(q)
    for i in range(50):
        expected = T_world_base.as_matrix() @ dh_flange(q[i]) @ T_FLANGE_CAMERA.as_matrix()
        np.testing.assert_allclose(poses[i].as_matrix(), expected, atol=1e-12)


def test_published_numbers() -> None:
    # UR5e at zero: stretched along -x, the flange at (a2 + a3, -(d4 + d6), d1 - d5).
    T = dh_flange(np.zeros(6))
    np.testing.assert_allclose(T[:3, 3], [-0.8172, -0.2329, 0.0628], atol=1e-12)


def test_masses() -> None:
    """The data sheet's 20.6 kg are those of the links and of a base that does not move."""
    spec = mujoco.MjSpec()
    add_arm(spec, RigidTransform.identity())
    model = spec.compile()
    masses = [model.body(name).mass[0] for name in JOINTS]
    assert sum(masses) == pytest.approx(17.7)
    assert model.body("flange").mass[0] < 0.5  # camera and cup
    # at zero the upper arm's centre of mass is half-way to the elbow, 113 mm beside the shoulder's plane
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.body("shoulder_lift").xipos, [-0.2125, -0.11336, 0.1625], atol=1e-9)


def test_joint_limits_in_radians_in_any_model() -> None:
    for degree in (True, False):
        spec = mujoco.MjSpec()
        spec.compiler.degree = degree
        add_arm(spec, RigidTransform.identity())
        np.testing.assert_allclose(spec.compile().jnt_range, JOINT_LIMITS)


def test_cup_tip_and_arm_stay_out_of_sight() -> None:
    """Everything of the arm lies outside the field of view along the whole motion."""
    motion = LinearMotion(views=9, baseline=0.8, distance=0.4)
    arm = ArmKinematics.behind(motion.centre(TARGET))
    q = arm.joint_positions(motion.poses(TARGET, np.random.default_rng(0)))
    spec = mujoco.MjSpec()
    add_arm(spec, arm.T_world_base)
    model = spec.compile()
    data = mujoco.MjData(model)
    camera = Camera()
    u, v = np.meshgrid(np.linspace(-0.5, camera.width - 0.5, 33), np.linspace(-0.5, camera.height - 0.5, 25))
    rays = camera.rays(np.stack([u, v], axis=-1).reshape(-1, 2))
    for row, pose in zip(q, arm.camera_poses(q).as_matrix(), strict=True):
        data.qpos[:] = row
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(data.camera(CAMERA).xpos, pose[:3, 3], atol=1e-12)
        for ray in rays @ pose[:3, :3].T:
            assert mujoco.mj_ray(model, data, pose[:3, 3], ray, None, 1, -1, np.zeros(1, np.int32)) < 0
    tip = T_FLANGE_CAMERA.inv().apply([0, 0, CUP_LENGTH])
    assert np.degrees(np.arctan2(np.hypot(*tip[:2]) - 0.015, tip[2])) > 50
    assert model.site(CUP_TIP).pos[2] == CUP_LENGTH


@pytest.mark.parametrize("distance", [0.4, 0.6, 1.2])
@pytest.mark.parametrize("baseline", [0.05, 0.4, 0.8])
@pytest.mark.parametrize("views", [3, 10])
def test_paths_are_reached_on_one_branch(distance: float, baseline: float, views: int) -> None:
    motion = LinearMotion(views, baseline, distance)
    poses = motion.poses(TARGET, np.random.default_rng(views))
    arm = ArmKinematics.behind(motion.centre(TARGET))
    q = arm.joint_positions(poses)
    actual = arm.camera_poses(q)
    np.testing.assert_allclose(actual.translation, poses.translation, atol=1e-9)
    assert np.max((actual.rotation.inv() * poses.rotation).magnitude()) < 1e-9
    assert np.all((q > JOINT_LIMITS[:, 0]) & (q < JOINT_LIMITS[:, 1]))
    # One branch: the elbow never passes zero, joints move no faster than the camera needs.
    assert np.all(q[:, 2] < -0.3)
    assert np.abs(np.diff(q, axis=0)).max() < 20 * baseline / (views - 1) + 0.01


def test_paths_of_another_arm_are_reached() -> None:
    """Inverse kinematics is that of the geometry believed in."""
    geometry = ArmGeometry(
        np.full(6, 0.01),
        np.full(6, 2e-3),
        np.full(6, -2e-3),
        T_FLANGE_CAMERA * RigidTransform.from_translation([0.01, 0, 0]),
    )
    motion = LinearMotion(5)
    poses = motion.poses(TARGET, np.random.default_rng(0))
    arm = ArmKinematics.behind(motion.centre(TARGET), geometry)
    q = arm.joint_positions(poses)
    reached = arm.T_world_base * geometry.camera_poses(q)
    np.testing.assert_allclose(reached.as_matrix(), poses.as_matrix(), atol=1e-9)


def test_elevations() -> None:
    for elevation in np.radians([-5, 0, 30, 45]):
        motion = LinearMotion(5, 0.4, 0.6, elevation=elevation)
        poses = motion.poses(TARGET, np.random.default_rng(0))
        arm = ArmKinematics.behind(motion.centre(TARGET))
        actual = arm.camera_poses(arm.joint_positions(poses))
        np.testing.assert_allclose(actual.translation, poses.translation, atol=1e-9)


def test_out_of_reach() -> None:
    motion = LinearMotion(3, 3.0, 0.6)
    arm = ArmKinematics.behind(motion.centre(TARGET))
    with pytest.raises(UnreachablePose, match="can't bring its camera to") as caught:
        arm.joint_positions(motion.poses(TARGET, np.random.default_rng(0)))
    assert isinstance(caught.value, ExtremalError)
    with pytest.raises(UnreachablePose):
        arm.joint_positions(RigidTransform.from_translation([[5.0, 0, 0]]))


@pytest.mark.parametrize("far", [1e6, 1e300])
def test_a_path_without_end_is_out_of_reach_at_once(far: float) -> None:
    motion = LinearMotion(3)
    arm, poses = (
        ArmKinematics.behind(motion.centre(TARGET)),
        motion.poses(TARGET, np.random.default_rng(0)).as_matrix(),
    )
    poses[2, 0, 3] = far
    with pytest.raises(UnreachablePose, match="out of reach"):
        arm.joint_positions(RigidTransform.from_matrix(poses))


def test_bad_input() -> None:
    arm = ArmKinematics(RigidTransform.identity())
    with pytest.raises(ExtremalError, match="joint positions"):
        arm.camera_poses(np.full((1, 6), np.nan))
    with pytest.raises(ExtremalError, match="path"):
        arm.joint_positions(RigidTransform.identity())
