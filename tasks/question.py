"""Which contour is asked about, as far as the robot knows, and what tracked features say of it.

Features are tracked here and there along a contour. What is asked is where the contour crosses one plane, so that contact point
and radius are interpolated along it; the features' own errors are much alike, those of the poses.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from extremal.estimator.camera import Array, Camera
from extremal.tasks.answers import Answer, contact_from, probability_extremal
from extremal.tasks.compiled import compiled
from extremal.tasks.rigid import place
from extremal.tasks.triples import plus, row, turned_back

LEVEL, SIDE = (
    45.0,
    14.0,
)  # [px] from where it is asked, along and across, of features that belong to a contour
ALIKE = 4.0  # [px] across, within which the best known of contours is taken
ALONG = 0.4  # sine of the angle between a contour and its chords, at most
REACH = 0.06  # [m] from the plane of the question, of features that are interpolated
POORLY = 3.0  # times the least sigma of those: features that are known less well add nothing but their errors
BEYOND = 0.01  # [m] from the plane, within which features of one side alone are extrapolated
LEAST_LOOKS = 5
STEEP = 0.5  # sine of the angle to the plane, from which on a contour is followed to it
UNKNOWN = 1.0  # [m] sigma from which nothing is known
NEAREST = 0.01  # [m] before the camera, of what it sees
SLID = 0.03  # [m] sigma of R from which contacts are moved over the surface
AHEAD = 0.55  # [m] of the fixation point from where the question is asked, about
# what a circle leaves of a section, and a parabola of a contour: share of R, and [m]
ROUND, LEAST_SIGMA = 0.02, 3e-4
Numbers = NDArray[np.integer] | NDArray[np.floating]


@dataclass(frozen=True, eq=False)
class Tracked:
    """What is taken for known of n features.

    Attributes:
        position, normal: (n, 3) [m] and unit vectors; contour: (n,) number; looks: (n,) how many.
        radius, sigma: (n,) [m] of the sections, about the normals.
    """

    position: Array
    normal: Array
    contour: Numbers
    looks: Numbers
    radius: Array
    sigma: Array


@dataclass(frozen=True, eq=False)
class Question:
    """The contour at one pixel of the first view.

    Attributes:
        camera: of the views.
        first: T_world_camera of the first view, as it is believed to be.
        query: (2,) pixel.
    """

    camera: Camera
    first: RigidTransform
    query: Array

    def belongs(self, seen: Tracked) -> NDArray[np.bool_]:
        """Which of n features lie on the contour: near the pixel, as the first view sees them."""
        off, across = self._in_first_view(seen)
        return _apart(off, across) < SIDE

    def _in_first_view(self, seen: Tracked) -> tuple[Array, Array]:
        """Where the first view sees n features, from the pixel, (n, 2) [px], infinite where it doesn't; and unit vectors (n, 2)
        across their contours."""
        ideal, across = _seen_first(
            self._pose,
            np.ascontiguousarray(seen.position, float),
            np.ascontiguousarray(seen.normal, float),
            seen.radius,
            seen.sigma,
            seen.looks >= LEAST_LOOKS,
        )
        return _off(self.camera.distort(ideal), self.query), across

    @cached_property
    def _pose(self) -> Array:
        return self.first.as_matrix()

    def plane(self, eye: Array) -> Array:
        """Unit normal (3,) of the plane of the question seen from `eye` (3,): through the fixation point, level across."""
        forward = self.first.rotation.apply([0.0, 0.0, 1.0])
        right = _unit(np.cross(forward, [0.0, 0.0, 1.0]))
        ray = self.first.rotation.apply(self.camera.rays(self.query))
        ahead = AHEAD * _unit(ray - (ray @ right) * right) + self.first.translation - eye
        return _unit(np.cross(np.cross(ahead, [0.0, 0.0, 1.0]), ahead))

    def answer(self, eye: Array, seen: Tracked) -> Answer | None:
        """What n features say, seen from `eye` (3,) [m]; None where none belongs to the contour."""
        rows = self._chosen(seen)
        if rows is None:
            return None
        up = self.plane(eye)
        height = (seen.position[rows] - eye) @ up
        sigma = seen.sigma[rows]
        least = np.min(sigma, where=np.abs(height) < REACH, initial=np.inf)
        rows, height = rows[sigma < POORLY * least], height[sigma < POORLY * least]
        weight = interpolating(height)
        side = np.where(seen.normal[rows] @ seen.normal[rows[np.argmax(np.abs(weight))]] < 0, -1.0, 1.0)
        R = float(weight @ (side * seen.radius[rows]))
        normal = np.sign(R or 1.0) * (weight @ (side[:, None] * seen.normal[rows]))
        in_plane = normal - (normal @ up) * up
        point = _along(weight @ seen.position[rows], normal, eye, up)
        place = contact_from(tuple(eye.tolist()), point[None], in_plane[None], np.array([abs(R)]))[0]
        # errors of poses are alike in all features, others are each one's own: the greater sum is near the truth
        each = weight * seen.sigma[rows]
        spread = math.sqrt(max(each.sum() ** 2, each @ each) + (ROUND * R) ** 2 + LEAST_SIGMA**2)
        return Answer(probability_extremal(abs(R), spread), abs(R), spread, place)

    def _chosen(self, seen: Tracked) -> NDArray[np.integer] | None:
        """Features of the contour that is nearest to the pixel, or of the best known of those that are hardly farther."""
        known = (seen.sigma < UNKNOWN) & np.isfinite(seen.radius) & (seen.looks >= LEAST_LOOKS)
        off, across = self._in_first_view(seen)
        apart = np.where(known, _apart(off, across), np.inf)
        if not np.any(apart < SIDE):
            return None
        near = np.flatnonzero(apart < min(apart.min() + ALIKE, SIDE))
        best = near[np.argmin(seen.sigma[near])]
        same = np.flatnonzero(known & (seen.contour == seen.contour[best]) & np.all(np.isfinite(off), axis=1))
        # one outline of a closed contour: the chord between two features runs along it at both
        chord = off[same] - off[best]
        length = np.linalg.norm(chord, axis=1)
        turned = np.maximum(np.abs(np.einsum("ni,ni->n", chord, across[same])), np.abs(chord @ across[best]))
        return same[turned <= ALONG * length]


@compiled
def _seen_first(
    pose: Array, position: Array, normal: Array, radius: Array, sigma: Array, enough: NDArray[np.bool_]
) -> tuple[Array, Array]:
    """Contact points as a first view from `pose` (4, 4) has them, ideal image coordinates (n, 2), NaN behind it and where there are
    not `enough` looks (n,); and unit vectors (n, 2) across their contours."""
    eye, n = place(pose), len(radius)
    known, ideal, across = np.zeros(n), np.full((n, 2), np.nan), np.empty((n, 2))
    for i in range(n):
        if sigma[i] < SLID:
            known[i] = radius[i]
    there = contact_from(eye, position, normal, known)
    for i in range(n):
        x, y, z = turned_back(pose, plus(row(there, i), -1.0, eye))
        if z > NEAREST and enough[i]:
            ideal[i, 0], ideal[i, 1] = x / z, y / z
        x, y, _ = turned_back(pose, row(normal, i))
        length = max(math.sqrt(x * x + y * y), 1e-9)
        across[i, 0], across[i, 1] = x / length, y / length
    return ideal, across


@compiled
def _off(pixels: Array, query: Array) -> Array:
    """Pixels (n, 2) from one (2,); infinite where they are no numbers."""
    off = np.empty(pixels.shape)
    for i in range(len(pixels)):
        for j in range(2):
            off[i, j] = np.inf if math.isnan(pixels[i, j]) else pixels[i, j] - query[j]
    return off


@compiled
def _apart(off: Array, across: Array) -> Array:
    """Distances (n,) [px] of the pixel from the contours; infinite from features too far along them."""
    out = np.full(len(off), np.inf)
    for i in range(len(off)):
        if abs(off[i, 1]) < LEVEL:
            out[i] = abs(off[i, 0] * across[i, 0] + off[i, 1] * across[i, 1])
    return out


def interpolating(height: Array) -> Array:
    """Weights (n,) of values at `height` (n,) [m] that give the value at 0, by a parabola through the two nearest on either side;
    from one side alone a line, if they are near, or the nearest."""
    order = np.argsort(np.abs(height))
    order = order[(np.abs(height[order]) < REACH) | (np.arange(len(order)) == 0)]
    below, above = order[height[order] <= 0][:2], order[height[order] > 0][:2]
    use = np.concatenate([below, above])
    if min(len(below), len(above)) == 0:
        use = use[: 2 if np.abs(height[use[0]]) < BEYOND else 1]
    weight = np.zeros(len(height))
    powers = np.vander(height[use] / REACH, min(3, len(use)), increasing=True)
    weight[use] = np.linalg.pinv(powers)[0]
    return weight


def _along(point: Array, normal: Array, eye: Array, up: Array) -> Array:
    """Where a contour that passes a point (3,) meets the plane through the eye (3,) with normal `up` (3,), if it goes on across the ray."""
    along = _unit(np.cross(normal, point - eye))
    climb = float(along @ up)
    return point if abs(climb) < STEEP else point - (point - eye) @ up / climb * along


def _unit(v: Array) -> Array:
    return v / max(float(np.linalg.norm(v)), 1e-12)
