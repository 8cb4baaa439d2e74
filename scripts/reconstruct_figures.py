"""Figures of a whole object: contours over frames, and distances to the truth by method."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from extremal.estimator.contour_generators import contour_generator
from extremal.estimator.whole import WholeSurface
from extremal.scripts.reconstruct_score import Distances

SHOWN = 4  # frames
TOP = 1e-3  # [m] at the end of the colour scale


def draw_frames(surface: WholeSurface, path: Path) -> None:
    """Frames with their outlines, and the recovered surface's own contour generators in them."""
    figure = Figure(figsize=(3.2 * SHOWN, 3.0), layout="constrained")
    FigureCanvasAgg(figure)
    chosen = np.linspace(0, len(surface.outlines), SHOWN, endpoint=False).astype(int)
    for axes, i in zip(figure.subplots(1, SHOWN), chosen, strict=True):
        outline = surface.outlines[i]
        axes.imshow(outline.view.image, cmap="gray", vmin=0, vmax=255)
        edges, _, points, _ = contour_generator(surface.mesh, outline.view.centre)
        pixels = outline.view.project(points[surface.observed[edges].all(axis=1)])
        axes.plot(*pixels.T, ".", ms=1, color="tab:orange")
        axes.plot(*outline.pixels.T, ".", ms=0.6, color="tab:cyan")
        axes.set_axis_off()
        axes.set_title(f"view {i}", fontsize=8)
    figure.suptitle(
        "outline in the image (blue), contour generators of the recovered surface (orange)", fontsize=9
    )
    figure.savefig(path, dpi=150)


def draw_distances(distances: Mapping[str, Distances], path: Path) -> None:
    """Distances outside the truth, by method, over the object as seen from the side."""
    figure = Figure(figsize=(3.4 * len(distances), 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    colours = colormaps["coolwarm"]
    all_axes = figure.subplots(1, len(distances), sharex=True, sharey=True)
    for axes, (name, found) in zip(np.atleast_1d(all_axes), distances.items(), strict=True):
        if len(found.points):
            front = np.argsort(-found.points[:, 0])
            shown = np.clip(0.5 + 0.5 * found.error[front] / TOP, 0, 1)
            axes.scatter(*(1e3 * found.points[front, 1:].T), s=3, c=colours(shown), linewidths=0)
        axes.set_aspect("equal")
        axes.set_title(name, fontsize=9)
        axes.set_xlabel("y [mm]")
    np.atleast_1d(all_axes)[0].set_ylabel("z [mm]")
    scale = ScalarMappable(Normalize(-1e3 * TOP, 1e3 * TOP), colours)
    figure.colorbar(scale, ax=all_axes, label="outside the truth [mm]")
    figure.savefig(path, dpi=150)
