"""The labelled picture: the book's convention for fixed features and apparent contours, beside R against truth."""

from pathlib import Path

import matplotlib
import numpy as np

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from extremal.scripts.scoring import Scored

LOOSE = 10.0  # [mm] sigma up to which R is always plotted
SPACING = 14.0  # [px] between symbols
SIGNS = {1: "K > 0", -1: "K < 0"}
FIXED, CONVEX, SADDLE = "#ff7f0e", "#1f77b4", "#d62728"


def draw(image: np.ndarray, tangents: np.ndarray, scored: Scored, title: str, path: Path) -> None:
    """Write the picture (PNG) of a reference frame (height, width) with its labelled contour points.

    `tangents` (n, 2) are the contours' unit tangents [px] at the points, the surface to the right of them where a
    point is extremal.
    """
    figure, (left, right) = plt.subplots(
        1, 2, figsize=(15, 6.2), gridspec_kw={"width_ratios": [1.45, 1]}, layout="constrained"
    )
    draw_labelled(left, image, tangents, scored)
    left.set_title(title)
    left.legend(
        handles=_legend(), loc="upper center", bbox_to_anchor=(0.5, -0.01), ncols=2, fontsize=9, frameon=False
    )
    draw_against_truth(right, scored)
    figure.savefig(path, dpi=110, format="png")
    plt.close(figure)


def draw_labelled(axes: Axes, image: np.ndarray, tangents: np.ndarray, scored: Scored) -> None:
    """Draw a reference frame with its labelled contour points; see `draw`."""
    height, width = image.shape[:2]
    axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), xticks=[], yticks=[])
    axes.imshow(image, cmap="gray", vmin=0, vmax=255)
    pixels, radius = scored.column("pixel"), np.abs(scored.column("radius_m")) * 1e3
    extremal, sign = scored.column("label") == "extremal", scored.column("gaussian_sign")
    shown = _thinned(pixels)
    fixed = shown & ~extremal
    axes.plot(*pixels[fixed].T, "x", color=FIXED, markersize=5, markeredgewidth=1.3)
    shown &= extremal & np.isfinite(radius)
    colours = plt.get_cmap("viridis")
    top = max(20.0, float(np.percentile(radius[shown], 95))) if shown.any() else 20.0
    for shift in (0.0, 5.0):  # the twin arrow: two heads on the contour, the second a little behind the first
        at = pixels[shown] - shift * tangents[shown]
        arrows = axes.quiver(
            *at.T,
            *tangents[shown].T,
            radius[shown],
            cmap=colours,
            clim=(0, top),
            angles="xy",
            pivot="tip",
            scale=1 / 9,
            scale_units="xy",
            width=0.0022,
            headwidth=5,
            headlength=5,
            headaxislength=4,
            edgecolor="white",
            linewidth=0.25,
        )
    for value, marker in ((1, "o"), (-1, "s")):
        chosen = shown & (sign == value)
        inward = np.stack([-tangents[chosen, 1], tangents[chosen, 0]], axis=1)
        colour = CONVEX if value > 0 else SADDLE
        axes.plot(*(pixels[chosen] + 7 * inward).T, marker, color=colour, markersize=3, markeredgewidth=0)
    axes.figure.colorbar(arrows, ax=axes, label="|R| of the epipolar section [mm]", shrink=0.8, pad=0.01)


def _legend() -> list[Line2D]:
    def entry(marker: str, colour: str, label: str) -> Line2D:
        return Line2D([], [], linestyle="", marker=marker, color=colour, label=label)

    return [
        entry("x", FIXED, "fixed feature (marking, crease)"),
        entry("$\\gg$", "#2a788e", "apparent contour; the surface is to the right of the twin arrow"),
        entry("o", CONVEX, "K > 0 (on the surface's side)"),
        entry("s", SADDLE, "K < 0"),
    ]


def _thinned(pixels: np.ndarray) -> np.ndarray:
    """Mask (n,) of points at least SPACING apart."""
    keep = np.zeros(len(pixels), bool)
    for i, pixel in enumerate(pixels):
        keep[i] = not np.any(np.sum((pixels[keep] - pixel) ** 2, axis=1) < SPACING**2)
    return keep


def draw_against_truth(axes: Axes, scored: Scored) -> None:
    """Draw estimated against true R, with 95 % bars."""
    truth, radius, sigma = (
        scored.column(name) * 1e3 for name in ("true_radius_m", "radius_m", "sigma_radius_m")
    )
    extremal = scored.column("label") == "extremal"
    known = np.isfinite(truth) & np.isfinite(radius) & np.isfinite(sigma)
    plotted = known & (sigma < np.maximum(LOOSE, 3 * np.median(sigma[known]) if known.any() else 0.0))
    groups = (
        (known & ~extremal, FIXED, "x", "labelled fixed"),
        (plotted & extremal, CONVEX, ".", "labelled extremal"),
    )
    for chosen, colour, marker, label in groups:
        if chosen.any():
            jitter = np.linspace(-0.7, 0.7, chosen.sum())
            axes.errorbar(
                truth[chosen] + jitter,
                radius[chosen],
                1.96 * sigma[chosen],
                fmt=marker,
                color=colour,
                elinewidth=0.5,
                alpha=0.7,
                markersize=4,
                label=label,
            )
    values = np.concatenate([truth[plotted], radius[plotted]]) if plotted.any() else np.array([-50.0, 50.0])
    low, high = np.percentile(values, [1, 99]) * 1.15 + (-1, 1)
    axes.plot([low, high], [low, high], color="0.5", linewidth=0.8, zorder=0)
    error = np.abs(radius - truth)[known]
    inside = (error < 1.96 * sigma[known]).mean() if known.any() else np.nan
    axes.set(
        xlabel="true R [mm] (spread sideways by up to 0.7 mm)",
        ylabel="estimated R [mm], bars: 95 %",
        xlim=(low, high),
        ylim=(low, high),
        title=f"R against truth: {known.sum()} points, {100 * inside:.0f} % within their bars"
        + (
            f"\n({(known & ~plotted).sum()} not shown: along epipolar lines R is not known)"
            if (known & ~plotted).any()
            else ""
        ),
    )
    if known.any():
        axes.legend(loc="upper left", fontsize=9)
    axes.grid(alpha=0.25)
