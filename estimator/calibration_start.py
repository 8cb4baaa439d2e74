"""Where a calibration starts: intrinsics and board poses by OpenCV, the hand-eye transform by Park.

Both are checked before anything is built on them, as most mistakes with a user's images and poses show here.
"""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.linalg import norm
from scipy.spatial.transform import RigidTransform, Rotation

from extremal.estimator.board import Board
from extremal.estimator.calibration_equations import Sightings, State
from extremal.estimator.camera import Array, Camera
from extremal.estimator.corners import Corners
from extremal.estimator.errors import DegenerateGeometry, InvalidInput
from extremal.estimator.hand_eye import hand_eye
from extremal.estimator.poses import PosePrior

FEWEST_CORNERS = 6  # of a view that is used
DISAGREEMENT = 0.05, 0.1  # [m], [rad] of robot and images, beyond which the poses must mean something else


def spanning(board: Board, corners: Sequence[Corners]) -> list[Corners]:
    """Corners of known covariance, none where a view has too few or all of them on one line."""
    known = [seen[np.all(np.isfinite(seen.covariance), axis=(1, 2))] for seen in corners]
    points = [board.corners[seen.ids, :2] for seen in known]
    enough = [
        len(p) >= FEWEST_CORNERS and np.linalg.matrix_rank(p - p[0], tol=board.square / 2) == 2
        for p in points
    ]
    return [seen if good else seen[:0] for seen, good in zip(known, enough, strict=True)]


def start_state(
    board: Board, sightings: Sightings, prior: PosePrior, size: tuple[int, int], start: Camera | None
) -> State:
    """Intrinsics, hand-eye transform and board pose to start from, without errors of arm and views.

    Args:
        start: a first guess of the camera, from which blur and gamma are kept.

    Raises:
        DegenerateGeometry: views that leave the focal length open, rotations that are not about two axes.
        InvalidInput: robot and images that contradict each other.
    """
    used = sightings.used
    views = np.flatnonzero(sightings.views)
    camera, T_camera_board = _camera(
        [board.corners[used[v]].astype(np.float32) for v in views],
        [sightings.pixels[v, used[v]].astype(np.float32) for v in views],
        start or Camera(*size),
        start is not None,
    )
    T_base_flange = prior.T_world_camera[views]
    T_flange_camera, T_base_board = hand_eye(T_base_flange, T_camera_board)
    _check_agreement(T_base_board.inv() * T_base_flange * T_flange_camera * T_camera_board)
    own = np.zeros((len(used), prior.root.shape[2]))
    return State(camera, T_flange_camera, T_base_board, np.zeros(prior.common.shape[2]), own)


def _camera(
    points: list[Array], pixels: list[Array], camera: Camera, is_guess: bool
) -> tuple[Camera, RigidTransform]:
    """Camera and T_camera_board of every view."""
    matrix, distortion = camera.matrix.copy(), np.array(camera.distortion)
    flags = cv2.CALIB_FIX_K3 | (
        cv2.CALIB_USE_INTRINSIC_GUESS if is_guess else 0
    )  # k3 is weak: adjusted later
    try:
        _, matrix, distortion, turns, shifts = cv2.calibrateCamera(
            points, pixels, (camera.width, camera.height), matrix, distortion, flags=flags
        )
        focal = matrix[0, 0] / max(camera.width, camera.height)
    except cv2.error:
        focal, turns, shifts = np.nan, (), ()
    if not 0.1 < focal < 100:
        raise DegenerateGeometry(
            "the views leave the focal length open; accepted: boards slanted by 20 degrees or more, from several sides"
        )
    camera = replace(
        camera,
        fx=float(matrix[0, 0]),
        fy=float(matrix[1, 1]),
        cx=float(matrix[0, 2]),
        cy=float(matrix[1, 2]),
        distortion=tuple(distortion.ravel()[:5].tolist()),
    )
    rotations = Rotation.from_rotvec(np.reshape(turns, (-1, 3)))
    return camera, RigidTransform.from_components(np.reshape(shifts, (-1, 3)), rotations)


def _check_agreement(left: RigidTransform) -> None:
    """Where each view puts the board (V), seen from where all do."""
    position = float(np.median(norm(left.translation, axis=1)))
    angle = float(np.median(left.rotation.magnitude()))
    if not (position < DISAGREEMENT[0] and angle < DISAGREEMENT[1]):
        raise InvalidInput(
            f"robot and images put the board {1e3 * position:.0f} mm and {np.degrees(angle):.1f} degrees apart in every other "
            f"view; accepted: up to {1e3 * DISAGREEMENT[0]:.0f} mm and {np.degrees(DISAGREEMENT[1]):.1f} degrees (poses must map "
            "flange to base coordinates, in metres, each beside its own image)"
        )
