"""The picture of a calibration: where corners were seen, and what the fit leaves of them."""

from pathlib import Path

import matplotlib
import numpy as np

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from extremal.estimator.calibrate import CalibrationFit
from extremal.estimator.projection import projection

LENGTHENED = 500.0  # residuals as drawn


def draw_calibration(fit: CalibrationFit, path: Path) -> None:
    """Write the picture (PNG): residuals over the image, and their scatter."""
    camera, board = fit.calibration.camera, fit.calibration.board
    to_camera = fit.T_board_camera.inv()
    points = np.array([to_camera[i].apply(board.corners) for i in range(len(to_camera))])
    at, left = projection(camera, points)[0][fit.used], fit.residuals[fit.used]
    figure, (image, scatter) = plt.subplots(
        1, 2, figsize=(12.5, 5.4), gridspec_kw={"width_ratios": [1.5, 1]}, layout="constrained"
    )
    image.quiver(
        *at.T, *left.T, angles="xy", scale=1 / LENGTHENED, scale_units="xy", width=0.0015, color="#1f77b4"
    )
    image.plot(*at.T, ".", color="#ff7f0e", markersize=2)
    image.set(
        xlim=(-0.5, camera.width - 0.5),
        ylim=(camera.height - 0.5, -0.5),
        aspect="equal",
        title=f"{len(at)} corners of {fit.calibration.views} views; residuals x {LENGTHENED:g}",
        xlabel="x [px]",
        ylabel="y [px]",
    )
    reach = 1.1 * float(np.abs(left).max())
    scatter.plot(*left.T, ".", markersize=3, color="#1f77b4")
    scatter.set(
        xlim=(-reach, reach),
        ylim=(-reach, reach),
        aspect="equal",
        title=f"residuals, {fit.calibration.rms:.3f} px rms",
        xlabel="x [px]",
        ylabel="y [px]",
    )
    scatter.grid(alpha=0.3)
    figure.savefig(path, dpi=110, format="png")
    plt.close(figure)
