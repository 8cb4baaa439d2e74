"""Exact contact points of contours with planes through a moving camera, each by Newton from where it was before.

Limbs: level(r) = 0, n.(r - v) = 0 and e.(r - v) = 0 on the surface, as in `Surface.contour_points_in_planes`. Fixed curves:
e.(r(u) - v) = 0 along the polyline.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from extremal.estimator.camera import Array
from extremal.estimator.errors import SceneError
from extremal.scenes import Scene
from extremal.tasks.compiled import compiled
from extremal.tasks.level_sets import BOX, LATHE, OTHER, Solids, differential, local, world
from extremal.tasks.occlusion import hidden
from extremal.tasks.triples import Vector, crossed, dot, plus, put, row, times, turned, turned_back, unit

ITERATIONS = 8
LONGEST_STEP = 0.01  # [m]
CONVERGED, ACCEPTED = (
    1e-9,
    1e-5,
)  # [m] last step of Newton's method: the next would be its square over the radius of curvature
FARTHEST = 0.03  # [m] that a contact point moves between two looks
LEAST_DETERMINANT = 1e-12
FARTHEST_SAMPLES, LEAST_SLOPE = 40.0, 1e-12  # of a step along a fixed curve; [m] a sample


class FixedCurves(NamedTuple):
    """All creases and outlines of markings of a scene in one polyline of N points.

    points, normals, others: (N, 3); others are the second normals of creases, elsewhere the same. first, last: (C,) indices
    of the ends of the curves; closed: (C,).
    """

    points: Array
    normals: Array
    others: Array
    first: NDArray[np.integer]
    last: NDArray[np.integer]
    closed: NDArray[np.bool_]

    @staticmethod
    def of(scene: Scene) -> "FixedCurves":
        curves = [curve for surface in scene.objects for curve in surface.fixed_curves()]
        ends = np.cumsum([0, *(len(c.points) for c in curves)])
        none = np.zeros((0, 3))
        others = [c.normals if c.other_normals is None else c.other_normals for c in curves]
        closed = [bool(np.linalg.norm(c.points[0] - c.points[-1]) < 1e-9) for c in curves]
        return FixedCurves(
            np.concatenate([none, *(c.points for c in curves)]),
            np.concatenate([none, *(c.normals for c in curves)]),
            np.concatenate([none, *others]),
            ends[:-1],
            ends[1:] - 1,
            np.array(closed, bool),
        )


@dataclass(frozen=True, eq=False)
class Contacts:
    """n contact points: of limbs first, surface by surface, then of fixed curves.

    Attributes:
        points: (n, 3) [m]. normals: (n, 3) unit normals of the tangent planes, of limbs out of the object.
        there: (n,) whether the object has the point and turns it to the camera; what hides it is not looked at.
        surface: (n,) index of the surface; curve: (n,) of the fixed curve, -1 on limbs; u: (n,) place on that.
    """

    points: Array
    normals: Array
    there: NDArray[np.bool_]
    surface: NDArray[np.integer]
    curve: NDArray[np.integer]
    u: Array

    def __len__(self) -> int:
        return len(self.u)


class EdgeGeometry:
    """The surfaces and fixed curves of a scene."""

    def __init__(self, scene: Scene) -> None:
        """Raises SceneError for a scene with a mesh: its contour generators are no smooth curves."""
        self.surfaces, self.solids = scene.objects, Solids.of(scene.objects)
        for surface, kind in zip(self.surfaces, self.solids.kind, strict=True):
            if kind == OTHER:
                raise SceneError(
                    f"{surface.name!r} is a {type(surface).__name__.lower()}; accepted: smooth surfaces and boxes "
                    "(else: the rendered sensor)"
                )
        self.fixed = FixedCurves.of(scene)
        self.smooth = np.flatnonzero(self.solids.kind != BOX)  # indices of surfaces

    def advance(self, contacts: Contacts, centre: Array, planes: Array) -> Contacts:
        """The contacts as seen from a centre (3,), in planes through it with normals (n, 3)."""
        points, normals, there, u = advanced(
            self.solids, self.fixed, contacts.points, contacts.normals, contacts.surface, contacts.curve, contacts.u,
            tuple(centre.tolist()), np.ascontiguousarray(planes),
        )  # fmt: skip
        return Contacts(points, normals, there, contacts.surface, contacts.curve, u)

    def limbs(self, k: int, start: Array, centre: Array, planes: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Points (n, 3) near `start` where the limb of surface k seen from a centre (3,) meets planes, and where there are any."""
        n = len(start)
        points, _, ok, _ = advanced(
            self.solids, self.fixed, start, start, np.full(n, k), np.full(n, -1), np.zeros(n), tuple(centre.tolist()), planes
        )  # fmt: skip
        return points, ok

    def hidden(self, centre: Array, points: Array) -> NDArray[np.bool_]:
        """Whether objects stand between a centre (3,) and points (n, 3)."""
        return hidden(self.solids, tuple(centre.tolist()), points)


@compiled
def advanced(
    solids: Solids,
    curves: FixedCurves,
    points: Array,
    normals: Array,
    surface: NDArray[np.integer],
    curve: NDArray[np.integer],
    u: Array,
    centre: Vector,
    planes: Array,
) -> tuple[Array, Array, NDArray[np.bool_], Array]:
    """Points, normals (n, 3), there and u (n,) of contacts in planes with normals (n, 3) through a centre [m]."""
    n = len(u)
    points, normals, u, there = points.copy(), normals.copy(), u.copy(), np.zeros(n, np.bool_)
    for i in range(n):
        plane = row(planes, i)
        if curve[i] >= 0:
            u[i], at, normal, there[i] = _on_curve(curves, curve[i], u[i], centre, plane)
        else:
            at, normal, there[i] = _on_limb(solids, surface[i], row(points, i), centre, plane)
        put(points, i, at)
        if there[i] or curve[i] >= 0:
            put(normals, i, normal)
    return points, normals, there, u


@compiled
def _on_limb(
    solids: Solids, k: int, start: Vector, centre: Vector, plane: Vector
) -> tuple[Vector, Vector, bool]:
    """Point near `start` and outward normal of the limb of surface k in a plane, and whether it was found on the surface.

    With ray d = r - v, differential of n.d is (n + H d), of e.d it is e: three equations for a step.
    """
    c, p = local(solids, k, centre), local(solids, k, start)
    e = turned_back(solids.rotation[k], plane)
    before, ray, size = p, plus(p, -1.0, c), 0.0
    g = turn = ray
    for _ in range(ITERATIONS):
        F, g, turn = differential(solids, k, p, ray)
        step = _solved((g, plus(g, 1.0, turn), e), (F, dot(g, ray), dot(e, ray)))
        size = math.sqrt(dot(step, step))
        p = plus(p, -min(1.0, LONGEST_STEP / max(size, LEAST_DETERMINANT)), step)
        ray = plus(p, -1.0, c)
        if not size > CONVERGED:
            break
    moved = plus(p, -1.0, before)
    ok = size < ACCEPTED and dot(moved, moved) < FARTHEST**2
    ok = ok and dot(ray, turn) > 0  # concave along the ray: never seen
    if solids.kind[k] == LATHE:
        ok = ok and 0 < p[2] < solids.shape[k, 0]
    if not ok:
        return start, plane, False
    normal = plus(g, -dot(g, ray) / dot(ray, ray), ray)  # a last step later
    return world(solids, k, p), unit(turned(solids.rotation[k], normal)), True


@compiled
def _solved(rows: tuple[Vector, Vector, Vector], right: Vector) -> Vector:
    """Solution of three equations by Cramer's rule: nearly singular ones give long steps, no error."""
    first, second, third = crossed(rows[1], rows[2]), crossed(rows[2], rows[0]), crossed(rows[0], rows[1])
    det = dot(rows[0], first)
    if not abs(det) > LEAST_DETERMINANT:
        det = LEAST_DETERMINANT
    return times(1 / det, plus(plus(times(right[0], first), right[1], second), right[2], third))


@compiled
def _on_curve(
    curves: FixedCurves, curve: int, u: float, centre: Vector, plane: Vector
) -> tuple[float, Vector, Vector, bool]:
    """u, point and normal of the tangent plane where a fixed curve meets a plane, and whether a face beside it looks back."""
    first, last = float(curves.first[curve]), float(curves.last[curve])
    error, (at, chord) = 0.0, _on_polyline(curves, curve, u)
    for _ in range(ITERATIONS):
        error = dot(plane, plus(at, -1.0, centre))
        if not abs(error) > CONVERGED:
            break
        slope = dot(plane, chord)
        if not abs(slope) > LEAST_SLOPE:
            slope = LEAST_SLOPE
        u -= min(max(error / slope, -FARTHEST_SAMPLES), FARTHEST_SAMPLES)
        u = first + (u - first) % (last - first) if curves.closed[curve] else min(max(u, first), last)
        at, chord = _on_polyline(curves, curve, u)
    ray = plus(at, -1.0, centre)
    there = abs(error) < ACCEPTED and _faces(curves, _segment(curves, curve, u), ray)
    return u, at, unit(crossed(ray, chord)), there


@compiled
def _segment(curves: FixedCurves, curve: int, u: float) -> int:
    return min(max(int(u), curves.first[curve]), curves.last[curve] - 1)


@compiled
def _on_polyline(curves: FixedCurves, curve: int, u: float) -> tuple[Vector, Vector]:
    """Point of a curve at u, and the chord there."""
    i = _segment(curves, curve, u)
    start = row(curves.points, i)
    chord = plus(row(curves.points, i + 1), -1.0, start)
    return plus(start, u - i, chord), chord


@compiled
def _faces(curves: FixedCurves, i: int, ray: Vector) -> bool:
    """Whether a face beside sample i looks back along a ray."""
    return dot(row(curves.normals, i), ray) < 0 or dot(row(curves.others, i), ray) < 0


@compiled
def sampled_curves(
    curves: FixedCurves, every: int, centre: Vector, forward: Vector, cosine: float
) -> tuple[Array, NDArray[np.integer], Array, Array, NDArray[np.bool_]]:
    """Samples of fixed curves, n in all: u (n,), curves (n,), points (n, 3), normals of tangent planes (n, 3) through a centre [m],
    and whether (n,) they lie in the cone about a unit vector `forward` and a face beside them looks back; zero where not."""
    n = (len(curves.points) + every - 1) // every
    u, curve, ok = np.empty(n), np.zeros(n, np.int64), np.empty(n, np.bool_)
    points, normals = np.zeros((n, 3)), np.zeros((n, 3))
    c = 0
    for j in range(n):
        while j * every > curves.last[c]:
            c += 1
        i = j * every
        u[j], curve[j], point = i, c, row(curves.points, i)
        ray = plus(point, -1.0, centre)
        i = min(i, curves.last[c] - 1)
        ok[j] = dot(ray, forward) > cosine * math.sqrt(dot(ray, ray)) and _faces(curves, i, ray)
        if ok[j]:
            put(points, j, point)
            chord = plus(row(curves.points, i + 1), -1.0, row(curves.points, i))
            put(normals, j, unit(crossed(ray, chord)))
    return u, curve, points, normals, ok


@compiled
def limb_normals(solids: Solids, k: int, points: Array, centre: Vector) -> tuple[Array, NDArray[np.bool_]]:
    """Outward normals (n, 3) at points of a limb (n, 3) of surface k, and whether (n,) it is convex along the rays from a centre [m]."""
    normals, ok = np.empty(points.shape), np.empty(len(points), np.bool_)
    c = local(solids, k, centre)
    for i in range(len(points)):
        p = local(solids, k, row(points, i))
        ray = plus(p, -1.0, c)
        _, g, turn = differential(solids, k, p, ray)
        put(normals, i, unit(turned(solids.rotation[k], g)))
        ok[i] = dot(ray, turn) > 0
    return normals, ok
