"""The pictures of `extremal strip`: the conjugate grid, the unseen views, the surface beyond (figures 3.14 and 3.15)."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib
import numpy as np

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from extremal.estimator.camera import Array, View
from extremal.estimator.extrapolation import Extrapolation
from extremal.estimator.strip import Strip
from extremal.estimator.strip_prediction import Prediction

GENERATORS, ARCS, PREDICTED = "#1f77b4", "#2ca02c", "#d62728"
LEVELS = ((1e-3, "#4c9be8", "trusted to 1 mm"), (3e-3, "#f2b134", "trusted to 3 mm"))
SEEN = "#c0392b"
LIGHT = np.array([-0.6, -0.35, 0.72])  # towards it
ARC_STEP = 3  # arcs between those that are drawn
MARGIN = 25  # [px] around what is drawn


def draw_strip(view: View, strip: Strip, distance: Array, title: str, path: Path) -> None:
    """The grid over the frame of a view, and distances (S, T) [m] of its vertices from the true surface beside their sigma."""
    figure, (left, right) = plt.subplots(
        1, 2, figsize=(14, 6), gridspec_kw={"width_ratios": [1.2, 1]}, layout="constrained"
    )
    _over_image(left, view, strip)
    left.set_title(title)
    sigma, valid = strip.sigma, strip.valid
    ratio = np.abs(distance[valid]) / sigma[valid]
    off = 1e3 * np.maximum(np.abs(distance[valid]), 1e-7)
    right.plot(1e3 * sigma[valid], off, ".", ms=2, color=GENERATORS)
    ends = np.array([0.0, 1e3 * sigma[valid].max()])
    right.plot(ends, 2 * ends, color="0.4", linewidth=1, label="2 sigma")
    rms = 1e3 * np.sqrt(np.mean(distance[valid] ** 2))
    right.set(
        xlabel="sigma along the normal [mm]",
        ylabel="distance to the true surface [mm]",
        title=f"{valid.sum()} vertices: {rms:.3f} mm rms, {100 * np.mean(ratio < 2):.1f} % within 2 sigma",
    )
    right.legend()
    right.grid(alpha=0.25)
    _save(figure, path)


def draw_prediction(
    views: Sequence[View], strip: Strip, predictions: Sequence[Prediction], names: Sequence[str], path: Path
) -> None:
    """The grid and the predicted contour over frames it was not made of; below, the image's edges against the prediction."""
    figure, axes = plt.subplots(
        2,
        len(views),
        figsize=(7 * len(views), 8.5),
        squeeze=False,
        gridspec_kw={"height_ratios": [2.6, 1]},
        layout="constrained",
    )
    for column, view, prediction, name in zip(axes.T, views, predictions, names, strict=True):
        _over_image(column[0], view, strip)
        shown = prediction.valid
        column[0].plot(
            *prediction.pixels[shown].T, ".", color=PREDICTED, markersize=3, label="predicted contour"
        )
        column[0].set_title(f"unseen view, {name}")
        column[0].legend(loc="upper center", bbox_to_anchor=(0.5, -0.01), ncols=3, fontsize=8, frameon=False)
        found = prediction.found
        at = np.flatnonzero(found)
        column[1].errorbar(
            at,
            prediction.offset[found],
            2 * prediction.sigma[found],
            fmt=".",
            color=GENERATORS,
            elinewidth=0.6,
            ms=3,
        )
        column[1].axhline(0, color="0.4", linewidth=0.8)
        column[1].set(
            xlabel="arc",
            ylabel="edge - prediction [px]",
            title=f"{prediction.rms:.3f} px rms of {found.sum()} points (bars: 2 sigma of the prediction)",
        )
        column[1].grid(alpha=0.25)
    _save(figure, path)


def draw_extrapolation(extrapolation: Extrapolation, distance: Array, path: Path) -> None:
    """The surface from a new viewpoint, in colours of trust; and sigma and distances (S, K) [m] against the angle beyond."""
    figure = plt.figure(figsize=(14, 6), layout="constrained")
    space = figure.add_subplot(1, 2, 1, projection="3d")
    assert isinstance(space, Axes3D)
    _in_space(space, extrapolation)
    axes = figure.add_subplot(1, 2, 2)
    phi, seen = extrapolation.phi, extrapolation.seen
    first = np.where(seen, phi, np.inf).min(axis=1, keepdims=True)
    last = np.where(seen, phi, -np.inf).max(axis=1, keepdims=True)
    beyond = np.degrees(np.maximum(np.maximum(phi - last, first - phi), 0.0))
    shown = extrapolation.valid & ~seen
    off = 1e3 * np.maximum(np.abs(distance[shown]), 1e-6)
    axes.semilogy(beyond[shown], off, ".", markersize=1.5, color="0.6", label="distance to the true surface")
    sigma = 1e3 * extrapolation.shape_sigma[shown]
    axes.semilogy(beyond[shown], sigma, ".", markersize=1.5, color=GENERATORS, label="sigma along the normal")
    for level, colour, name in LEVELS:
        axes.axhline(1e3 * level, color=colour, linewidth=1.2, label=name)
    axes.set(
        xlabel="angle of the normal beyond the outermost view [degrees]",
        ylabel="[mm]",
        ylim=(1e-3, 30),
        title="how far it can be trusted",
    )
    axes.legend(markerscale=5, fontsize=8)
    axes.grid(alpha=0.25)
    _save(figure, path)


def _over_image(axes: Axes, view: View, strip: Strip) -> None:
    axes.imshow(view.image, cmap="gray", vmin=0, vmax=255)
    pixels = np.where(strip.valid[..., None], view.project(strip.points), np.nan)
    arcs = [pixels[i] for i in range(0, len(pixels), ARC_STEP)]
    generators = [pixels[strip.run == k, t] for k in np.unique(strip.run) for t in range(pixels.shape[1])]
    axes.add_collection(LineCollection(arcs, colors=ARCS, linewidths=0.6, label="osculating arcs"))
    axes.add_collection(
        LineCollection(generators, colors=GENERATORS, linewidths=0.6, label="contour generators")
    )
    known = pixels[np.isfinite(pixels).all(axis=-1)]
    low, high = known.min(axis=0) - MARGIN, known.max(axis=0) + MARGIN
    height, width = view.image.shape[:2]
    axes.set(
        xlim=(max(low[0], -0.5), min(high[0], width - 0.5)),
        ylim=(min(high[1], height - 0.5), max(low[1], -0.5)),
        xticks=[],
        yticks=[],
    )
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.01), ncols=3, fontsize=8, frameon=False)


def _in_space(axes: Axes3D, extrapolation: Extrapolation) -> None:
    points, normals = extrapolation.points.reshape(-1, 3), extrapolation.normals.reshape(-1, 3)
    light = LIGHT / np.linalg.norm(LIGHT)
    drawn = np.zeros((0, 3), int)
    parts = [(SEEN, "strip that was seen", extrapolation.seen & extrapolation.valid)]
    parts += [(colour, name, extrapolation.trusted(level)) for level, colour, name in LEVELS]
    for colour, name, chosen in parts:
        faces = extrapolation.faces(chosen)
        new = faces[~_rows_in(faces, drawn)]
        drawn = np.concatenate([drawn, new])
        shade = 0.45 + 0.55 * np.abs(normals[new].mean(axis=1) @ light)
        rgb = np.array(to_rgb(colour)) * shade[:, None]
        axes.add_collection3d(
            Poly3DCollection(1e3 * points[new], facecolors=rgb, edgecolors=rgb, linewidths=0.2)
        )
        axes.plot([], [], "s", color=colour, label=name)
    shown = 1e3 * points[np.unique(drawn)]
    low, high = shown.min(axis=0), shown.max(axis=0)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set(xlabel="x [mm]", ylabel="y [mm]", zlabel="z [mm]", title="from a new viewpoint")
    axes.set_box_aspect(np.maximum(high - low, 1.0))
    axes.view_init(elev=28, azim=-140)
    axes.legend(loc="upper left", fontsize=8)


def _rows_in(faces: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Which rows of faces (F, 3) are among others (G, 3)."""
    known = {tuple(face) for face in np.sort(others, axis=1).tolist()}
    return np.array([tuple(face) in known for face in np.sort(faces, axis=1).tolist()], bool)


def _save(figure: Figure, path: Path) -> None:
    figure.savefig(path, dpi=110, format="png")
    plt.close(figure)
