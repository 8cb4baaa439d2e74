"""Matching along epipolar lines: where the contours of a view cross the epipolar planes of tracked points."""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from extremal.estimator.camera import Array
from extremal.estimator.contours import Contours
from extremal.estimator.epipolar import EpipolarPlanes, Sequence3D

REACH = 4  # [px] radius in which an edgel is looked for, where poses are exact
FARTHEST_REACH = 14  # [px] the same at the most
ALIKE = np.cos(np.deg2rad(30.0))  # directions of a contour that may match
CONFIDENCE = 4.0  # standard deviations of the poses that are reached for


class EdgelMap:
    """Which edgel of a view is nearest to a pixel, within `reach` [px]."""

    def __init__(self, contours: Contours, width: int, height: int, reach: int) -> None:
        self.width, self.height, self.reach = width, height, reach
        self._x = self._y = self._edgel = np.zeros(0, np.intp)  # of pixels on the contours
        if len(contours.u) == 0:
            return
        u = np.arange(contours.u[0], contours.u[-1], 1.0)
        nearest = contours.nearest_edgel(u)
        within = contours.contour[nearest] == contours.splines.contour_of(u)
        u, nearest = u[within], nearest[within]
        x, y = np.rint(contours.splines.curve(u)).astype(np.intp).T
        inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
        self._x, self._y, self._edgel = x[inside], y[inside], nearest[inside]

    @cached_property
    def _near(self) -> np.ndarray:
        """Edgel (height + 2 reach, width + 2 reach) nearest to each pixel."""
        reach = self.reach
        near = np.full((self.height + 2 * reach, self.width + 2 * reach), -1, np.int32)
        for dy, dx in _disc(reach)[::-1]:
            near[self._y + (reach + dy), self._x + (reach + dx)] = self._edgel
        return near

    def lookup(self, pixels: Array) -> np.ndarray:
        """Edgel (...) near pixels (..., 2), -1 where there is none."""
        x, y, inside = self._rounded(pixels)
        return np.where(inside, self._near[y + self.reach, x + self.reach], -1)

    def lookup_few(self, pixels: Array) -> np.ndarray:
        """The same (n,) of so few pixels (n, 2) that to prepare the answers for all of them does not pay."""
        on = np.full((self.height + 2 * self.reach, self.width + 2 * self.reach), -1, np.int32)
        on[self._y + self.reach, self._x + self.reach] = self._edgel
        x, y, inside = self._rounded(pixels)
        dy, dx = self.reach - _disc(self.reach).T
        around = on[y[:, None] + dy, x[:, None] + dx]
        first = np.argmax(around >= 0, axis=1)
        return np.where(inside, around[np.arange(len(x)), first], -1)

    def _rounded(self, pixels: Array) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """x, y (...) of pixels (..., 2) and whether they are in the image; 0 where not."""
        with np.errstate(invalid="ignore"):
            x, y = np.rint(pixels[..., 0]), np.rint(pixels[..., 1])
            inside = (x >= 0) & (x < self.width) & (y >= 0) & (y < self.height)
        return np.where(inside, x, 0).astype(np.intp), np.where(inside, y, 0).astype(np.intp), inside


@lru_cache(maxsize=16)
def _disc(reach: int) -> np.ndarray:
    """Steps (k, 2) (y, x) to the pixels within `reach`, the nearest first."""
    steps = np.mgrid[-reach : reach + 1, -reach : reach + 1].reshape(2, -1).T
    steps = steps[(steps**2).sum(axis=1) <= reach**2]
    return steps[np.argsort(-(steps**2).sum(axis=1), kind="stable")][::-1]


@dataclass(frozen=True, eq=False)
class Crossings:
    """Crossings (n) of contours with epipolar planes: pixels, directions (n, 3) in the world to their brighter sides,
    rays, normals (n, 3) of the tangent planes, in-plane sigma [rad], limb, curvature, contrast [grey levels]."""

    found: np.ndarray
    directions: Array
    pixels: Array
    rays: Array
    tangent_planes: Array
    sigma: Array
    limb: Array
    curvature: Array
    contrast: Array


def cross(
    sequence: Sequence3D,
    contours: Contours,
    edgels: EdgelMap,
    view: int,
    planes: EpipolarPlanes,
    points: Array,
    direction: Array,
    loose: np.ndarray,
) -> Crossings:
    """Where contours of a view near the predicted contact points cross the epipolar planes (Newton along the spline).

    For a centre off the plane, the crossing is that of the contact point, taken at the predicted distance: exact to
    first order for any motion, and the epipolar match itself for linear motion. Where a contour runs along the epipolar
    lines (`loose`), its nearest point stands in, with a sigma that says so.
    """
    predicted = sequence.project(view, points)
    index = edgels.lookup_few(predicted)
    found = index >= 0
    if len(contours.u) == 0 or not found.any():
        n = len(points)
        nothing = np.zeros(n)
        blank = np.zeros((n, 3))
        return Crossings(
            nothing > 0,
            blank,
            blank[:, :2],
            blank + 1.0,
            blank,
            nothing + np.inf,
            nothing,
            nothing,
            nothing,
        )
    index = np.maximum(index, 0)
    contour = contours.contour[index]
    centre, distance = sequence.centres[view], np.linalg.norm(points - sequence.centres[view], axis=1)
    height = np.einsum("nk,nk->n", planes.normal, np.broadcast_to(centre - planes.origin, points.shape))
    u = contours.u[index]
    start = u
    for _ in range(3):
        position, tangent = contours.splines.curve(u), contours.splines.curve(u, 1)
        here = sequence.rays(view, position)
        there = sequence.rays(view, position + tangent)
        error = height + distance * np.einsum("nk,nk->n", planes.normal, here)
        slope = distance * np.einsum("nk,nk->n", planes.normal, there - here)
        step = -error / np.where(np.abs(slope) > 1e-9, slope, 1e-9)
        u = contours.splines.clamp(u + np.where(loose, 0.0, np.clip(step, -8.0, 8.0)), contour)
    position, _, normal, curvature = contours.splines.frame(u)
    rays = sequence.rays(view, position)
    error = height + distance * np.einsum("nk,nk->n", planes.normal, rays)
    tangent_planes, _, sigma = in_plane_sigma(
        sequence, view, position, normal, rays, planes, contours.sigma_at(u)
    )
    wanted = direction @ sequence.rotations[view][:, :2]
    found &= loose | (np.abs(error) < 0.05 * distance / sequence.cameras[view].fx)
    found &= np.sum(wanted * normal, axis=1) > ALIKE * np.linalg.norm(wanted, axis=1)
    found &= np.abs(u - start) < 4 * edgels.reach
    sigma = np.where(loose, loose_sigma(sequence, view), sigma)
    nearest = contours.nearest_edgel(u)
    directions = normal @ sequence.rotations[view][:, :2].T
    return Crossings(
        found,
        directions,
        position,
        rays,
        tangent_planes,
        np.where(found, sigma, np.inf),
        contours.limb[nearest],
        curvature,
        contours.contrast[nearest],
    )


def in_plane_sigma(
    sequence: Sequence3D,
    view: int,
    pixels: Array,
    normals: Array,
    rays: Array,
    planes: EpipolarPlanes,
    sigma: Array,
) -> tuple[Array, Array, Array]:
    """Tangent planes (n, 3), sine (n,) of the angle between contour and epipolar line, sigma (n,) [rad] in the plane.

    `sigma` (n,) [px] is that of the contour along its image `normals` (n, 2).
    """
    tangents = np.stack([-normals[:, 1], normals[:, 0]], axis=1)
    along = sequence.rays(view, pixels + 0.5 * tangents) - sequence.rays(view, pixels - 0.5 * tangents)
    plane = np.cross(rays, along)  # the tangent plane of the surface: holds the ray and the contour
    plane /= np.linalg.norm(plane, axis=1, keepdims=True)
    shift = sequence.rays(view, pixels + 0.5 * normals) - sequence.rays(view, pixels - 0.5 * normals)
    turn = np.cross(planes.normal, rays)
    tilt = np.sum(plane * turn, axis=1) / np.maximum(np.linalg.norm(turn, axis=1), 1e-12)
    with np.errstate(divide="ignore"):
        return plane, tilt, sigma * np.abs(np.sum(plane * shift, axis=1) / tilt)


def reach_of(sequence: Sequence3D) -> int:
    """Radius [px] in which an edgel has to be looked for, given how well the poses are known."""
    pose = max(float(sequence.pose_sigma(v, np.array(0.5))) for v in range(len(sequence.centres)))
    return int(min(REACH + np.ceil(CONFIDENCE * pose * sequence.cameras[0].fx), FARTHEST_REACH))


def loose_sigma(sequence: Sequence3D, view: int) -> float:
    """Standard deviation [rad] along the epipolar line of a point that may lie anywhere near its prediction."""
    return REACH / sequence.cameras[view].fx
