"""The report of `extremal calibrate`."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.table import Table
from scipy.spatial.transform import RigidTransform, Rotation

from extremal.estimator.calibrate import CalibrationFit
from extremal.scripts.calibration_picture import draw_over_image, draw_scatter
from extremal.scripts.report import Report
from extremal.scripts.report_scene import FIXED, Scene3D

FACE_UP = RigidTransform.from_rotation(Rotation.from_euler("x", np.pi))  # the board's z axis points into it


def calibrate_report(
    fit: CalibrationFit,
    images: Sequence[NDArray[np.uint8]],
    table: Table,
    summary: str,
    settings: Mapping[str, Any],
) -> Report:
    """The board and the cameras before it in 3D, residuals, and the command's table; `images` are of the fit's views."""
    board, found = fit.calibration.board, fit.calibration
    report = Report(
        "extremal calibrate", f"{found.views} views of a board of {board.columns} x {board.rows} squares"
    )
    report.facts({"corners, rms": f"{found.rms:.3f} px", "views left out": str(int(fit.blunders.sum()))})
    used = np.flatnonzero(~fit.blunders)
    corners, outline = FACE_UP.apply(board.corners), FACE_UP.apply(board.outline)
    poses = FACE_UP * fit.T_board_camera[used]
    scene = Scene3D.beside(corners.mean(axis=0), poses.translation)
    scene.points("corners", corners, FIXED, size=0.004)
    scene.lines("outline", [np.vstack([outline, outline[:1]])], FIXED)
    scene.cameras(
        found.camera,
        poses,
        [image for image, left_out in zip(images, fit.blunders, strict=True) if not left_out],
    )
    report.scene(scene, "The board's corners and the cameras as they were found.")
    report.figure(
        lambda axes: draw_over_image(axes, fit), "Residuals where the corners were seen, lengthened."
    )
    report.figure(lambda axes: draw_scatter(axes, fit), "Residuals: what the fit leaves of the corners.")
    report.text(summary).table(table)
    return report.section("How it was made").settings(settings)
