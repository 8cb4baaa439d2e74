"""The true shortest path of a sphere's centre around an obstacle: what planners are scored against."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from extremal.estimator.errors import InvalidInput
from extremal.scenes.curves import Array
from extremal.scenes.lathe import Lathe
from extremal.scenes.surface import Surface
from extremal.tasks.clairaut import lathe_paths
from extremal.tasks.taut_string import string_path

TOLERANCE = 2e-6  # [m] by which chords of exact paths may cut into the clearance


@dataclass(frozen=True, eq=False)
class Path:
    """A path of a point in free space.

    Attributes:
        points: (n, 3) [m], world frame, in order, n >= 2; read-only.
        length: [m]; of the curve that the points are taken from, so slightly more than the polyline's.
    """

    points: Array
    length: float

    def __post_init__(self) -> None:
        points = np.array(self.points, float)
        if points.ndim != 2 or points.shape[1] != 3 or len(points) < 2 or not np.all(np.isfinite(points)):
            raise InvalidInput(f"path has points {points.shape}; accepted: (n, 3) finite numbers, n >= 2")
        if not (np.isfinite(self.length) and self.length >= 0):
            raise InvalidInput(f"path length is {self.length!r}; accepted: a number of metres from 0")
        points.flags.writeable = False
        object.__setattr__(self, "points", points)

    @property
    def free_length(self) -> float:
        """Distance |AB| [m] between its ends: the length if there were no obstacle."""
        return float(np.linalg.norm(self.points[-1] - self.points[0]))


def winding(path: Path | ArrayLike) -> float:
    """Angle [rad] by which a path turns in all: the integral of its curvature.

    For a taut path around a cylinder, level: the angle that it wraps around. 0 for a straight path.

    Args:
        path: a Path or points (n, 3).
    """
    points = path.points if isinstance(path, Path) else np.asarray(path, float)
    steps = np.diff(points, axis=0)
    steps = steps[np.linalg.norm(steps, axis=1) > 1e-12]
    cross = np.linalg.norm(np.cross(steps[:-1], steps[1:]), axis=1)
    return float(np.sum(np.arctan2(cross, np.sum(steps[:-1] * steps[1:], axis=1))))


def shortest_path(surface: Surface, start: ArrayLike, goal: ArrayLike, clearance: float) -> Path:
    """Shortest path from start to goal that stays `clearance` away from a surface.

    The whole closed body counts, with the ways around it and over it, but not below (world -z): objects stand on
    something. Lathes: by Clairaut's relation, to 1e-6 of the length in about 25 ms, unless the string leaves the
    surface (steep paths across a waist) or the way over a cap may be shorter. Those, and all other surfaces:
    numerically, to 1e-5 (5e-5 around sharp edges) in one to five seconds, but a minute or more for a `Mesh`,
    whose facets are followed. Results are kept, by the surface's identity.

    Args:
        surface: the obstacle, the only one.
        start, goal: (3,) [m], world frame, at least `clearance` away from the surface.
        clearance: radius of the moving sphere plus the wanted distance [m], at least 0.1 mm.

    Raises:
        InvalidInput: a value is not finite or out of range, or an end is too near to the surface.
        NotConverged: the numerical path does not settle.
    """
    ends = []
    for name, value in (("start", start), ("goal", goal)):
        p = np.asarray(value, float)
        if p.shape != (3,) or not np.all(np.abs(p) <= 100):
            raise InvalidInput(f"{name} is {value!r}; accepted: three numbers within 100 m")
        ends.append(tuple(p.tolist()))
    if not (np.isfinite(clearance) and 1e-4 <= clearance <= 100):
        raise InvalidInput(f"clearance is {clearance!r}; accepted: from 0.0001 to 100 m")
    return _shortest_path(surface, ends[0], ends[1], float(clearance))


@lru_cache(maxsize=512)
def _shortest_path(
    surface: Surface, start: tuple[float, ...], goal: tuple[float, ...], clearance: float
) -> Path:
    a, b = np.array(start), np.array(goal)
    distances = surface.signed_distance(np.stack([a, b]))
    for name, p, distance in zip(("start", "goal"), (start, goal), distances, strict=True):
        if distance < clearance - TOLERANCE:
            raise InvalidInput(
                f"{name} {p} is {distance:.4g} m from {surface.name!r}; accepted: at least the clearance, {clearance:.4g} m"
            )
    straight = np.stack([a, b])
    if _least_distance(surface, straight) >= clearance - TOLERANCE:
        return Path(straight, float(np.linalg.norm(b - a)))
    if isinstance(surface, Lathe):
        found = [
            (points, length)
            for points, length in lathe_paths(surface, a, b, clearance)
            if _least_distance(surface, points) >= clearance - TOLERANCE
        ]
        best = min(found, key=lambda way: way[1], default=None)
        if best is not None and best[1] <= _over_a_cap(surface, a, b, clearance):
            return Path(*best)
        numerical = string_path(surface, a, b, clearance)
        # Where both found the same way, the exact answer is kept.
        return Path(*(best if best is not None and best[1] <= numerical[1] * (1 + 1e-5) else numerical))
    return Path(*string_path(surface, a, b, clearance))


def _over_a_cap(lathe: Lathe, start: Array, goal: Array, clearance: float) -> float:
    """No path over a flat cap of the offset lathe is shorter than this [m]: it must reach the cap's plane.

    A cap that faces down is left out.
    """
    T_object_world = lathe.T_world_object.inv()
    a, b = T_object_world.apply(start), T_object_world.apply(goal)
    across = float(np.hypot(*(b - a)[:2]))
    bounds = [np.inf]
    for level, up in ((lathe.profile.height + clearance, 1.0), (-clearance, -1.0)):
        if up * lathe.T_world_object.rotation.as_matrix()[2, 2] > -0.7:
            climbs = [max(up * (level - p[2]), 0.0) for p in (a, b)]
            bounds.append(float(np.hypot(across, sum(climbs))))
    return min(bounds)


def _least_distance(surface: Surface, points: Array) -> float:
    """Smallest signed distance [m] along a polyline (n, 3), to 1e-7 m near a smooth minimum."""
    s = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])

    def distances(at: Array) -> Array:
        return surface.signed_distance(np.stack([np.interp(at, s, x) for x in points.T], axis=1))

    at = np.union1d(np.linspace(0, s[-1], 81), s)
    d = distances(at)
    best = int(np.argmin(d))
    finer = np.linspace(at[max(best - 1, 0)], at[min(best + 1, len(at) - 1)], 81)
    return float(min(d[best], np.min(distances(finer))))
