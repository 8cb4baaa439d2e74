"""Exact contact points of contours with planes through a moving camera, each by Newton from where it was before.

Limbs: level(r) = 0, n.(r - v) = 0 and e.(r - v) = 0 on the surface, as in `Surface.contour_points_in_planes`. Fixed curves:
e.(r(u) - v) = 0 along the polyline. What hides a point is found on samples of its line of sight: between two of them a
chord of a few millimetres can pass an object unseen, a fraction of a pixel inside its silhouette.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from extremal.estimator.camera import Array
from extremal.estimator.errors import SceneError
from extremal.scenes import Box, Lathe, Mesh, Scene, Surface

ITERATIONS = 8
LONGEST_STEP = 0.01  # [m]
CONVERGED = 2e-6  # [m] last step: the next would be its square over the radius of curvature
FARTHEST = 0.03  # [m] that a contact point moves between two looks
SAMPLES = 24  # along a line of sight, within the sphere around an object
MARGIN = 0.003  # [m] before a point within which nothing hides it


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
        one, other = (np.einsum("nk,nk->n", normals[i], ray) for normals in (self.normals, self.others))
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

    def advance(self, contacts: Contacts, centre: Array, planes: Array) -> Contacts:
        """The contacts as seen from a centre (3,), in planes through it with normals (n, 3)."""
        points, normals, there = contacts.points.copy(), contacts.normals.copy(), contacts.there.copy()
        u, limb = contacts.u, contacts.curve < 0
        for k in np.unique(contacts.surface[limb]):
            rows = np.flatnonzero(limb & (contacts.surface == k))
            found, n, ok = _limb(self.surfaces[k], points[rows], centre, planes[rows])
            points[rows], there[rows] = found, ok
            normals[rows] = np.where(ok[:, None], n, normals[rows])
        rows = np.flatnonzero(~limb)
        if len(rows):
            u = u.copy()
            u[rows], points[rows], normals[rows], there[rows] = self._on_curves(
                u[rows], contacts.curve[rows], centre, planes[rows]
            )
        return replace(contacts, points=points, normals=normals, there=there, u=u)

    def _on_curves(
        self, u: Array, curve: NDArray[np.integer], centre: Array, planes: Array
    ) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
        fixed = self.fixed
        first, last, closed = fixed.first[curve], fixed.last[curve], fixed.closed[curve]
        error = np.zeros(len(u))
        for _ in range(ITERATIONS):
            at, chord, _ = fixed.at(u, curve)
            error = np.einsum("nk,nk->n", planes, at - centre)
            if not np.max(np.abs(error), initial=0.0) > CONVERGED / 10:
                break
            slope = np.einsum("nk,nk->n", planes, chord)
            u = u - np.clip(error / np.where(np.abs(slope) > 1e-12, slope, 1e-12), -40, 40)
            u = np.where(closed, first + np.mod(u - first, last - first), np.clip(u, first, last))
        at, chord, i = fixed.at(u, curve)
        ray = at - centre
        normals = _unit(_cross(ray, chord))
        there = (np.abs(error) < 5 * CONVERGED) & fixed.facing(i, ray)
        return u, at, normals, there

    def hidden(self, centre: Array, points: Array) -> NDArray[np.bool_]:
        """Whether objects stand between a centre (3,) and points (n, 3)."""
        out = np.zeros(len(points), bool)
        for surface in self.surfaces:
            out |= _behind(surface, centre, points)
        return out


def _limb(
    surface: Surface, start: Array, centre: Array, planes: Array
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Points and outward normals (n, 3) of a limb near `start`, and where they were found on the surface."""
    c, p, e = surface._local(centre), surface._local(start), planes @ surface._rotation
    n, S, step, before = p, np.zeros((len(p), 3, 3)), p, p
    for _ in range(ITERATIONS):
        n, S = surface._frame(p)
        ray = p - c
        rows = np.stack([n, n + np.einsum("nij,nj->ni", S, ray), e], axis=1)
        residual = np.einsum("nij,nj->ni", np.stack([n, n, e], axis=1), ray)
        residual[:, 0] = surface._level(p)
        step = _solved(rows, residual)
        length = np.sqrt(np.einsum("ni,ni->n", step, step))
        step *= np.minimum(1.0, LONGEST_STEP / np.maximum(length, 1e-12))[:, None]
        p = p - step
        if not np.max(length, initial=0.0) > CONVERGED:
            break
    moved = np.einsum("nij,nj->ni", S, step)
    n = _unit(n - moved)
    ray = p - c
    ok = (np.einsum("ni,ni->n", step, step) < (5 * CONVERGED) ** 2) & (
        np.einsum("ni,ni->n", p - before, p - before) < FARTHEST**2
    )
    ok &= np.einsum("ni,nij,nj->n", ray, S, ray) > 0  # concave along the ray: never seen
    if isinstance(surface, Lathe):
        ok &= (p[:, 2] > 0) & (p[:, 2] < surface.profile.height)
    p = np.where(ok[:, None], p, before)
    return surface._world(p), n @ surface._rotation.T, ok


def _behind(surface: Surface, centre: Array, points: Array) -> NDArray[np.bool_]:
    """Whether lines of sight (n) pass through a surface, on samples within the sphere around it."""
    c, d = surface._local(centre), surface._local(points) - surface._local(centre)
    if isinstance(surface, Box):  # may be thin
        t = surface._intersect(np.broadcast_to(c, d.shape), d)
        return t < 1 - MARGIN / np.sqrt(np.einsum("ni,ni->n", d, d))
    middle, radius = surface._bounds
    square = np.einsum("ni,ni->n", d, d)
    along = d @ (middle - c) / square
    apart = (middle - c) @ (middle - c) - along**2 * square
    half = np.sqrt(np.maximum(radius**2 - apart, 0.0) / square)
    start = np.maximum(along - half, 0.0)
    end = np.minimum(along + half, 1 - MARGIN / np.sqrt(square))
    rows = np.flatnonzero((start < end) & (half > 0))
    out = np.zeros(len(points), bool)
    if len(rows):
        part = (np.arange(SAMPLES) + 0.5) / SAMPLES
        t = start[rows, None] + part * (end - start)[rows, None]
        out[rows] = _inside(surface, c + t[..., None] * d[rows, None]).any(axis=1)
    return out


def _inside(surface: Surface, p: Array) -> NDArray[np.bool_]:
    """Whether points (..., 3) of the object frame lie within the surface."""
    if isinstance(surface, Lathe):
        z, profile = p[..., 2], surface.profile
        r = profile.spline(np.clip(z, 0.0, profile.height))
        return (np.einsum("...i,...i", p[..., :2], p[..., :2]) < r * r) & (z > 0) & (z < profile.height)
    return surface._level(p) < 0


def _solved(rows: Array, right: Array) -> Array:
    """Solutions (n, 3) of small systems (n, 3, 3) by Cramer's rule: nearly singular ones give long steps, no error."""
    a, b, c = rows[:, 0], rows[:, 1], rows[:, 2]
    bc, ca, ab = _cross(b, c), _cross(c, a), _cross(a, b)
    det = np.einsum("ni,ni->n", a, bc)
    total = right[:, :1] * bc + right[:, 1:2] * ca + right[:, 2:] * ab
    return total / np.where(np.abs(det) > 1e-12, det, 1e-12)[:, None]


def _cross(a: Array, b: Array) -> Array:
    """a x b (n, 3), several times as fast as numpy's for few rows."""
    return a[:, [1, 2, 0]] * b[:, [2, 0, 1]] - a[:, [2, 0, 1]] * b[:, [1, 2, 0]]


def _unit(vectors: Array) -> Array:
    return vectors / np.sqrt(np.einsum("ni,ni->n", vectors, vectors))[:, None]
