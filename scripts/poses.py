"""Where views were taken from, as one can know it: from the robot, from a board that it sees, or from both."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Literal

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform

from extremal.estimator import DegenerateGeometry
from extremal.estimator.board import Board
from extremal.estimator.board_pose import BoardPose, board_pose
from extremal.estimator.camera import View
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
        return _with_poses(recording.views, robot), robot
    seen = _board_poses(recording.views, placed.board, progress)
    known = [pose for pose in seen if pose is not None]
    if egomotion == "board":
        prior = board_egomotion(seen, placed.T_world_object, rig.believed_camera, rig.intrinsics_root)
    else:
        board = (
            board_egomotion(known, RigidTransform.identity(), rig.believed_camera, rig.intrinsics_root)
            if known
            else PosePrior(robot.T_world_camera[:0], robot.root[:0])
        )
        prior = fused_egomotion(robot, seen, board, shared=robot.common.shape[2])
    # the board's corners are used up: its contours would say the same again
    views = [
        replace(view, ignored=_outline(view, placed.board, pose) if pose else None)
        for view, pose in zip(_with_poses(recording.views, prior), seen, strict=True)
    ]
    return views, prior


def _board_poses(
    views: tuple[View, ...], board: Board, progress: Callable[[int, int], None] | None
) -> list[BoardPose | None]:
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


def _with_poses(views: tuple[View, ...], prior: PosePrior) -> list[View]:
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
