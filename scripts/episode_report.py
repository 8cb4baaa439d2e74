"""The report of an episode: what the camera saw on its way, and what was known of R at each step."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray
from rich.table import Table
from scipy.spatial.transform import RigidTransform

from extremal.estimator import Camera
from extremal.scenes import Scene
from extremal.scripts.report import Report
from extremal.scripts.report_scene import Scene3D, label_colours
from extremal.tasks.features import Features

BARS = 1.96
LOOSEST = 3.0  # a bar longer than so many times the last R is left out: nothing is known


@dataclass(frozen=True, eq=False)
class Look:
    """One step of an episode: where the camera was, what was known, and the picture of both."""

    T_world_camera: RigidTransform
    features: Features
    picture: NDArray[np.uint8]

    @property
    def best(self) -> tuple[float, float]:
        """R and its sigma [m] of the best known extremal point in view; NaN where there is none."""
        f = self.features
        known = np.flatnonzero(f.visible & f.extremal & np.isfinite(f.best_sigma))
        if len(known) == 0:
            return np.nan, np.nan
        i = known[np.argmin(f.best_sigma[known])]
        return float(f.best_radius[i]), float(f.best_sigma[i])


def episode_report(
    task: str, scene: Scene, camera: Camera, looks: Sequence[Look], table: Table, settings: Mapping[str, Any]
) -> Report:
    """The camera's way in 3D with what its eye saw, R over looks, and the scores."""
    report = Report(
        f"extremal {task.lower()}", f"{settings['policy']}, seed {settings['seed']}, {len(looks) - 1} steps"
    )
    last, poses = looks[-1].features, RigidTransform.concatenate([look.T_world_camera for look in looks])
    width = looks[0].picture.shape[1] // 2  # the left half is the hand's view
    view = Scene3D.beside(scene.target, poses.translation).objects(scene)
    view.points("features", last.position, label_colours(last.extremal))
    view.cameras(camera, poses, [look.picture[:, :width] for look in looks], step=0.1)
    report.scene(
        view,
        "The camera on its way, and in the end the features that it tracked: extremal (blue), fixed (orange).",
    )
    report.figure(
        lambda axes: _draw_best(axes, looks),
        "R over looks, with 95 % bars: at each step the extremal point in view that is known best; it may be another one each time.",
    ).figure(lambda axes: _draw_counts(axes, looks), "Features that are tracked, by their labels.")
    report.picture(looks[-1].picture, "The end: the hand's view, and the scene from outside.")
    return report.section("Scores").table(table).section("How it was made").settings(settings)


def _draw_best(axes: Axes, looks: Sequence[Look]) -> None:
    radius, sigma = 1e3 * np.abs(np.array([look.best for look in looks]).T)
    shown = np.flatnonzero(np.isfinite(radius) & (BARS * sigma < LOOSEST * radius))
    axes.errorbar(
        shown, radius[shown], BARS * sigma[shown], fmt=".", color="#1f77b4", elinewidth=0.8, markersize=4
    )
    axes.set(xlabel="step", ylabel="|R| [mm], bars: 95 %", xlim=(0, len(looks)), ylim=(0, None))
    axes.grid(alpha=0.25)


def _draw_counts(axes: Axes, looks: Sequence[Look]) -> None:
    extremal = np.array([int(look.features.extremal.sum()) for look in looks])
    every = np.array([len(look.features) for look in looks])
    axes.stackplot(
        np.arange(len(looks)),
        extremal,
        every - extremal,
        labels=("extremal", "fixed"),
        colors=("#1f77b4", "#ff7f0e"),
        alpha=0.8,
    )
    axes.set(xlabel="step", ylabel="features", xlim=(0, max(1, len(looks) - 1)))
    axes.legend(loc="upper left", fontsize=9)
    axes.grid(alpha=0.25)
