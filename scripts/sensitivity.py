"""`extremal sensitivity`: what small errors of edges and egomotion do to R, in the book's geometry (fig. 3.11, 3.12)."""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table

from extremal.estimator.camera import Array
from extremal.scripts.book_setting import AXIS, BASELINE, CAMERA, FIXED_POINTS, TRAVEL, BookSetting
from extremal.scripts.output import output_folder
from extremal.scripts.report import Report
from extremal.scripts.sensitivity_figures import Curve, Figure, draw, draw_curves

VIEWS, LAST = 3, 2  # the last view is the one that is off in the figures
MILLI = 1e-3
EDGE_SIGMA = 0.1  # [px] of contour and fixed points in the joint estimate
POSE_SIGMA = np.full(6, 1e-3)  # [m], [rad] of each view, each axis, in the joint estimate
METHODS = {  # the book's curves I and II, and one more
    "absolute": "I absolute",
    "parallax": "II by parallax",
    "joint": f"III joint with {FIXED_POINTS} fixed points",
}
BOOK = {  # [%] Cipolla, fig. 3.12: per mm, per mrad
    "position": {"absolute": 155, "parallax": 19},
    "rotation": {"absolute": 100, "parallax": 12},
}


@dataclass(frozen=True)
class SensitivitySettings:
    """Show how errors of edges and egomotion reach R: figures 3.11 and 3.12 of the book, from 3 views over 0.1 m."""

    radius: float = 0.045
    """of the vase, at the point A of its extremal boundary [m]"""
    marking: float = 0.012
    """from A to the marking B, along the surface of the vase [m]"""
    distance: float = 0.5
    """from the path's centre to A [m]; 0.5 makes the total rotation 0.2 rad"""
    out: Path = Path("out/sensitivity")
    """folder that is written; what was there of the same names is replaced"""


def sensitivity(settings: SensitivitySettings) -> None:
    """Write report.html, sensitivity.json and the figures edge.png, position.png and rotation.png to `settings.out`."""
    setting = BookSetting.with_vase(settings.radius, settings.marking, settings.distance)
    console = Console(markup=False)
    with output_folder(settings.out) as folder:
        figures = [edge_figure(setting), position_figure(setting), rotation_figure(setting)]
        for figure in figures:
            draw(figure, 1e3 * setting.radius, folder / f"{figure.name}.png")
        content = summary(setting, figures)
        (folder / "sensitivity.json").write_text(json.dumps(content, indent=1, allow_nan=False) + "\n")
        tables = (_slopes_table(content), _views_table(content))
        _report(setting, figures, tables, content).save(folder / "report.html")
    for table in tables:
        console.print(table)
    console.print(
        f"wrote {settings.out}/: report.html, sensitivity.json, "
        + ", ".join(f"{f.name}.png" for f in figures)
    )


def _report(
    setting: BookSetting, figures: list[Figure], tables: Sequence[Table], content: dict[str, Any]
) -> Report:
    report = Report("extremal sensitivity", "what errors of edges and egomotion do to R")
    for figure in figures:
        report.figure(
            partial(draw_curves, figure=figure, truth=1e3 * setting.radius), figure.title.replace("\n", " ")
        )
    for table in tables:
        report.table(table)
    return report.section("How it was made").settings(content["geometry"])


# The figures.


def edge_figure(setting: BookSetting) -> Figure:
    """Figure 3.11: R against an edge error of the last view."""
    errors = np.linspace(-1, 1, 21)
    edges = np.zeros((len(errors), 2, VIEWS))
    edges[:, 0, LAST] = errors
    radius = setting.circles(edges, np.zeros((VIEWS, 6))).radius[:, 0]
    slope = 1e3 * float(setting.sensitivity().image[0, LAST, 0])
    curve = Curve(f"absolute: {abs(slope):.0f} mm per px", 1e3 * radius, slope)
    title = f"Error of edge localisation in the last view\n(the book's figure 3.11; f = {CAMERA.fx:g} px)"
    return Figure("edge", title, "error in edge localisation", "px", errors, (curve,))


def position_figure(setting: BookSetting) -> Figure:
    """Figure 3.12a: R against an error of the last camera's position along the travel."""
    title = f"Error of the last camera's position along the travel\n(the book's figure 3.12a; travel {1e3 * BASELINE:g} mm)"
    return _pose_figure(setting, "position", title, "mm", _in_camera(setting, TRAVEL, 0))


def rotation_figure(setting: BookSetting) -> Figure:
    """Figure 3.12b: R against an error of the last camera's rotation about the epipolar plane's normal."""
    turn = 1e3 * setting.rotation
    title = f"Error of the last camera's rotation in its epipolar plane\n(the book's figure 3.12b; rotation {turn:.0f} mrad)"
    return _pose_figure(setting, "rotation", title, "mrad", _in_camera(setting, AXIS, 3))


def _in_camera(setting: BookSetting, direction: Array, first: int) -> Array:
    """Pose error (3, 6) of the last view: 1 along a direction in the world, as translation (first 0) or rotation (3)."""
    error = np.zeros((VIEWS, 6))
    error[LAST, first : first + 3] = setting.views[LAST].T_world_camera.rotation.inv().apply(direction)
    return error


def _pose_figure(setting: BookSetting, name: str, title: str, unit: str, direction: Array) -> Figure:
    errors = np.linspace(-2.5, 2.5, 21)
    poses = MILLI * errors[:, None, None] * direction
    radius = setting.circles(np.zeros((2, VIEWS)), poses).radius
    by_point = setting.sensitivity().change(pose=direction)  # [m per m or rad] = [mm per mm or mrad]
    joint = np.array([joint_radius(setting, pose) for pose in poses])
    found = {
        "absolute": (radius[:, 0], float(by_point[0])),
        "parallax": (radius[:, 0] - radius[:, 1], float(by_point[0] - by_point[1])),
        "joint": (joint, _slope_at_zero(lambda e: joint_radius(setting, e * direction))),
    }
    curves = []
    for method, (values, slope) in found.items():
        label = f"{METHODS[method]}: {_short(_percent(setting, slope))} % of R per {unit}"
        if method in BOOK[name]:
            label += f" (the book: {BOOK[name][method]})"
        curves.append(Curve(label, 1e3 * values, slope))
    return Figure(name, title, f"error in {name}", unit, errors, tuple(curves))


def joint_radius(setting: BookSetting, pose_errors: Array) -> float:
    """R [m] at A, with 12 fixed points around, when the believed poses (3, 6) are off and all edges are exact."""
    edges, points = np.zeros(VIEWS), np.zeros((FIXED_POINTS, VIEWS, 2))
    return float(setting.joint(edges, points, pose_errors, EDGE_SIGMA, POSE_SIGMA).shapes[0].radius[0])


def _slope_at_zero(radius: Callable[[float], float], step: float = 1e-4) -> float:
    return (radius(step) - radius(-step)) / (2 * step)


def _percent(setting: BookSetting, slope: float) -> float:
    """Slope [mm per mm or mrad] as a percentage of R."""
    return abs(slope) / (1e3 * setting.radius) * 100


def _short(value: float) -> str:
    return f"{value:.0f}" if value >= 100 else f"{value:.1f}" if value >= 3 else f"{value:.2f}"


# What is written.


def summary(setting: BookSetting, figures: list[Figure]) -> dict[str, Any]:
    """The content of sensitivity.json; all slopes without their sign."""
    edge, position, rotation = figures

    def slopes(figure: Figure) -> dict[str, float]:
        return {m: _percent(setting, c.slope) for m, c in zip(METHODS, figure.curves, strict=True)}

    return {
        "version": version("extremal"),
        "position_percent_per_mm": slopes(position),
        "rotation_percent_per_mrad": slopes(rotation),
        "radius_mm_per_px": abs(edge.curves[0].slope),
        "geometry": {
            **asdict(setting),
            "baseline": BASELINE,
            "rotation": setting.rotation,
            "focal_length_px": CAMERA.fx,
            "view": LAST,
            "position_error": "along the travel",
            "rotation_error": "about the normal of the epipolar plane",
            "joint": {
                "fixed_points": FIXED_POINTS,
                "pose_sigma": POSE_SIGMA.tolist(),
                "edge_sigma_px": EDGE_SIGMA,
            },
        },
        "book": BOOK,
        "views": [by_view(setting, view) for view in range(VIEWS)],
    }


def by_view(setting: BookSetting, view: int) -> dict[str, Any]:
    """Slopes by the errors of one view; pairs are absolute and by parallax."""
    found = setting.sensitivity()
    rotation = setting.views[view].T_world_camera.rotation.as_matrix()
    a, b = found.pose[:, view].reshape(2, 2, 3) @ rotation.T  # by world directions
    pair = (a, a - b)
    along_axis = rotation[:, 2]
    return {
        "view": view,
        "position_along_travel_percent_per_mm": [_percent(setting, g[0] @ TRAVEL) for g in pair],
        "position_along_axis_percent_per_mm": [_percent(setting, g[0] @ along_axis) for g in pair],
        "position_rms_in_plane_percent_per_mm": [
            _percent(setting, np.linalg.norm(g[0]) / np.sqrt(2)) for g in pair
        ],
        "rotation_percent_per_mrad": [_percent(setting, g[1] @ AXIS) for g in pair],
        "edge_mm_per_px": 1e3 * abs(float(found.image[0, view, 0])),
    }


def _slopes_table(content: dict[str, Any]) -> Table:
    table = Table(title="change of R by errors of the last view", box=SIMPLE)
    table.add_column("")
    for name in (*METHODS, "the book: I, II"):
        table.add_column(name, justify="right")
    for name, unit in (("position", "mm"), ("rotation", "mrad")):
        slopes, book = content[f"{name}_percent_per_{unit}"], BOOK[name]
        cells = [_short(slopes[m]) for m in METHODS]
        table.add_row(f"{name} [% of R per {unit}]", *cells, f"{book['absolute']}, {book['parallax']}")
    table.add_row("edge: mm per px", _short(content["radius_mm_per_px"]), "", "", "")
    return table


def _views_table(content: dict[str, Any]) -> Table:
    table = Table(title="by view and direction: absolute / by parallax [% of R per mm, mrad]", box=SIMPLE)
    for name in ("view", "along travel", "along axis", "in plane, rms", "rotation", "edge: mm per px"):
        table.add_column(name, justify="right")
    for row in content["views"]:
        view, *pairs, edge = row.values()
        table.add_row(str(view + 1), *(f"{_short(a)} / {_short(b)}" for a, b in pairs), _short(edge))
    return table
