"""Egomotion from two sources: what the robot's kinematics say of the poses, and what a camera saw of a board.

With e_i the error of the robot's pose of view i and n_i that of the board's, both of the structure of `PosePrior`,

    T_i = T_robot,i exp(e_i) = T_board,i exp(n_i),     d_i = log(T_robot,i^-1 T_board,i) = e_i - n_i     (to first order)
    e_i = r_i z_i + A_i c,     n_i = s_i w_i + B_i c,     z_i, w_i, c ~ N(0, I)

Given c, views are independent. So c is estimated from all discrepancies together, weighted by W_i = r_i r_i' + s_i s_i',
each view by its own gain K_i = r_i r_i' W_i^-1, and what is left has the same structure again:

    e_i = K_i d_i + ((1 - K_i) A_i + K_i B_i) c + N(0, (1 - K_i) r_i r_i')

A wrong hand-eye transform stays what it is, an error common to all views; so does a wrong focal length.
"""

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import RigidTransform

from extremal.estimator.board_pose import BoardPose
from extremal.estimator.camera import Array, Camera
from extremal.estimator.errors import DegenerateGeometry, InvalidInput
from extremal.estimator.poses import PosePrior, pose_log, square_root
from extremal.estimator.projection import adjoint, focal_sigma, turning

SURPRISING = (
    3.0  # standard deviations of chi2 beyond which robot and board contradict what is said of their errors
)
UNKNOWN_PLACE = 0.1  # [m], [rad] standard deviation of where the board stands: nothing is assumed of it


def board_egomotion(
    seen: Sequence[BoardPose | None],
    T_world_board: RigidTransform,
    camera: Camera,
    intrinsics_root: Array | None = None,
) -> PosePrior:
    """What the board tells of the poses of the views that saw it; the world is where the board stands.

    Args:
        seen: board poses (V), None where the board was not seen well enough.
        camera: as calibrated.
        intrinsics_root: (9, C) square root of the covariance of `INTRINSICS`; None: they are exact. Their errors are
            common to all views. What a wrong principal point does to rays is what a turned camera would do, so that it
            cancels near the board.

    Raises:
        DegenerateGeometry: a view did not see the board; names all such views.
    """
    missing = [str(i) for i, pose in enumerate(seen) if pose is None]
    if missing:
        raise DegenerateGeometry(
            f"the board is not seen well enough in views {', '.join(missing)} of {len(seen)}; accepted: motions that keep it "
            "in sharp view, or poses from the robot as well"
        )
    poses = [pose for pose in seen if pose is not None]
    T_world_camera = T_world_board * RigidTransform.concatenate([pose.T_board_camera for pose in poses])
    root = square_root(np.array([pose.covariance for pose in poses]))
    if intrinsics_root is None:
        return PosePrior(T_world_camera, root)
    modes = np.array([pose.by_intrinsics for pose in poses]) + turning(camera)
    return PosePrior(T_world_camera, root, modes @ intrinsics_root, focal_sigma(camera, intrinsics_root))


def fused_egomotion(
    robot: PosePrior, seen: Sequence[BoardPose | None], board: PosePrior | None, shared: int = 0
) -> PosePrior:
    """Poses in the robot's world from the robot and a board that stands at an unknown place.

    Args:
        robot: prior of the poses (V).
        seen: board poses (V), None where the board was not seen well enough.
        board: `board_egomotion` of the views that saw it, in order; None: no view did.
        shared: number of common errors, the first of both priors, that are the same errors: those of the intrinsics.

    Raises:
        DegenerateGeometry: no view saw the board.
    """
    known = np.array([pose is not None for pose in seen])
    if board is None:
        raise DegenerateGeometry(
            "no view saw the board; accepted: at least one, or poses from the robot alone"
        )
    if len(known) != len(robot.T_world_camera) or known.sum() != len(board.T_world_camera):
        raise InvalidInput(
            f"{len(known)} views, {known.sum()} with board, for a robot's {len(robot.T_world_camera)} poses and a board's "
            f"{len(board.T_world_camera)}; accepted: as many"
        )
    places = robot.T_world_camera[np.flatnonzero(known)] * board.T_world_camera.inv()
    placed = RigidTransform.from_components(np.mean(places.translation, axis=0), places.rotation.mean())
    T_board = placed * board.T_world_camera
    own = robot.common.shape[2]
    place = UNKNOWN_PLACE * adjoint(T_board.inv())
    common = np.concatenate(
        [
            board.common[:, :, :shared],
            np.zeros((len(place), 6, own - shared)),
            board.common[:, :, shared:],
            place,
        ],
        axis=2,
    )
    return combined(robot, PosePrior(T_board, board.root, common), known)


def combined(prior: PosePrior, measured: PosePrior, known: np.ndarray) -> PosePrior:
    """The prior given measured poses of the views `known` (V,); both priors' common errors, the first ones the same.

    Where discrepancies are larger than stated, all is inflated by their chi2 per degree of freedom.
    """
    views, _, own = prior.common.shape
    total = max(own, measured.common.shape[2])
    A = np.concatenate([prior.common, np.zeros((views, 6, total - own))], axis=2)
    B, s = A.copy(), np.zeros((views, 6, measured.root.shape[2]))
    d, where = np.zeros((views, 6)), np.flatnonzero(known)
    B[where] = np.pad(measured.common, ((0, 0), (0, 0), (0, total - measured.common.shape[2])))
    s[where] = measured.root
    d[where] = pose_log(prior.T_world_camera[where].inv() * measured.T_world_camera)

    prior_variance = prior.root @ np.swapaxes(prior.root, 1, 2)
    W_inverse = np.zeros((views, 6, 6))
    W_inverse[where] = _inverse((prior_variance + s @ np.swapaxes(s, 1, 2))[where])
    D = A - B
    weighted = np.swapaxes(D, 1, 2) @ W_inverse
    precision = np.eye(total) + np.sum(weighted @ D, axis=0)
    c = np.linalg.solve(precision, np.einsum("vck,vk->c", weighted, d))
    left = d - D @ c
    chi2 = np.einsum("vi,vij,vj->", left, W_inverse, left) + c @ c
    freedom = 6 * max(len(where) - 1, 1)  # six discrepancies say where the board stands
    excess = chi2 / freedom if chi2 > freedom + SURPRISING * np.sqrt(2 * freedom) else 1.0

    gain = prior_variance @ W_inverse
    mixed = A - gain @ D
    error = np.einsum("vij,vj->vi", gain, d) + mixed @ c
    variance = prior_variance - gain @ prior_variance
    variance = (variance + np.swapaxes(variance, 1, 2)) / 2
    root = np.sqrt(excess) * square_root(variance)  # refuses what has overflowed
    root_c = np.linalg.cholesky(np.linalg.inv(precision))
    return PosePrior(
        prior.moved(error),
        root,
        np.sqrt(excess) * mixed @ root_c,
        prior.focal_sigma,
    )


def _inverse(covariance: Array) -> Array:
    """Inverses (n, 6, 6), scaled so that metres and radians of any size agree."""
    scale = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    if not np.all(scale > 0):
        raise InvalidInput(
            "poses from robot and board are both exact; accepted: at least one with uncertainty"
        )
    outer = scale[:, :, None] * scale[:, None]
    return np.linalg.inv(covariance / outer) / outer
