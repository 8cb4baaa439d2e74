"""Figures of sensitivity: estimated R against one error, from re-estimation and to first order."""

from dataclasses import dataclass
from pathlib import Path

import matplotlib
import numpy as np

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes

from extremal.estimator.camera import Array

COLOURS = ("#d62728", "#1f77b4", "#2ca02c")


@dataclass(frozen=True, eq=False)
class Curve:
    """R [mm] (n) re-estimated with each error, and dR/derror [mm per unit] where the error is zero."""

    label: str
    radius: Array
    slope: float


@dataclass(frozen=True, eq=False)
class Figure:
    """Curves over the same errors (n).

    Attributes:
        name: of the file, without its suffix.
        title: of the figure; the book's counterpart is in it.
        error, unit: what the horizontal axis shows.
        errors: (n,) in that unit.
        curves: what is drawn.
    """

    name: str
    title: str
    error: str
    unit: str
    errors: Array
    curves: tuple[Curve, ...]


def draw(figure: Figure, truth: float, path: Path) -> None:
    """Write a figure (PNG); `truth` is R [mm]."""
    canvas, axes = plt.subplots(figsize=(7.2, 5.2), layout="constrained")
    draw_curves(axes, figure, truth)
    axes.set_title(figure.title, fontsize=11)
    canvas.savefig(path, dpi=120, format="png")
    plt.close(canvas)


def draw_curves(axes: Axes, figure: Figure, truth: float) -> None:
    """Draw a figure's curves; `truth` is R [mm]."""
    axes.axhline(truth, color="0.6", linewidth=0.8, linestyle=":")
    axes.axvline(0, color="0.85", linewidth=0.8, zorder=0)
    axes.axhline(0, color="0.85", linewidth=0.8, zorder=0)
    ends = figure.errors[[0, -1]]
    for curve, colour in zip(figure.curves, COLOURS, strict=False):
        at_zero = float(np.interp(0, figure.errors, curve.radius))
        axes.plot(ends, at_zero + curve.slope * ends, "-", color=colour, linewidth=1.0, alpha=0.75)
        axes.plot(figure.errors, curve.radius, "o", color=colour, markersize=4, label=curve.label)
    axes.plot(
        [], [], "o-", color="0.4", markersize=4, linewidth=1.0, label="dots: re-estimated; line: first order"
    )
    axes.plot([], [], ":", color="0.6", linewidth=0.8, label=f"true R = {truth:g} mm")
    axes.set(
        xlabel=f"{figure.error} [{figure.unit}]",
        ylabel="estimated radius of curvature R [mm]",
        xlim=ends * 1.04,
    )
    axes.grid(alpha=0.2)
    axes.legend(fontsize=9, framealpha=0.9)
