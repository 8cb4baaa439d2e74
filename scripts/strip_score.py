"""How far a strip and its continuation are from the true surface, and how well sigma tells."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from extremal.estimator.camera import Array
from extremal.estimator.extrapolation import Extrapolation
from extremal.estimator.strip import Strip
from extremal.scenes import Scene

TRUSTED = (1e-3, 3e-3)  # [m] sigma to which the continuation is scored


@dataclass(frozen=True, eq=False)
class Distances:
    """Signed distances (k,) [m] of vertices from the nearest true surface, positive outside, and their sigma (k,) [m]."""

    distance: Array
    sigma: Array

    def numbers(self) -> dict[str, Any]:
        """As in result.json; null where there is no vertex."""
        off, count = np.abs(self.distance), len(self.distance)
        return {
            "vertices": count,
            "rms_m": float(np.sqrt(np.mean(off**2))) if count else None,
            "p95_m": float(np.percentile(off, 95)) if count else None,
            "sigma_m": float(np.median(self.sigma)) if count else None,
            "coverage_2sigma": float(np.mean(off < 2 * self.sigma)) if count else None,
        }


@dataclass(frozen=True, eq=False)
class StripScore:
    """Distances of all valid vertices; of every run with the object it lies on; of what lies beyond, by what it is trusted to
    [m]; and of all vertices of strip (S, T) and continuation (S, K), whether valid or not."""

    whole: Distances
    strips: list[tuple[str, Distances]]
    extrapolated: list[tuple[float, Distances]]
    distance: Array
    beyond: Array


def score_strip(scene: Scene, strip: Strip, extrapolation: Extrapolation) -> StripScore:
    """Distances to exact surfaces."""
    distance, nearest = _nearest(scene, strip.points)
    beyond, _ = _nearest(scene, extrapolation.points)
    sigma = strip.sigma

    def chosen(mask: np.ndarray) -> Distances:
        return Distances(distance[mask], sigma[mask])

    strips = []
    for k in np.unique(strip.run):
        mask = strip.valid & (strip.run == k)[:, None]
        if mask.any():
            owner = int(np.bincount(nearest[mask]).argmax())
            strips.append((scene.objects[owner].name, chosen(mask)))
    extrapolated = []
    for level in TRUSTED:
        mask = extrapolation.trusted(level) & ~extrapolation.seen
        extrapolated.append((level, Distances(beyond[mask], extrapolation.sigma[mask])))
    return StripScore(chosen(strip.valid), strips, extrapolated, distance, beyond)


def _nearest(scene: Scene, points: Array) -> tuple[Array, np.ndarray]:
    """Signed distance (...) [m] to the surface nearest to points (..., 3), and the number of its object."""
    distances = np.stack([surface.signed_distance(points) for surface in scene.objects])
    nearest = np.argmin(np.abs(distances), axis=0)
    return np.take_along_axis(distances, nearest[None], axis=0)[0], nearest
