"""What the estimator found beside what is true: the points of `result.json`."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from extremal.estimator import Shape
from extremal.scenes import Scene
from extremal.sim import Recording

LABELS = {True: "extremal", False: "fixed"}
TEXTS = {"object", "contour", "label", "true_label"}
WIDTHS = {"pixel": 2, "position_m": 3, "sigma_position_m": 3, "true_position_m": 3}
Point = dict[str, Any]


@dataclass(frozen=True, eq=False)
class Scored:
    """Estimate and truth of n points (docs/result.md gives the meaning of each field of `points`), and the true Gaussian
    curvature (n,) [1/m^2], NaN for fixed features."""

    points: list[Point]
    gaussian_curvature: np.ndarray

    def column(self, name: str) -> np.ndarray:
        """Values (n,) or (n, 2 or 3) of one field; NaN or "" where it is null."""
        values = [p[name] for p in self.points]
        if name in TEXTS:
            return np.array([v or "" for v in values], dtype="U250")
        width = WIDTHS.get(name)
        if width is None:
            return np.array([np.nan if v is None else v for v in values], float)
        return np.array([[np.nan] * width if v is None else v for v in values], float).reshape(-1, width)


def score(shape: Shape, recording: Recording, scene: Scene) -> Scored:
    """Match every point with the scene by its own pixel's ray from where the camera really was."""
    actual = recording.actual[shape.reference]
    believed = shape.T_world_camera[shape.reference]
    into_truth = (
        (actual * believed.inv()).rotation.as_matrix().T
    )  # row vectors: believed world to actual world
    travel = recording.actual[-1].translation - recording.actual[0].translation
    travel = travel / np.linalg.norm(travel)
    rays = shape.rays @ into_truth
    planes = np.cross(travel, rays)
    planes /= np.linalg.norm(planes, axis=1, keepdims=True)
    truth = scene.truth(actual.translation, rays, shape.tangent_planes @ into_truth, planes)
    ahead = np.where(truth.normal @ travel > 0, 1.0, -1.0)
    extremal = truth.kind == "extremal"
    points = []
    for i in range(len(rays)):
        matched, limb = bool(truth.matched[i]), bool(extremal[i])
        points.append(
            {
                "object": str(truth.object[i]) if matched else None,
                "contour": f"contour-{shape.contour[i]}",
                "pixel": _numbers(shape.pixels[i]),
                "label": LABELS[bool(shape.extremal[i])],
                "true_label": LABELS[limb] if matched else None,
                "radius_m": _number(shape.radius[i]),
                "sigma_radius_m": _number(shape.sigma_radius[i]),
                "true_radius_m": _number(truth.radius[i] * ahead[i] if limb else 0.0) if matched else None,
                "relative_radius_m": _number(shape.relative_radius[i]),
                "sigma_relative_radius_m": _number(shape.sigma_relative_radius[i]),
                "position_m": _numbers(shape.position[i]),
                "sigma_position_m": _numbers(np.sqrt(np.diagonal(shape.covariance[i]))),
                "true_position_m": _numbers(truth.point[i]) if matched else None,
                "side": int(shape.side[i]) or None,
                "true_side": int(ahead[i]) if limb else None,
                "gaussian_sign": int(shape.gaussian_sign[i]) or None,
                "true_gaussian_sign": _sign(truth.gaussian_curvature[i]) if limb else None,
            }
        )
    return Scored(points, truth.gaussian_curvature)


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _numbers(values: np.ndarray) -> list[float] | None:
    return [float(v) for v in values] if np.all(np.isfinite(values)) else None


def _sign(value: float) -> int:
    return 0 if abs(value) < 1e-9 else int(np.sign(value))
