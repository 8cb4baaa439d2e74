"""The camera's pose before a board, from the board's corners in one image.

Of a plane seen from far away two poses look the same, tilted one way or the other (Schweighofer and Pinz 2006). Both are
refined; a pose is only stated where the corners tell them apart.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from extremal.estimator.board import Board
from extremal.estimator.camera import Array, Camera
from extremal.estimator.corners import Corners
from extremal.estimator.errors import DegenerateGeometry, InvalidInput
from extremal.estimator.poses import pose_exp
from extremal.estimator.projection import point_by_twist, projection

FEWEST = 6  # corners: with less the residuals say nothing
THIN = 0.1  # of a square, across which corners count as standing on one line
# Where the wrong pose is expected to have a chi2 larger by D, it is larger by D +- 2 sqrt(D): that it is smaller by as much
# as this happens at four standard deviations, whatever D is.
AMBIGUOUS = 16.0
LOOSE = 0.01  # [rad] standard deviation of the rotation, beyond which how foreshortened a board is leaves the linear
SHARPEST = 1e-9  # [px] standard deviation that no corner falls below
STEPS, SETTLED = 30, 1e-8  # [m], [rad]


@dataclass(frozen=True, eq=False)
class BoardPose:
    """The camera's pose in the board's frame.

    Attributes:
        T_board_camera: maps camera coordinates to the board's.
        covariance: (6, 6) of the errors (translation [m], rotation vector [rad]) in the camera frame, right-multiplied.
            Intrinsics count as exact.
        by_intrinsics: (6, 9) pose error per unit of (fx, fy, cx, cy, k1, k2, p1, p2, k3): were the intrinsics
            I + d, the pose would be T_board_camera exp(by_intrinsics d).
        chi2: of the corners, per degree of freedom; where it exceeds 1, `covariance` is larger by as much.
        corners: number of corners used.
    """

    T_board_camera: RigidTransform
    covariance: Array
    by_intrinsics: Array
    chi2: float
    corners: int


@dataclass(frozen=True, eq=False)
class _Sighting:
    """Points (n, 3) of a board that a camera sees at pixels (n, 2), and the inverse square roots (n, 2, 2) of their covariances."""

    camera: Camera
    points: Array
    pixels: Array
    whitening: Array

    def residuals(self, pose: RigidTransform) -> tuple[Array, Array, Array] | None:
        """Whitened residuals (2n,), and derivatives of the images by twist (2n, 6) and intrinsics (2n, 9); None if behind."""
        seen = pose.inv().apply(self.points)
        if not np.all(seen[:, 2] > 0):
            return None
        pixels, by_point, by_intrinsics = projection(self.camera, seen)
        by_twist = by_point @ point_by_twist(seen)
        r, J, D = (self.whitening @ a for a in ((self.pixels - pixels)[..., None], by_twist, by_intrinsics))
        return r.ravel(), J.reshape(-1, 6), D.reshape(-1, 9)


def board_pose(camera: Camera, board: Board, corners: Corners) -> BoardPose:
    """The pose that fits the corners best, by Gauss-Newton from both closed-form solutions (Collins and Bartoli 2014).

    Raises:
        DegenerateGeometry: fewer than six corners, corners on one line, or corners that two poses explain.
        InvalidInput: a covariance that is not positive definite.
    """
    points = corners.on(board)
    _check_layout(board, points)
    sighting = _Sighting(camera, points, corners.pixels, _whitening(corners.covariance))
    poses = [_refined(sighting, start) for start in _starts(camera, points, corners.pixels)]
    fits = sorted((fit for fit in poses if fit is not None), key=lambda fit: fit[1])
    if not fits:
        raise DegenerateGeometry(
            f"no pose before the camera explains the {len(corners)} corners of the board"
        )
    pose, chi2 = fits[0]
    excess = chi2 / (2 * len(corners) - 6)
    scale = max(1.0, excess)
    for other, larger in fits[1:]:
        turn = (pose.rotation.inv() * other.rotation).magnitude()
        if turn > 1e-3 and larger - chi2 < AMBIGUOUS * scale:
            raise DegenerateGeometry(
                f"two poses, {np.degrees(turn):.1f} degrees apart, explain the {len(corners)} corners of the board; accepted: a "
                "board that is nearer, larger in the image, or tilted more"
            )
    found = sighting.residuals(pose)
    assert found is not None
    _, J, D = found
    inverse = np.linalg.inv(J.T @ J)
    covariance = scale * inverse
    if not (spread := np.trace(covariance[3:, 3:])) < LOOSE**2:
        raise DegenerateGeometry(
            f"the corners of the board leave its tilt open by {np.sqrt(spread):.2g} rad; accepted: below {LOOSE}"
        )
    return BoardPose(pose, covariance, -inverse @ J.T @ D, excess, len(corners))


def _check_layout(board: Board, points: Array) -> None:
    if len(points) < FEWEST:
        raise DegenerateGeometry(
            f"{len(points)} corners of the board are seen; accepted: at least {FEWEST} for a pose"
        )
    across = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[1]
    if across < THIN * board.square:
        raise DegenerateGeometry(f"all {len(points)} corners seen of the board lie on one line")


def _whitening(covariance: Array) -> Array:
    """Inverse square roots (n, 2, 2)."""
    try:
        inverse = np.linalg.inv(np.linalg.cholesky(covariance))
    except np.linalg.LinAlgError:
        inverse = np.full_like(covariance, np.nan)
    if not np.all(np.abs(inverse) < 1 / SHARPEST):
        raise InvalidInput(
            f"a covariance of corners is not positive definite; accepted: standard deviations above {SHARPEST:g} px"
        )
    return inverse


def _starts(camera: Camera, points: Array, pixels: Array) -> list[RigidTransform]:
    """Both planar poses T_board_camera, for an ideal camera."""
    ideal = camera.normalise(pixels)
    _, turns, places, _ = cv2.solvePnPGeneric(points, ideal, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    return [
        RigidTransform.from_components(np.ravel(place), Rotation.from_rotvec(np.ravel(turn))).inv()
        for turn, place in zip(turns, places, strict=True)
        if np.all(np.isfinite(turn)) and np.all(np.isfinite(place))
    ]


def _refined(sighting: _Sighting, pose: RigidTransform) -> tuple[RigidTransform, float] | None:
    """Pose and chi2 at the minimum near a start (Levenberg and Marquardt); None where there is none."""
    damping, current = 1e-4, sighting.residuals(pose)
    if current is None:
        return None
    for _ in range(STEPS):
        r, J, _ = current
        normal, gradient = J.T @ J, J.T @ r
        step = np.linalg.lstsq(normal + damping * np.diag(np.diag(normal)), gradient, rcond=None)[0]
        if np.abs(step).max() < SETTLED:
            break
        moved = pose * pose_exp(step)
        after = sighting.residuals(moved)
        if after is None or not after[0] @ after[0] <= r @ r:
            damping *= 10
            if damping > 1e6:
                break
            continue
        pose, current, damping = moved, after, damping / 10
    return pose, float(current[0] @ current[0])
