"""How near to the truth looks are, over random vases, lights and noise, with exact poses."""

from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from typing import Literal

import numpy as np

from extremal.estimator import osculating_circle
from extremal.scenes import Ellipsoid, Lathe, Sphere, Surface, load_scene, randomised
from extremal.scripts.look import LookSettings, take_look
from extremal.scripts.scoring import Scored
from extremal.scripts.track_coverage import Coverage, track_coverage

Experiment = Literal["metric", "book"]
EXPERIMENTS: tuple[Experiment, ...] = ("metric", "book")
SADDLE = 20.0  # [1/m^2] |K| above which its sign is scored


@dataclass(frozen=True)
class LookAccuracy:
    """Accuracy over all points of several looks; lengths in mm, shares from 0 to 1 (docs/accuracy.md)."""

    experiment: str
    extremal_points: int
    fixed_points: int
    median_radius_error_mm: float
    median_sigma_mm: float
    extremal_coverage: float
    fixed_coverage: float
    median_position_error_across_mm: float
    fixed_called_extremal: float
    extremal_called_extremal: float
    side_right: float
    gaussian_sign_right: float
    tracked: float
    tracked_transversal: float
    false_tracks: float
    vision_frames_per_s: float


def ray_accuracy() -> dict[str, float]:
    """Largest |R error| [mm] of three and fifteen exact rays, for sections that are circles."""
    objects: dict[str, Surface] = {
        "sphere": Sphere(radius=0.04),
        "lathe, across its axis": Lathe(profile_z=[0, 0.05, 0.1, 0.2], profile_r=[0.04, 0.04, 0.04, 0.04]),
        "ellipsoid of revolution": Ellipsoid(a=0.04, b=0.04, c=0.07),
    }
    worst = {}
    for name, item in objects.items():
        height = 0.1 if name.startswith("lathe") else 0.0
        errors = []
        for views, baseline, distance in ((3, 0.1, 0.5), (15, 0.4, 0.6)):
            y = np.linspace(-0.5, 0.5, views) * baseline
            centres = np.stack([np.full(views, -distance), y, np.full(views, height)], axis=1)
            for side in (1.0, -1.0):
                start = np.tile([0.0, 0.04 * side, height], (1, 1))
                plane = np.array([[0.0, 0.0, 1.0]])
                points = np.concatenate([item.contour_points_in_planes(start, c, plane) for c in centres])
                rays = points - centres
                circle = osculating_circle(centres, rays / np.linalg.norm(rays, axis=1, keepdims=True))
                errors.append(
                    abs(abs(float(circle.radius)) - float(item.section_radius(points[0], plane[0]))) * 1e3
                )
        worst[name] = max(errors)
    return worst


def look_study(
    scene: str, seeds: int, progress: Callable[[int, int], None] | None = None
) -> list[LookAccuracy]:
    """Accuracy of both experiments over random variations of a scene, two looks at a time."""
    jobs = [(scene, experiment, seed) for experiment in EXPERIMENTS for seed in range(seeds)]
    results = []
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        for result in pool.map(_one_look, jobs):
            results.append(result)
            if progress:
                progress(len(results), len(jobs))
    return [
        _look_accuracy(experiment, results[i * seeds : (i + 1) * seeds])
        for i, experiment in enumerate(EXPERIMENTS)
    ]


def _one_look(arguments: tuple[str, Experiment, int]) -> tuple[Scored, Coverage, np.ndarray, float]:
    name, experiment, seed = arguments
    scene = randomised(load_scene(name), np.random.default_rng(seed))
    result = take_look(scene, LookSettings(scene=name, experiment=experiment, seed=seed), workers=1)
    error = result.scored.column("position_m") - result.scored.column("true_position_m")
    rays = result.shape.rays
    across = np.linalg.norm(error - np.sum(error * rays, axis=1, keepdims=True) * rays, axis=1)
    speed = len(result.recording.views) / result.timing["vision"]
    return result.scored, track_coverage(result.shape, result.recording, scene), across, speed


def _look_accuracy(
    experiment: str, results: Iterable[tuple[Scored, Coverage, np.ndarray, float]]
) -> LookAccuracy:
    scored, coverages, across, speeds = (list(column) for column in zip(*results, strict=True))

    def column(name: str) -> np.ndarray:
        return np.concatenate([s.column(name) for s in scored])

    truth, label = column("true_label"), column("label")
    error = np.abs(column("radius_m") - column("true_radius_m"))
    sigma, sign = column("sigma_radius_m"), column("gaussian_sign")
    curvature = np.concatenate([s.gaussian_curvature for s in scored])
    extremal, fixed = truth == "extremal", truth == "fixed"
    called = extremal & (label == "extremal")
    clear = extremal & (np.abs(column("true_radius_m")) > 4 * sigma)
    curved = called & (np.abs(curvature) > SADDLE)
    return LookAccuracy(
        experiment,
        int(extremal.sum()),
        int(fixed.sum()),
        1e3 * float(np.median(error[extremal])),
        1e3 * float(np.median(sigma[extremal])),
        float(np.mean(error[extremal] < 1.96 * sigma[extremal])),
        float(np.mean(error[fixed] < 1.96 * sigma[fixed])),
        1e3 * float(np.median(np.concatenate(across)[extremal])),
        float(np.mean(label[fixed] == "extremal")),
        float(np.mean(label[clear] == "extremal")),
        float(np.mean((column("side") == column("true_side"))[called])),
        float(np.mean((sign == np.sign(curvature))[curved])),
        float(np.mean([c.complete for c in coverages])),
        float(np.mean([c.transversal for c in coverages])),
        float(np.mean([c.false for c in coverages])),
        float(np.median(speeds)),
    )


def ray_table(rays: dict[str, float]) -> str:
    rows = [f"| {name} | {value:.1e} |" for name, value in rays.items()]
    return "\n".join(["| exact rays of | largest R error [mm] |", "|---|---|", *rows])


def look_table(looks: list[LookAccuracy]) -> str:
    rows = [
        (
            "points on extremal boundaries / on fixed features",
            lambda x: f"{x.extremal_points} / {x.fixed_points}",
        ),
        ("median abs(R error), extremal [mm]", lambda x: f"{x.median_radius_error_mm:.3f}"),
        ("median sigma of R, extremal [mm]", lambda x: f"{x.median_sigma_mm:.3f}"),
        ("abs(R error) < 1.96 sigma, extremal", lambda x: f"{100 * x.extremal_coverage:.1f} %"),
        ("abs(R error) < 1.96 sigma, fixed", lambda x: f"{100 * x.fixed_coverage:.1f} %"),
        (
            "contour generator, median error across the ray [mm]",
            lambda x: f"{x.median_position_error_across_mm:.4f}",
        ),
        ("fixed features called extremal", lambda x: f"{100 * x.fixed_called_extremal:.1f} %"),
        (
            "extremal points with R > 4 sigma called extremal",
            lambda x: f"{100 * x.extremal_called_extremal:.1f} %",
        ),
        ("side of the surface right", lambda x: f"{100 * x.side_right:.1f} %"),
        ("sign of K right where abs(K) > 20 1/m^2", lambda x: f"{100 * x.gaussian_sign_right:.1f} %"),
        ("contours and creases covered by tracks that last", lambda x: f"{100 * x.tracked:.1f} %"),
        ("the same without edges along the epipolar lines", lambda x: f"{100 * x.tracked_transversal:.1f} %"),
        ("tracks farther than 1 px from any true edge", lambda x: f"{100 * x.false_tracks:.2f} %"),
        ("vision [frames/s], two looks at a time", lambda x: f"{x.vision_frames_per_s:.0f}"),
    ]
    head = ["| | " + " | ".join(x.experiment for x in looks) + " |", "|---" * (len(looks) + 1) + "|"]
    return "\n".join(
        head + [f"| {name} | " + " | ".join(show(x) for x in looks) + " |" for name, show in rows]
    )
