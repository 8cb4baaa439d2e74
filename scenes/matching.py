"""What is true of tracked image points: the nearest true edge, met in the point's own epipolar plane."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree  # pyright: ignore[reportAttributeAccessIssue]

from extremal.estimator.errors import SceneError
from extremal.scenes.curves import Array, SurfaceCurve
from extremal.scenes.surface import Surface

ALIKE = np.cos(np.radians(25.0))  # orientations of a point and its true edge agree within 25 degrees
PARALLEL = np.cos(np.radians(8.0))  # closer to its epipolar plane, an edge has no definite point in it
BEYOND = 1.5e-3  # [rad] that a point may lie beyond the end of an edge


@dataclass(frozen=True, eq=False)
class Truth:
    """Truth of N tracked image points; rows that match nothing hold NaN and "".

    Attributes:
        matched: (N,) bool.
        kind: (N,) "extremal", "crease", "marking" or "".
        object, curve: (N,) names.
        point: (N, 3) on the true curve and in the point's epipolar plane [m], world.
        normal: (N, 3) outward surface normals there.
        radius: (N,) radius of curvature [m] of the section by the epipolar plane; 0 for fixed features.
        gaussian_curvature: (N,) [1/m^2]; NaN for fixed features.
        distance: (N,) angle [rad] from the ray to the true edge, perpendicular to the edge.
    """

    matched: NDArray[np.bool_]
    kind: NDArray[np.str_]
    object: NDArray[np.str_]
    curve: NDArray[np.str_]
    point: Array
    normal: Array
    radius: Array
    gaussian_curvature: Array
    distance: Array


def match(
    objects: Sequence[Surface],
    curves: Sequence[SurfaceCurve],
    centre: Array,
    rays: ArrayLike,
    tangent_planes: ArrayLike,
    epipolar_normals: ArrayLike,
    tolerance: float,
) -> Truth:
    """Match image points with visible true edges; see `Scene.truth`."""
    rays, tangent_planes, epipolar_normals = (
        _directions(name, value)
        for name, value in (
            ("rays", rays),
            ("tangent_planes", tangent_planes),
            ("epipolar_normals", epipolar_normals),
        )
    )
    n = len(rays)
    best = np.full(n, -1)
    sample = np.zeros(n, int)
    distance = np.full(n, np.inf)
    for i, curve in enumerate(curves):
        if not curve.visible.any():
            continue
        near, where, across = _candidates(curve, centre, rays, tangent_planes, tolerance)
        closer = across < distance[near]
        near, where, across = near[closer], where[closer], across[closer]
        best[near], sample[near], distance[near] = i, where, across
    truth = _empty(n)
    surfaces = {surface.name: surface for surface in objects}
    for i in np.unique(best[best >= 0]):
        rows = best == i
        surface = surfaces[curves[i].object]
        _fill(truth, rows, surface, curves[i], centre, rays[rows], epipolar_normals[rows], sample[rows])
    return truth


def _directions(name: str, values: ArrayLike) -> Array:
    """Unit vectors (N, 3) along `values`."""
    v = np.asarray(values, float)
    if v.ndim != 2 or v.shape[1] != 3 or not np.all(np.isfinite(v)):
        raise SceneError(f"{name} has shape {v.shape}; accepted: finite numbers (N, 3)")
    length = np.linalg.norm(v, axis=1, keepdims=True)
    if not np.all(length > 0):
        raise SceneError(f"{name} holds a zero vector")
    return v / length


def _image(curve: SurfaceCurve, centre: Array) -> tuple[Array, Array]:
    """Unit rays (N, 3) to a curve's points, and unit normals (N, 3) of its tangent planes through the centre.

    For an extremal boundary that plane is the surface's own; for a polyline it holds the chord between
    the two neighbours.
    """
    ray = curve.points - centre
    ray = ray / np.linalg.norm(ray, axis=1, keepdims=True)
    if curve.kind == "extremal":
        return ray, curve.normals
    ahead, behind = np.roll(ray, -1, axis=0), np.roll(ray, 1, axis=0)
    ahead[-1], behind[0] = ray[-1], ray[0]
    plane = np.cross(ray, ahead - behind)
    return ray, plane / np.maximum(np.linalg.norm(plane, axis=1, keepdims=True), 1e-300)


def _candidates(
    curve: SurfaceCurve, centre: Array, rays: Array, tangent_planes: Array, tolerance: float
) -> tuple[NDArray[np.integer], NDArray[np.integer], Array]:
    """Points that may lie on a curve: their rows, nearest samples, and distances [rad] across the curve."""
    image, planes = _image(curve, centre)
    seen = np.nonzero(curve.visible)[0]
    apart, nearest = cKDTree(image[seen]).query(rays, distance_upper_bound=np.hypot(tolerance, BEYOND))
    rows = np.nonzero(np.isfinite(apart))[0]
    where = seen[nearest[rows]]
    across = np.abs(np.arcsin(np.clip(np.sum(planes[where] * rays[rows], axis=1), -1, 1)))
    along = np.sqrt(np.maximum(apart[rows] ** 2 - across**2, 0))
    alike = np.abs(np.sum(planes[where] * tangent_planes[rows], axis=1)) >= ALIKE
    good = alike & (across <= tolerance) & (along <= BEYOND)
    return rows[good], where[good], across[good]


def _empty(n: int) -> Truth:
    def text() -> NDArray[np.str_]:
        return np.full(n, "", dtype="U250")

    def numbers(*shape: int) -> Array:
        return np.full((n, *shape), np.nan)

    matched = np.zeros(n, bool)
    return Truth(matched, text(), text(), text(), numbers(3), numbers(3), numbers(), numbers(), numbers())


def _fill(
    truth: Truth,
    rows: NDArray[np.bool_],
    surface: Surface,
    curve: SurfaceCurve,
    centre: Array,
    rays: Array,
    epipolar: Array,
    sample: NDArray[np.integer],
) -> None:
    """Write the truth of the points `rows` that lie on one curve, refined into their epipolar planes."""
    planes = _image(curve, centre)[1][sample]
    across = np.cross(planes, rays)
    # Where the edge runs along the epipolar plane: the nearest point, in the plane across the edge.
    parallel = np.abs(np.sum(planes * epipolar, axis=1)) > PARALLEL
    cut = np.where(parallel[:, None], across, epipolar)
    point, segment = _met(surface, curve, centre, cut, sample)
    foot, _ = _met(surface, curve, centre, across, sample)
    if curve.kind == "extremal":
        normal = surface.normals(point)
        truth.radius[rows] = np.abs(surface.section_radius(point, epipolar))
        truth.gaussian_curvature[rows] = surface.gaussian_curvature(point)
    else:
        normal = _facing_normals(curve, centre, point, segment)
        truth.radius[rows] = 0.0
    truth.matched[rows] = True
    truth.kind[rows], truth.object[rows], truth.curve[rows] = curve.kind, curve.object, curve.name
    truth.point[rows], truth.normal[rows] = point, normal
    sine = np.linalg.norm(np.cross(foot - centre, rays), axis=1)
    truth.distance[rows] = np.arctan2(sine, np.sum((foot - centre) * rays, axis=1))


def _met(
    surface: Surface, curve: SurfaceCurve, centre: Array, cut: Array, sample: NDArray[np.integer]
) -> tuple[Array, NDArray[np.integer]]:
    """Points (N, 3) of a true curve in planes through the centre, near given samples, and their segments."""
    cut = cut / np.linalg.norm(cut, axis=1, keepdims=True)
    point, segment = _crossing(curve, centre, cut, sample)
    if curve.kind == "extremal":
        exact = surface.contour_points_in_planes(point, centre, cut)
        # Newton may leave for another branch where the curve ends in a cusp: stay with the polyline there.
        stays = np.linalg.norm(exact - point, axis=1) < 2e-3
        point = np.where(stays[:, None], exact, point)
    return point, segment


def _crossing(
    curve: SurfaceCurve, centre: Array, cut: Array, sample: NDArray[np.integer]
) -> tuple[Array, NDArray[np.integer]]:
    """Where the polyline crosses planes through the centre nearest to given samples: points and segments.

    Beyond the ends of an open curve its first or last segment is extended.
    """
    last = len(curve.points) - 1
    closed = bool(np.linalg.norm(curve.points[0] - curve.points[-1]) < 1e-9)
    reach = 40
    starts = sample[:, None] + np.arange(-reach, reach)
    starts = np.mod(starts, last) if closed else np.clip(starts, 0, last - 1)
    relative = curve.points - centre
    a = np.einsum("nki,ni->nk", relative[starts], cut)
    b = np.einsum("nki,ni->nk", relative[starts + 1], cut)
    with np.errstate(divide="ignore", invalid="ignore"):
        weight = a / (a - b)
    # How far outside its own segment the crossing lies; ties go to the segment nearest to the sample.
    outside = np.maximum(np.maximum(-weight, weight - 1), 0)
    outside = np.where(np.isfinite(outside), outside, np.inf)
    penalty = np.where(outside < 1e-9, 0, 1e3 + outside) + np.abs(np.arange(-reach, reach) + 0.5) * 1e-3
    pick = np.argmin(penalty, axis=1)
    rows = np.arange(len(sample))
    segment, w = starts[rows, pick], weight[rows, pick]
    w = np.where(np.isfinite(w), np.clip(w, -5, 6), 0.0)[:, None]
    return curve.points[segment] * (1 - w) + curve.points[segment + 1] * w, segment


def _facing_normals(curve: SurfaceCurve, centre: Array, point: Array, segment: NDArray[np.integer]) -> Array:
    """Normals (N, 3) of a face next to the curve, of one that looks at the camera where there is a choice."""
    normal = curve.normals[segment]
    if curve.other_normals is None:
        return normal
    hidden = np.sum(normal * (point - centre), axis=1) > 0
    return np.where(hidden[:, None], curve.other_normals[segment], normal)
