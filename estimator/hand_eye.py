"""Hand-eye calibration in closed form: where the camera sits on the flange, from motions of both.

Between views i and j the flange moves by A = T_flange_j^-1 T_flange_i and the camera, as a board that stands still tells, by
B = T_camera_board_j T_camera_board_i^-1. Both are one motion of one rigid body, A X = X B with X = T_flange_camera. The
rotation turns the axes of B into those of A, an orthogonal Procrustes problem in the rotation vectors, and the
translation is linear after it (F. C. Park and B. J. Martin, "Robot sensor calibration: solving AX = XB on the Euclidean
group", IEEE Trans. Robotics and Automation 10(5), 1994).
"""

import numpy as np
from numpy.linalg import norm
from scipy.spatial.transform import RigidTransform, Rotation

from extremal.estimator.camera import Array
from extremal.estimator.errors import DegenerateGeometry, InvalidInput

LARGEST_TURN = 2.8  # [rad] near half a turn noise flips the rotation vector
SMALLEST_TURN = 0.05  # [rad] rms about a second axis: with less, the axes' noise is all there is
MOST_PAIRS = 50_000


def hand_eye(
    T_base_flange: RigidTransform, T_camera_board: RigidTransform
) -> tuple[RigidTransform, RigidTransform]:
    """T_flange_camera and T_base_board from V >= 3 views of a board that stands still.

    Args:
        T_base_flange: the robot's poses (V).
        T_camera_board: the board's poses (V) in the camera.

    Raises:
        InvalidInput: poses that are not of as many views, or not finite.
        DegenerateGeometry: fewer than three views, or rotations that are not about two axes at least.
    """
    _check(T_base_flange, T_camera_board)
    i, j = np.triu_indices(len(T_base_flange), 1)
    some = slice(None, None, 1 + len(i) // MOST_PAIRS)
    i, j = i[some], j[some]
    A = T_base_flange[j].inv() * T_base_flange[i]
    B = T_camera_board[j] * T_camera_board[i].inv()
    clear = np.maximum(A.rotation.magnitude(), B.rotation.magnitude()) < LARGEST_TURN
    turns = A[clear].rotation.as_rotvec(), B[clear].rotation.as_rotvec()
    _check_axes("flange", turns[0])
    _check_axes("camera", turns[1])
    rotation = Rotation.align_vectors(*turns)[0]
    T_flange_camera = RigidTransform.from_components(_translation(A, B, rotation), rotation)
    T_base_board = T_base_flange * T_flange_camera * T_camera_board
    return T_flange_camera, mean_pose(T_base_board)


def mean_pose(poses: RigidTransform) -> RigidTransform:
    """Mean of poses (V) that are near each other: of translations, and of rotations in the chordal sense."""
    return RigidTransform.from_components(poses.translation.mean(axis=0), poses.rotation.mean())


def _translation(A: RigidTransform, B: RigidTransform, rotation: Rotation) -> Array:
    """Least-squares translation (3,) of X: (R_A - I) t_X = R_X t_B - t_A."""
    factors = A.rotation.as_matrix() - np.eye(3)
    right = rotation.apply(B.translation) - A.translation
    normal = np.einsum("nij,nik->jk", factors, factors)
    return np.linalg.solve(normal, np.einsum("nij,ni->j", factors, right))


def _check(T_base_flange: RigidTransform, T_camera_board: RigidTransform) -> None:
    if T_base_flange.single or T_camera_board.single or len(T_base_flange) != len(T_camera_board):
        raise InvalidInput("poses of flange and board are not of as many views; accepted: (V) poses each")
    if not all(np.all(np.isfinite(poses.as_matrix())) for poses in (T_base_flange, T_camera_board)):
        raise InvalidInput("a pose of flange or board holds a number that is not finite")
    if len(T_base_flange) < 3:
        raise DegenerateGeometry(
            f"{len(T_base_flange)} views with the board; accepted: at least three, turned about two axes or more"
        )


def _check_axes(name: str, turns: Array) -> None:
    """Rotation vectors (n, 3) of motions must span two axes."""
    spread = np.linalg.svd(turns, compute_uv=False)[1] / np.sqrt(len(turns)) if len(turns) > 1 else 0.0
    if not spread > SMALLEST_TURN:
        most = np.degrees(norm(turns, axis=1).max(initial=0.0))
        raise DegenerateGeometry(
            f"the {name} turns by up to {most:.1f} degrees, about a second axis by {np.degrees(spread):.2f} only; accepted: "
            f"rotations about at least two axes, {np.degrees(SMALLEST_TURN):.1f} degrees rms or more about each"
        )
