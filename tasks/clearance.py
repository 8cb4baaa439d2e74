"""How near a sphere comes to the objects of a scene."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from extremal.estimator.camera import Array
from extremal.scenes import Scene
from extremal.tasks.compiled import compiled
from extremal.tasks.distances import SAMPLES, from_box, from_lathe, nearest, radial
from extremal.tasks.level_sets import BOX, LATHE, OTHER, Solids, local, profile
from extremal.tasks.triples import Vector, dot, plus, put, row

CHECKED = 0.004  # [m] between points of a step at which distance is measured


@compiled
def between(start: Array, end: Array) -> Array:
    """Points (n, 3) of a step, CHECKED apart, its end the last."""
    a = start[0], start[1], start[2]
    way = plus((end[0], end[1], end[2]), -1.0, a)
    count = 1 + int(math.sqrt(dot(way, way)) / CHECKED)
    out = np.empty((count, 3))
    for i in range(count):
        put(out, i, plus(a, (i + 1) / count, way))
    return out


class Clearance:
    """The smallest distance of a moving sphere from any object.

    A distance changes by no more than the sphere moves, and a convex object stays behind the tangent plane at its nearest
    point: objects are measured only where these bounds leave room for less than the smallest distance so far.
    """

    def __init__(self, scene: Scene, radius: float, smallest: float = np.inf) -> None:
        """`smallest`: distances [m] above it are of no interest."""
        self._surfaces, self._solids = scene.objects, Solids.of(scene.objects)
        self._last, self._meridians = _Last.before(self._solids), _meridians(self._solids)
        self._radius, self._least = radius, smallest + radius

    @property
    def smallest(self) -> float:
        """[m] from the sphere's surface, so far."""
        return self._least - self._radius

    def take_in(self, points: Array) -> None:
        """The centre comes through points (n, 3) [m], in this order."""
        self._least, untold = _approach(self._solids, self._last, self._meridians, points, self._least)
        for k in np.flatnonzero(untold) if untold.any() else ():
            found = self._surfaces[k].signed_distance(points)
            self._last.least[k], self._least = found[-1], min(self._least, float(found.min()))


class _Last(NamedTuple):
    """Where distances of K objects were measured last.

    Attributes:
        at: (K, 3) [m]; least: (K,) a bound [m] of distances: that there, less the way since. Before, `centred`: (K,) at is the
            middle of a sphere around the object, and the distance from there counts, plus `least`.
        foot: (K, 3) [m] the point of a convex object that was nearest, normal: (K, 3) there, in its frame, if `touched`: (K,).
    """

    at: Array
    least: Array
    centred: NDArray[np.bool_]
    foot: Array
    normal: Array
    touched: NDArray[np.bool_]

    @staticmethod
    def before(solids: Solids) -> "_Last":
        n = len(solids.kind)
        centres = np.einsum("kij,kj->ki", solids.rotation, solids.ball[:, :3]) + solids.middle
        none = np.zeros((n, 3))
        return _Last(centres, -solids.ball[:, 3], np.ones(n, bool), none, none.copy(), np.zeros(n, bool))


@compiled
def _meridians(solids: Solids) -> Array:
    """Radii (K, SAMPLES) [m] of lathes at even heights; 0 of others."""
    out = np.zeros((len(solids.kind), SAMPLES))
    for k in range(len(out)):
        if solids.kind[k] == LATHE:
            for j in range(SAMPLES):
                out[k, j] = profile(solids, k, j / (SAMPLES - 1) * solids.shape[k, 0])[0]
    return out


@compiled
def _approach(
    solids: Solids, last: _Last, meridians: Array, points: Array, smallest: float
) -> tuple[float, NDArray[np.bool_]]:
    """The smallest distance [m] of points (n, 3) and all before, and of which objects (K,) it must be asked otherwise."""
    untold = np.zeros(len(solids.kind), np.bool_)
    for k in range(len(solids.kind)):
        if _bound(solids, last, k, points) < smallest:
            least = distance = np.inf
            for i in range(len(points)):
                distance = _distance(solids, last, meridians, k, local(solids, k, row(points, i)))
                if not distance > 0:
                    untold[k] = True
                    break
                least = min(least, distance)
            put(last.at, k, row(points, len(points) - 1))
            last.least[k], last.centred[k] = distance, False
            if untold[k]:
                last.touched[k] = False
            else:
                smallest = min(smallest, least)
    return smallest, untold


@compiled
def _bound(solids: Solids, last: _Last, k: int, points: Array) -> float:
    """A lower bound [m] of the distances of points (n, 3) from object k."""
    low, high, ahead = np.inf, 0.0, np.inf
    for i in range(len(points)):
        away = plus(row(points, i), -1.0, row(last.at, k))
        low, high = min(low, dot(away, away)), max(high, dot(away, away))
        if last.touched[k]:
            y = local(solids, k, row(points, i))
            ahead = min(ahead, dot(plus(y, -1.0, row(last.foot, k)), row(last.normal, k)))
    bound = last.least[k] + (math.sqrt(low) if last.centred[k] else -(math.sqrt(high)))
    return max(bound, ahead) if last.touched[k] else bound


@compiled
def _distance(solids: Solids, last: _Last, meridians: Array, k: int, p: Vector) -> float:
    """Distance [m] of object k from a point outside, in its frame; else none, 0 or NaN."""
    if solids.kind[k] == OTHER:
        return np.nan
    if solids.kind[k] == BOX:
        return from_box(solids.shape[k], p)
    if solids.kind[k] == LATHE:
        return from_lathe(solids, k, meridians[k], p)
    foot, normal, distance = nearest(
        solids, k, row(last.foot, k) if last.touched[k] else radial(solids, k, p), p
    )
    put(last.foot, k, foot)
    put(last.normal, k, normal)
    last.touched[k] = True
    return distance
