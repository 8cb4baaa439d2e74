"""Park's hand-eye calibration: exact on exact poses, as good as its noise on others, and clear where motion degenerates."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from extremal.estimator.errors import DegenerateGeometry, InvalidInput
from extremal.estimator.hand_eye import hand_eye
from extremal.estimator.poses import pose_exp

T_FLANGE_CAMERA = RigidTransform.from_components([0.02, -0.075, 0.06], Rotation.from_rotvec([0.1, -0.2, 1.5]))
T_BASE_BOARD = RigidTransform.from_components([0.4, 0.1, 0.2], Rotation.from_rotvec([2.0, 0.5, -0.3]))


def flange_poses(views: int, rng: np.random.Generator, turns: np.ndarray | None = None) -> RigidTransform:
    turns = 0.4 * rng.normal(size=(views, 3)) if turns is None else turns
    return RigidTransform.from_components(rng.uniform(-0.3, 0.3, (views, 3)), Rotation.from_rotvec(turns))


def board_poses(T_base_flange: RigidTransform) -> RigidTransform:
    return (T_base_flange * T_FLANGE_CAMERA).inv() * T_BASE_BOARD


def error(estimate: RigidTransform, truth: RigidTransform) -> np.ndarray:
    """(translation [m], angle [rad])"""
    left = truth.inv() * estimate
    return np.array([np.linalg.norm(left.translation), left.rotation.magnitude()])


@pytest.mark.parametrize("views", [3, 5, 30, 400])
def test_exact_poses_give_exact_transforms(views: int) -> None:
    T_base_flange = flange_poses(views, np.random.default_rng(views))
    T_flange_camera, T_base_board = hand_eye(T_base_flange, board_poses(T_base_flange))
    assert np.all(error(T_flange_camera, T_FLANGE_CAMERA) < 1e-9)
    assert np.all(error(T_base_board, T_BASE_BOARD) < 1e-9)


def test_two_axes_are_enough_and_half_turns_do_no_harm() -> None:
    angles = np.linspace(-np.pi / 2, np.pi / 2, 7)  # the ends are half a turn apart
    turns = np.concatenate([np.outer(angles, [1, 0, 0]), np.outer(angles, [0, 1, 0])])
    T_base_flange = flange_poses(len(turns), np.random.default_rng(1), turns)
    noise = pose_exp(1e-6 * np.random.default_rng(2).normal(size=(len(turns), 6)))
    T_flange_camera, _ = hand_eye(T_base_flange * noise, board_poses(T_base_flange))
    assert np.all(error(T_flange_camera, T_FLANGE_CAMERA) < 1e-5)


def test_errors_average_over_views() -> None:
    """Noise of 0.1 mm and 0.1 mrad on 30 views: a good start, errors of about a tenth of a millimetre."""
    rng, errors = np.random.default_rng(3), []
    for _ in range(100):
        T_base_flange = flange_poses(30, rng)
        noise = pose_exp(1e-4 * rng.normal(size=(30, 6)))
        errors.append(error(hand_eye(T_base_flange * noise, board_poses(T_base_flange))[0], T_FLANGE_CAMERA))
    assert np.all(np.sqrt(np.mean(np.square(errors), axis=0)) < 1e-4)


@pytest.mark.parametrize(
    "turns",
    [np.zeros((10, 3)), np.outer(np.linspace(-1, 1, 10), [0.6, 0.0, 0.8])],
    ids=["translations", "one axis"],
)
def test_degenerate_motion_is_an_error(turns: np.ndarray) -> None:
    T_base_flange = flange_poses(len(turns), np.random.default_rng(4), turns)
    with pytest.raises(DegenerateGeometry, match="at least two axes"):
        hand_eye(T_base_flange, board_poses(T_base_flange))


def test_too_few_or_unequal_views_are_errors() -> None:
    T_base_flange = flange_poses(4, np.random.default_rng(5))
    T_camera_board = board_poses(T_base_flange)
    with pytest.raises(DegenerateGeometry, match=r"2 views.*at least three"):
        hand_eye(T_base_flange[:2], T_camera_board[:2])
    with pytest.raises(InvalidInput, match="as many views"):
        hand_eye(T_base_flange, T_camera_board[:3])
    broken = T_camera_board.as_matrix()
    broken[1, 0, 3] = np.nan
    with pytest.raises(InvalidInput, match="not finite"):
        hand_eye(T_base_flange, RigidTransform.from_matrix(broken))
