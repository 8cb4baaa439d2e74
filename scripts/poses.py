"""Where views were taken from, as one can know it: from the robot, from a board that it sees, or from both."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Literal

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform

from extremal.estimator import DegenerateGeometry
from extremal.estimator.board import Board
from extremal.estimator.board_pose import BoardPose, board_pose
from extremal.estimator.camera import Array, Camera, View
from extremal.estimator.corners import find_corners
from extremal.estimator.egomotion import board_egomotion, fused_egomotion
from extremal.estimator.poses import PosePrior, pose_log
from extremal.scenes.board import CalibrationBoard
from extremal.sim import Recording
from extremal.sim.rig import Rig

Egomotion = Literal["robot", "board", "both"]
BORDER = 8  # [px] around the board in which no contour is looked for


def known_poses(
    egomotion: Egomotion,
    recording: Recording,
    rig: Rig,
    placed: CalibrationBoard | None,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[list[View], PosePrior]:
    """The views with the poses that are known of them, and all that is known, common errors included.

    Args:
        placed: the board in the scene; None: there is none, and poses come from the robot.
        progress: called with (views done, views) while the board is looked for.

    Raises:
        DegenerateGeometry: "board": a view does not show it well enough; "both": no view does.
    """
    robot = rig.prior(recording.readings, recording.T_world_base)
    if placed is None:
        return with_poses(recording.views, robot), robot
    seen = board_poses(recording.views, placed.board, progress)
    prior = prior_of(egomotion, robot, seen, placed.T_world_object, rig.believed_camera, rig.intrinsics_root)
    return with_poses(without_board(recording.views, placed.board, seen), prior), prior


def prior_of(
    egomotion: Egomotion,
    robot: PosePrior,
    seen: Sequence[BoardPose | None],
    T_world_board: RigidTransform,
    camera: Camera,
    intrinsics_root: Array,
) -> PosePrior:
    """What is known of poses (V): see `robot`, `board_egomotion` and `fused_egomotion`.

    Args:
        robot: its common errors are those of the columns of `intrinsics_root` (9, C).
    """
    if egomotion == "robot":
        return robot
    if egomotion == "board":
        return board_egomotion(seen, T_world_board, camera, intrinsics_root)
    known = [pose for pose in seen if pose is not None]
    # where the board stands in the robot's world is not known
    board = board_egomotion(known, RigidTransform.identity(), camera, intrinsics_root) if known else None
    return fused_egomotion(robot, seen, board, shared=robot.common.shape[2])


def without_board(views: Sequence[View], board: Board, seen: Sequence[BoardPose | None]) -> list[View]:
    """Views that ignore the board where they look for contours: its corners are used up, and would say the same again."""
    return [
        replace(view, ignored=_outline(view, board, pose) if pose else None)
        for view, pose in zip(views, seen, strict=True)
    ]


def board_poses(
    views: Sequence[View], board: Board, progress: Callable[[int, int], None] | None = None
) -> list[BoardPose | None]:
    """Poses of the views (V) before the board, None where it is not seen well enough."""

    def find(view: View) -> BoardPose | None:
        try:
            return board_pose(view.camera, board, find_corners(view.image, view.camera, board))
        except DegenerateGeometry:
            return None

    found = []
    with ThreadPoolExecutor(2) as pool:
        for pose in pool.map(find, views):
            found.append(pose)
            if progress:
                progress(len(found), len(views))
    return found


def with_poses(views: Sequence[View], prior: PosePrior) -> list[View]:
    """Views that state the prior's poses, and all that is uncertain of each, common errors included."""
    covariance = prior.covariance
    return [
        replace(view, T_world_camera=prior.T_world_camera[i], pose_covariance=covariance[i])
        for i, view in enumerate(views)
    ]


def _outline(view: View, board: Board, pose: BoardPose) -> np.ndarray:
    """The board with its margin in the image (height, width)."""
    middle = board.outline.mean(axis=0)
    reach = 1 + 2 * board.module / board.size.min()
    border = middle + reach * (
        np.linspace(board.outline, np.roll(board.outline, -1, axis=0), 16, axis=1) - middle
    )
    pixels = view.camera.project(pose.T_board_camera.inv().apply(border.reshape(-1, 3)))
    mask = np.zeros((view.camera.height, view.camera.width), np.uint8)
    cv2.fillPoly(mask, [np.rint(pixels).astype(np.int32)], 1)
    return cv2.dilate(mask, np.ones((2 * BORDER + 1,) * 2, np.uint8)).astype(bool)


def pose_errors(recording: Recording, prior: PosePrior) -> list[dict[str, float]]:
    """How far each view's pose is off, before shape is estimated, and how far it may be: norms over the three axes.

    The world of poses from a board is the board's; that of all others the robot's.
    """
    left = pose_log(prior.T_world_camera.inv() * RigidTransform.concatenate(recording.actual))
    variance = np.diagonal(prior.covariance, axis1=1, axis2=2)
    return [
        {
            "error_m": float(np.linalg.norm(off[:3])),
            "sigma_m": float(np.sqrt(v[:3].sum())),
            "error_rad": float(np.linalg.norm(off[3:])),
            "sigma_rad": float(np.sqrt(v[3:].sum())),
        }
        for off, v in zip(left, variance, strict=True)
    ]
