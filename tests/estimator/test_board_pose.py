"""Poses before a board: errors against stated covariance by Monte Carlo, derivatives by differences, what is refused."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from extremal.estimator import Camera, DegenerateGeometry
from extremal.estimator.board import Board
from extremal.estimator.board_pose import board_pose
from extremal.estimator.corners import Corners
from extremal.estimator.projection import INTRINSICS

BOARD = Board()
CAMERA = Camera(distortion=(-0.1, 0.05, 4e-4, -3e-4, 0.0))
SIGMA = 0.02


def pose(rng: np.random.Generator) -> RigidTransform:
    """A camera 0.5 m before the board's middle, slanted by 15 to 45 degrees."""
    tilt, around = np.radians(rng.uniform(15, 45)), rng.uniform(0, 2 * np.pi)
    turned = Rotation.from_rotvec(tilt * np.array([np.cos(around), np.sin(around), 0.0]))
    middle = np.append(BOARD.size / 2, 0.0)
    return RigidTransform.from_components(middle + turned.apply([0, 0, -0.5]), turned)


def seen(camera: Camera, T: RigidTransform, noise: np.ndarray | float = 0.0) -> Corners:
    pixels = camera.project(T.inv().apply(BOARD.corners)) + noise
    n = len(pixels)
    return Corners(np.arange(n), pixels, np.tile(SIGMA**2 * np.eye(2), (n, 1, 1)))


def twist(a: RigidTransform, b: RigidTransform) -> np.ndarray:
    return np.roll((a.inv() * b).as_exp_coords(), 3)


def test_errors_are_as_stated() -> None:
    rng, trials, nees = np.random.default_rng(0), 200, []
    for _ in range(trials):
        T = pose(rng)
        found = board_pose(CAMERA, BOARD, seen(CAMERA, T, SIGMA * rng.standard_normal((40, 2))))
        left = twist(found.T_board_camera, T)
        nees.append(left @ np.linalg.solve(found.covariance, left) / 6)
    assert 1 - 4 * np.sqrt(2 / (6 * trials)) - 0.1 < np.mean(nees) < 1 + 4 * np.sqrt(2 / (6 * trials))


def test_derivatives_by_intrinsics() -> None:
    T = pose(np.random.default_rng(1))
    corners = seen(CAMERA, T)
    found = board_pose(CAMERA, BOARD, corners)
    steps = dict(zip(INTRINSICS, [0.5] * 4 + [1e-3] * 5, strict=True))
    for k, (name, step) in enumerate(steps.items()):
        ends = []
        for sign in (1, -1):
            if k < 4:
                moved = replace(CAMERA, **{name: getattr(CAMERA, name) + sign * step})
            else:
                distortion = np.array(CAMERA.distortion)
                distortion[k - 4] += sign * step
                moved = replace(CAMERA, distortion=tuple(distortion.tolist()))
            ends.append(board_pose(moved, BOARD, corners).T_board_camera)
        slope = (twist(T, ends[0]) - twist(T, ends[1])) / (2 * step)
        assert np.allclose(found.by_intrinsics[:, k], slope, rtol=0.02, atol=0.02 * np.abs(slope).max())


def test_half_a_board_is_known_less_well() -> None:
    T = pose(np.random.default_rng(2))
    corners = seen(CAMERA, T)
    whole, half = board_pose(CAMERA, BOARD, corners), board_pose(CAMERA, BOARD, corners[np.arange(16)])
    assert np.all(np.diagonal(half.covariance) > np.diagonal(whole.covariance))


@pytest.mark.parametrize("chosen", [np.arange(0), np.arange(3), np.arange(8)], ids=["none", "three", "a row"])
def test_too_little_is_refused(chosen: np.ndarray) -> None:
    corners = seen(CAMERA, pose(np.random.default_rng(3)))
    with pytest.raises(DegenerateGeometry):
        board_pose(CAMERA, BOARD, corners[chosen])


def test_corners_that_fit_no_pose_are_never_called_good() -> None:
    rng = np.random.default_rng(4)
    T = pose(rng)
    corners = seen(CAMERA, T, 3.0 * rng.standard_normal((40, 2)))
    try:
        found = board_pose(CAMERA, BOARD, corners)
    except DegenerateGeometry:
        return
    left = twist(found.T_board_camera, T)
    assert left @ np.linalg.solve(found.covariance, left) / 6 < 6
