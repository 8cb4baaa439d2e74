"""The joint calibration, on corners projected by the exact camera: derivatives by differences, covariance by Monte Carlo."""

import numpy as np
import pytest
from jacobian import numeric_jacobian
from scipy.spatial.transform import RigidTransform

from extremal.estimator import Camera
from extremal.estimator.board import Board
from extremal.estimator.calibrate import CalibrationFit, calibrate
from extremal.estimator.calibration import HAND_EYE
from extremal.estimator.calibration_equations import ARM, Sightings, State, linearise
from extremal.estimator.corners import Corners
from extremal.estimator.poses import pose_exp, pose_log
from extremal.estimator.projection import INTRINSICS, intrinsics, turning
from extremal.sim import NOMINAL, ArmKinematics
from extremal.sim.arm_errors import FlangeKinematics
from extremal.sim.board_motion import BoardMotion
from extremal.sim.board_place import upright_board
from extremal.sim.rig import Rig

BOARD, SIGMA, BORDER = Board(), 0.005, 8.0  # [px] of corners; [px] at the image's border without corners
TARGET = np.array([0.0, 0.0, 0.25])


def seen(rig: Rig, views: int, seed: int) -> tuple[list[Corners], FlangeKinematics, RigidTransform]:
    """Corners and flange poses of a rig, and T_board_camera (V): errors are drawn by the laws that are stated."""
    rng = np.random.default_rng([seed, 7])
    motion = BoardMotion(views=views)
    arm = ArmKinematics.behind(motion.centre(TARGET), NOMINAL)
    joints = arm.joint_positions(motion.poses(TARGET, rng))
    noise, errors = rig.errors.scatter(views, rng)
    T_board_base = upright_board(BOARD, TARGET).T_world_object.inv() * arm.T_world_base
    T_board_camera = T_board_base * rig.geometry.camera_poses(joints) * pose_exp(errors)
    size = np.array([rig.camera.width, rig.camera.height])
    corners = []
    for i in range(views):
        pixels = rig.camera.project(T_board_camera[i].inv().apply(BOARD.corners))
        ids = np.flatnonzero(np.all((pixels > BORDER) & (pixels < size - BORDER), axis=1))
        noisy = pixels[ids] + SIGMA * rng.standard_normal((len(ids), 2))
        corners.append(Corners(ids, noisy, np.tile(SIGMA**2 * np.eye(2), (len(ids), 1, 1))))
    return corners, rig.errors.flange_model(NOMINAL, joints + noise), T_board_camera


def calibrated(seed: int, arm: str, camera: str = "industrial") -> tuple[CalibrationFit, Rig, RigidTransform]:
    rig = Rig.individual(arm, camera, seed)
    corners, flange, T_board_camera = seen(rig, 15, seed)
    size = rig.camera.width, rig.camera.height
    sigma = dict(zip(flange.names, flange.scales.tolist(), strict=True))
    return calibrate(BOARD, corners, flange, size, Camera(*size), arm_sigma=sigma), rig, T_board_camera


def test_gradient_of_all_unknowns() -> None:
    """Far from the minimum, with the two scales of views unequal, and errors of views that are not small."""
    rng = np.random.default_rng(0)
    rig = Rig.individual("typical", "webcam", 0)
    corners, flange, _ = seen(rig, 3, 0)
    sightings, scales = Sightings.of(BOARD, corners), np.array([1.3, 0.8, 1.7])
    prior = flange(np.zeros(len(flange.names)))
    T_board = upright_board(BOARD, TARGET).T_world_object
    base = ArmKinematics.behind(BoardMotion().centre(TARGET), NOMINAL).T_world_base
    state = State(
        rig.camera,
        NOMINAL.T_flange_camera,
        base.inv() * T_board,
        rng.standard_normal(len(flange.names)),
        3 * rng.standard_normal((3, prior.root.shape[2])),
    )
    common = ARM.start + len(state.c)

    def half_cost(step: np.ndarray) -> float:
        moved = state.moved(step[:common], step[common:].reshape(state.z.shape))
        return linearise(moved, sightings, flange, scales[1:]).cost(scales[0]) / 2

    here = linearise(state, sightings, flange, scales[1:])
    normal = here.normal(scales)
    analytic = np.concatenate([normal.gradient, normal.own_gradient.ravel()])
    # steps that move a corner by about 0.1 px
    sizes = np.full(len(analytic), 1e-2)
    sizes[:9] = [0.1, 0.1, 0.1, 0.1, 1e-4, 1e-4, 1e-5, 1e-5, 1e-4]
    sizes[9:21] = 1e-5
    numeric = numeric_jacobian(half_cost, np.zeros(len(analytic)), sizes)
    # both are sums of large terms of either sign: compare with what a corner of the prior's accuracy would give
    curvature = np.concatenate([np.diagonal(normal.common), np.einsum("vkk->vk", normal.own).ravel()])
    scale = np.abs(numeric) + np.sqrt(curvature)
    assert np.max(np.abs(analytic - numeric) / scale) < 1e-5


@pytest.mark.parametrize(
    ("arm", "runs"),
    [("typical", 6), ("calibrated", 30), ("poor", 30)],
)
@pytest.mark.slow
def test_errors_are_as_stated(arm: str, runs: int) -> None:
    """NEES and coverage of intrinsics, hand-eye transform and poses over many arms."""
    scaled, nees, poses = [], [], []
    for seed in range(runs):
        fit, rig, T_board_camera = calibrated(seed, arm)
        found = fit.calibration
        error = np.concatenate(
            [
                np.subtract(intrinsics(rig.camera), intrinsics(found.camera)),
                pose_log(found.T_flange_camera.inv() * rig.geometry.T_flange_camera),
            ]
        )
        covariance = found.covariance_of((*INTRINSICS, *HAND_EYE))
        scaled.append(error / np.sqrt(np.diagonal(covariance)))
        scale = np.sqrt(np.diagonal(covariance))
        nees.append((error / scale) @ np.linalg.solve(covariance / np.outer(scale, scale), error / scale))
        left = pose_log(fit.T_board_camera.inv() * T_board_camera)
        poses.append(np.einsum("vi,vij,vj->v", left, np.linalg.inv(fit.pose_covariance), left))
    # chi2 of 15 numbers, mean of `runs`: standard deviation sqrt(2 / (15 runs)); a view's poses share errors: at least as wide
    assert abs(np.mean(nees) / 15 - 1) < 5 * np.sqrt(2 / (15 * runs))
    assert np.mean(np.abs(scaled) < 1.96) > 0.95 - 5 * np.sqrt(0.05 * 0.95 / (15 * runs))
    assert abs(np.mean(poses) / 6 - 1) < 5 * np.sqrt(2 / (6 * runs))


@pytest.mark.slow
def test_a_calibrated_rig_knows_its_poses_elsewhere() -> None:
    """Readings that the calibration has not seen, at each of which the arm errs anew: NEES, and far better than before."""
    runs, nees, better = 5, [], []
    for seed in range(runs):
        fit, rig, _ = calibrated(seed, "typical")
        rng = np.random.default_rng([seed, 8])
        readings = rng.uniform(-1.5, 1.5, (1, 6))
        _, errors = rig.errors.scatter(1, rng)
        actual = rig.geometry.camera_poses(readings) * pose_exp(errors)
        distances = []
        for known in (rig, rig.calibrated(fit.calibration)):
            prior = known.prior(readings, RigidTransform.identity())
            left = pose_log(prior.T_world_camera.inv() * actual)[0]
            distances.append(np.linalg.norm(left[:3]))
        nees.append(left @ np.linalg.solve(prior.covariance[0], left))
        better.append(distances[1] < distances[0])
    assert abs(np.mean(nees) / 6 - 1) < 5 * np.sqrt(2 / (6 * runs))
    assert np.mean(better) >= 0.6


def test_a_rig_like_a_real_one_is_drawn_from_its_calibration() -> None:
    """Scatter of many drawn rigs' cameras and poses about what is believed: as the calibration's covariance says."""
    fit, *_ = calibrated(3, "typical")
    rng, count = np.random.default_rng(0), 400
    readings = rng.uniform(-1.0, 1.0, (1, 6))
    rigs = [Rig.like(fit.calibration, rng) for _ in range(count)]
    prior = rigs[0].prior(readings, RigidTransform.identity())
    assert rigs[0].arm == "real" and rigs[0].believed_camera == fit.calibration.camera
    common = prior.common[0] @ prior.common[0].T
    # what the wrong intrinsics do to rays is part of the common errors, not of where the camera is
    turned = turning(rigs[0].believed_camera)
    off = np.array(
        [
            pose_log(prior.T_world_camera.inv() * rig.geometry.camera_poses(readings))[0]
            + turned @ np.subtract(intrinsics(rig.camera), intrinsics(rig.believed_camera))
            for rig in rigs
        ]
    )
    nees = np.einsum("ri,ij,rj->r", off, np.linalg.pinv(common, rcond=1e-12), off)
    assert abs(nees.mean() / np.linalg.matrix_rank(common, tol=1e-12 * common.max()) - 1) < 5 * np.sqrt(
        2 / (6 * count)
    )
