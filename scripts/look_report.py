"""The report of `extremal look`."""

from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes
from rich.table import Table

from extremal.scenes import Scene
from extremal.scripts.look_result import Look
from extremal.scripts.picture import draw_against_truth, draw_labelled
from extremal.scripts.poses import pose_errors
from extremal.scripts.radius_history import RadiusHistory, draw_histories, radius_histories
from extremal.scripts.report import Report
from extremal.scripts.report_scene import Scene3D, label_colours
from extremal.scripts.scoring import Scored

NEAR = 0.03  # [m] around a point in which truth for it is looked for


def look_report(scene: Scene, name: str, seed: int, look: Look, table: Table) -> Report:
    """What was seen: in numbers, in 3D, in figures and in the command's `table`. `name` is the scene's, as it was given."""
    used, scored = look.settings, look.scored
    way = f"{used['views']} views over {used['baseline']:g} m at {used['distance']:g} m"
    report = Report(f"extremal look: {name}", f"{way}, seed {seed}").facts(_facts(look))
    report.scene(
        look_scene(scene, look),
        "Contour points in space, extremal (blue) and fixed (orange), and the camera on its way, as estimated. Objects are the "
        "truth. Drag to turn, pinch or scroll to zoom; the button at the lower right switches parts on and off.",
    )
    reference = look.recording.views[look.shape.reference].image
    report.figure(
        lambda axes: draw_labelled(axes, reference, look.shape.tangents, scored),
        "The reference view. x: fixed feature. Twin arrow: apparent contour, the surface to its right, coloured by the radius of "
        "curvature R of the epipolar section.",
    ).figure(lambda axes: draw_against_truth(axes, scored), "R against truth, with 95 % bars.")
    if histories := [_with_truth(h, scored) for h in radius_histories(look.recording.views)]:
        report.figure(
            lambda axes: draw_histories(axes, histories),
            "R over looks, with 95 % bars, view by view: the best known extremal and fixed points. Dotted: the nearest truth.",
        )
    if not look.prior.exact:
        report.figure(
            lambda axes: _draw_poses(axes, look), "Poses as believed: how far off, and how far they may be."
        )
    report.section("Contours").table(table)
    return report.section("How it was made").settings({"scene": name} | used | {"seed": seed})


def agreement(scored: Scored) -> tuple[float, float, int]:
    """Median error of R on extremal boundaries [m], share of points within 1.96 sigma, and number of points that have a truth;
    NaN where there is none."""
    error = np.abs(scored.column("radius_m") - scored.column("true_radius_m"))
    known = np.isfinite(error)
    extremal = known & (scored.column("true_label") == "extremal")
    median = float(np.median(error[extremal])) if extremal.any() else np.nan
    inside = (error < 1.96 * scored.column("sigma_radius_m"))[known]
    return median, float(inside.mean()) if known.any() else np.nan, int(known.sum())


def look_scene(scene: Scene, look: Look) -> Scene3D:
    """Points, cameras with their images, and the objects."""
    shape, views = look.shape, look.recording.views
    view = Scene3D.beside(scene.target, shape.T_world_camera.translation).objects(scene)
    view.points("contours", shape.position, label_colours(shape.extremal))
    return view.cameras(views[0].camera, shape.T_world_camera, [v.image for v in views])


def _facts(look: Look) -> dict[str, str]:
    median, inside, known = agreement(look.scored)
    facts = {
        "contour points": str(len(look.scored.points)),
        "of them extremal": str(int(look.shape.extremal.sum())),
    }
    if known:
        facts["median |R error|, extremal"] = f"{1e3 * median:.2f} mm" if np.isfinite(median) else "-"
        facts["within 1.96 sigma"] = f"{100 * inside:.1f} %"
    seconds = look.timing["vision"]
    return facts | {"vision": f"{seconds:.1f} s", "rendering": f"{look.timing['render']:.1f} s"}


def _with_truth(history: RadiusHistory, scored: Scored) -> RadiusHistory:
    """The history with R of the nearest true point of the same side of a surface; a fixed feature's is zero."""
    if not history.extremal:
        return replace(history, true_radius=0.0)
    truth = scored.column("true_radius_m")
    distance = np.linalg.norm(scored.column("position_m") - history.position, axis=1)
    distance[~((scored.column("true_label") == "extremal") & (truth * history.radius[-1] > 0))] = np.inf
    distance = np.where(np.isfinite(distance), distance, np.inf)
    if not distance.min(initial=np.inf) < NEAR:
        return history
    return replace(history, true_radius=float(truth[np.argmin(distance)]))


def _draw_poses(axes: Axes, look: Look) -> None:
    found = pose_errors(look.recording, look.prior)
    views = np.arange(1, len(found) + 1)
    for quantity, unit, marker in (("m", "mm", "o"), ("rad", "mrad", "s")):
        error, sigma = (
            np.array([1e3 * p[f"{name}_{quantity}"] for p in found]) for name in ("error", "sigma")
        )
        (line,) = axes.plot(views, error, marker, markersize=4, label=f"error [{unit}]")
        axes.plot(views, sigma, color=line.get_color(), linewidth=1.0, label=f"sigma [{unit}]")
    axes.set(xlabel="view", ylim=(0, None))
    axes.grid(alpha=0.25)
    axes.legend(fontsize=9)
