"""Exact contact points of contours with planes through a moving camera, each by Newton from where it was before.

Limbs: level(r) = 0, n.(r - v) = 0 and e.(r - v) = 0 on the surface, as in `Surface.contour_points_in_planes`. Fixed curves:
e.(r(u) - v) = 0 along the polyline. What hides a point is found on samples of its line of sight: between two of them a
chord of a few millimetres can pass an object unseen, a fraction of a pixel inside its silhouette.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from extremal.estimator.camera import Array
from extremal.estimator.errors import SceneError
from extremal.scenes import Box, Lathe, Mesh, Scene, Surface
from extremal.tasks.level_sets import level_set
from extremal.tasks.section_rows import cross

ITERATIONS = 8
LONGEST_STEP = 0.01  # [m]
CONVERGED, ACCEPTED = (
    2e-7,
    1e-5,
)  # [m] last step of all, and of one point: the next would be its square over the radius of curvature
FARTHEST = 0.03  # [m] that a contact point moves between two looks
SAMPLES = 24  # along a line of sight, within the sphere around an object
MARGIN = 0.003  # [m] before a point within which nothing hides it
LEAST_DETERMINANT = 1e-12
_NEXT, _LAST = np.array([1, 2, 0]), np.array([2, 0, 1])


@dataclass(frozen=True, eq=False)
class FixedCurves:
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

    def at(self, u: Array, curve: NDArray[np.integer]) -> tuple[Array, Array, NDArray[np.integer]]:
        """Points and chords (n, 3) at u (n,), and the indices (n,) of the segments."""
        i = np.clip(u.astype(int), self.first[curve], self.last[curve] - 1)
        start = self.points[i]
        chord = self.points[i + 1] - start
        return start + (u - i)[:, None] * chord, chord, i

    def facing(self, i: NDArray[np.integer], ray: Array) -> NDArray[np.bool_]:
        """Whether a face beside samples i (n,) looks back along rays (n, 3)."""
        one, other = (np.vecdot(normals[i], ray) for normals in (self.normals, self.others))
        return (one < 0) | (other < 0)


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
        for surface in scene.objects:
            if isinstance(surface, Mesh):
                raise SceneError(
                    f"{surface.name!r} is a mesh; accepted: smooth surfaces and boxes (else: the rendered sensor)"
                )
        self.surfaces = scene.objects
        self.fixed = FixedCurves.of(scene)
        self.smooth = {
            k: SmoothSurface(s) for k, s in enumerate(self.surfaces) if not isinstance(s, Box)
        }  # by index
        self._boxes = Boxes([s for s in self.surfaces if isinstance(s, Box)])

    def advance(self, contacts: Contacts, centre: Array, planes: Array) -> Contacts:
        """The contacts as seen from a centre (3,), in planes through it with normals (n, 3)."""
        points, normals, there = contacts.points.copy(), contacts.normals.copy(), contacts.there.copy()
        u = contacts.u
        for k, smooth in self.smooth.items():
            rows = np.flatnonzero(contacts.surface == k)
            if len(rows):
                points[rows], n, ok = smooth.limb(points[rows], centre, planes[rows])
                there[rows], normals[rows] = ok, np.where(ok[:, None], n, normals[rows])
        rows = np.flatnonzero(contacts.curve >= 0)
        if len(rows):
            u = u.copy()
            u[rows], points[rows], normals[rows], there[rows] = self._on_curves(
                u[rows], contacts.curve[rows], centre, planes[rows]
            )
        return Contacts(points, normals, there, contacts.surface, contacts.curve, u)

    def _on_curves(
        self, u: Array, curve: NDArray[np.integer], centre: Array, planes: Array
    ) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
        fixed = self.fixed
        first, last, closed = fixed.first[curve], fixed.last[curve], fixed.closed[curve]
        error = np.zeros(len(u))
        for _ in range(ITERATIONS):
            at, chord, _ = fixed.at(u, curve)
            error = np.vecdot(planes, at - centre)
            if not np.max(np.abs(error), initial=0.0) > CONVERGED:
                break
            slope = np.vecdot(planes, chord)
            u = u - np.clip(error / np.where(np.abs(slope) > 1e-12, slope, 1e-12), -40, 40)
            u = np.where(closed, first + np.mod(u - first, last - first), np.clip(u, first, last))
        at, chord, i = fixed.at(u, curve)
        ray = at - centre
        normals = _unit(cross(ray, chord))
        there = (np.abs(error) < ACCEPTED) & fixed.facing(i, ray)
        return u, at, normals, there

    def hidden(self, centre: Array, points: Array) -> NDArray[np.bool_]:
        """Whether objects stand between a centre (3,) and points (n, 3)."""
        out = self._boxes.hide(centre, points)
        for smooth in self.smooth.values():
            out |= smooth.hides(centre, points)
        return out


class Boxes:
    """All boxes of a scene at once."""

    def __init__(self, boxes: list[Box]) -> None:
        self._rotation = np.array([box._rotation for box in boxes]).reshape(-1, 3, 3)
        self._middle = np.array([box.T_world_object.translation for box in boxes]).reshape(-1, 1, 3)
        self._half = np.array([box._half for box in boxes]).reshape(-1, 1, 3)

    def hide(self, centre: Array, points: Array) -> NDArray[np.bool_]:
        """Whether one of them stands between a centre (3,) and points (n, 3)."""
        c = (centre - self._middle) @ self._rotation
        d = (points - centre) @ self._rotation
        slow = np.where(np.abs(d) < 1e-15, 1e-15, d)  # within a face's plane
        one, other = (-self._half - c) / slow, (self._half - c) / slow
        enter = np.minimum(one, other).max(axis=2)
        leave = np.maximum(one, other).min(axis=2)
        first = np.where(enter > 0, enter, leave)
        end = 1 - MARGIN / np.sqrt(np.vecdot(d, d))
        return np.any((enter <= leave) & (leave > 0) & (first < end), axis=0)


class SmoothSurface:
    """A surface with limbs, by its level set in the object frame."""

    def __init__(self, surface: Surface) -> None:
        self._level = level_set(surface)
        self._rotation, self._middle = surface._rotation, surface.T_world_object.translation
        self._bounds = surface._bounds
        self._height = surface.profile.height if isinstance(surface, Lathe) else np.inf  # of a side, from 0

    def limb(self, start: Array, centre: Array, planes: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Points and outward normals (n, 3) of a limb near `start`, and where they were found on the surface."""
        c, p = self._local(centre), self._local(start)
        e = planes @ self._rotation
        before, rows, right = p, np.empty((3, *p.shape)), np.empty((3, len(p)))
        ray, size = p - c, np.zeros(len(p))
        g = turned = ray
        rows[2] = e
        for _ in range(ITERATIONS):
            right[0], g, turned = self._level.differential(p, ray)
            rows[0], rows[1] = g, g + turned
            right[1], right[2] = np.vecdot(g, ray), np.vecdot(e, ray)
            step = _solved(rows, right)
            size = np.sqrt(np.vecdot(step, step))
            farthest = np.max(size, initial=0.0)
            if farthest > LONGEST_STEP:
                step *= np.minimum(1.0, LONGEST_STEP / np.maximum(size, 1e-12))[:, None]
            p = p - step
            ray = p - c
            if not farthest > CONVERGED:
                break
        moved = p - before
        ok = (size < ACCEPTED) & (np.vecdot(moved, moved) < FARTHEST**2)
        ok &= np.vecdot(ray, turned) > 0  # concave along the ray: never seen
        if np.isfinite(self._height):
            ok &= (p[:, 2] > 0) & (p[:, 2] < self._height)
        p = np.where(ok[:, None], p, before)
        n = g - (np.vecdot(g, ray) / np.vecdot(ray, ray))[:, None] * ray  # a last step later
        return p @ self._rotation.T + self._middle, _unit(n @ self._rotation.T), ok

    def hides(self, centre: Array, points: Array) -> NDArray[np.bool_]:
        """Whether lines of sight (n) pass through, on samples within the sphere around the object."""
        c = self._local(centre)
        d = (points - centre) @ self._rotation
        middle, radius = self._bounds
        square = np.vecdot(d, d)
        along = d @ (middle - c) / square
        apart = (middle - c) @ (middle - c) - along**2 * square
        half = np.sqrt(np.maximum(radius**2 - apart, 0.0) / square)
        start = np.maximum(along - half, 0.0)
        end = np.minimum(along + half, 1 - MARGIN / np.sqrt(square))
        rows = np.flatnonzero((start < end) & (half > 0))
        out = np.zeros(len(points), bool)
        if len(rows):
            t = start[rows, None] + _PARTS * (end - start)[rows, None]
            out[rows] = self._level.inside(c + t[..., None] * d[rows, None]).any(axis=1)
        return out

    def _local(self, p: Array) -> Array:
        return (p - self._middle) @ self._rotation


_PARTS = (np.arange(SAMPLES) + 0.5) / SAMPLES


def _solved(rows: Array, right: Array) -> Array:
    """Solutions (n, 3) of small systems, equations first (3, n, 3), (3, n), by Cramer's rule: nearly singular ones give long
    steps, no error."""
    crossed = cross(rows[_NEXT], rows[_LAST])
    det = np.vecdot(rows[0], crossed[0])
    det = np.where(np.abs(det) > LEAST_DETERMINANT, det, LEAST_DETERMINANT)
    return np.sum(crossed * right[:, :, None], axis=0) / det[:, None]


def _unit(vectors: Array) -> Array:
    return vectors / np.sqrt(np.vecdot(vectors, vectors))[:, None]
