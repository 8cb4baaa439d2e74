"""The picture of a calibration: where corners were seen, and what the fit leaves of them."""

from pathlib import Path

import matplotlib
import numpy as np

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes

from extremal.estimator.calibrate import CalibrationFit
from extremal.estimator.projection import projection

LENGTHENED = 500.0  # residuals as drawn


def draw_calibration(fit: CalibrationFit, path: Path) -> None:
    """Write the picture (PNG): residuals over the image, and their scatter."""
    figure, (image, scatter) = plt.subplots(
        1, 2, figsize=(12.5, 5.4), gridspec_kw={"width_ratios": [1.5, 1]}, layout="constrained"
    )
    draw_over_image(image, fit)
    draw_scatter(scatter, fit)
    figure.savefig(path, dpi=110, format="png")
    plt.close(figure)


def draw_over_image(axes: Axes, fit: CalibrationFit) -> None:
    """Draw the residuals, lengthened, where their corners were seen."""
    camera, board = fit.calibration.camera, fit.calibration.board
    to_camera = fit.T_board_camera.inv()
    points = np.array([to_camera[i].apply(board.corners) for i in range(len(to_camera))])
    at, left = projection(camera, points)[0][fit.used], fit.residuals[fit.used]
    axes.quiver(
        *at.T, *left.T, angles="xy", scale=1 / LENGTHENED, scale_units="xy", width=0.0015, color="#1f77b4"
    )
    axes.plot(*at.T, ".", color="#ff7f0e", markersize=2)
    axes.set(
        xlim=(-0.5, camera.width - 0.5),
        ylim=(camera.height - 0.5, -0.5),
        aspect="equal",
        title=f"{len(at)} corners of {fit.calibration.views} views; residuals x {LENGTHENED:g}",
        xlabel="x [px]",
        ylabel="y [px]",
    )


def draw_scatter(axes: Axes, fit: CalibrationFit) -> None:
    """Draw the residuals around zero."""
    left = fit.residuals[fit.used]
    reach = 1.1 * float(np.abs(left).max())
    axes.plot(*left.T, ".", markersize=3, color="#1f77b4")
    axes.set(
        xlim=(-reach, reach),
        ylim=(-reach, reach),
        aspect="equal",
        title=f"residuals, {fit.calibration.rms:.3f} px rms",
        xlabel="x [px]",
        ylabel="y [px]",
    )
    axes.grid(alpha=0.3)
