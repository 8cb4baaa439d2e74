"""Which points of a scene's edges are tracked: few and far enough apart for their errors to be independent."""

import math

import numpy as np
from numpy.typing import NDArray

from extremal.estimator.camera import Array, Camera
from extremal.scenes import Superquadric
from extremal.tasks.compiled import compiled
from extremal.tasks.contacts import Contacts, EdgeGeometry, limb_normals, sampled_curves
from extremal.tasks.distances import tangents
from extremal.tasks.level_sets import Solids, differential, local, world
from extremal.tasks.section_tracks import LEAST_TILT, STEEPER
from extremal.tasks.triples import Vector, crossed, dot, plus, put, row, times, turned, unit

LIMB_TRACKS = 12  # of every surface
FIXED_TRACKS = 20  # of all fixed curves
CANDIDATES = 120  # of a contour generator
HALVINGS = 7  # of half a turn: 25 mrad about a superquadric's middle
FIXED_STEP = 8  # samples between candidates on fixed curves: 2 to 4 mm
BORDER = 8.0  # [px] of the image in which no track starts
APART = 1e-6  # [px] that stand for a gap
WIDER = 1.05  # than the angle to the corners of the image: a cone, outside which nothing is looked at


def choose(
    geometry: EdgeGeometry, camera: Camera, rotation: Array, centre: Array, travel: Array
) -> tuple[Contacts, NDArray[np.integer]]:
    """Contacts that a camera at `centre` (3,) with `rotation` (3, 3) to the world sees, and the contour (n,) of each.

    Args:
        travel: (3,) unit vector of its motion.
    """
    chooser = _Chooser(geometry, camera, rotation, centre, travel)
    parts = [chooser.limbs(int(k)) for k in geometry.smooth]
    parts.append(chooser.fixed())
    contacts = Contacts(
        *(np.concatenate([getattr(p, name) for p, _ in parts]) for name in Contacts.__dataclass_fields__)
    )
    contour = np.concatenate([100 * i + c for i, (_, c) in enumerate(parts)])
    return contacts, np.unique(contour, return_inverse=True)[1]


class _Chooser:
    def __init__(
        self, geometry: EdgeGeometry, camera: Camera, rotation: Array, centre: Array, travel: Array
    ) -> None:
        self.geometry, self.camera = geometry, camera
        self.rotation, self.centre, self.travel = rotation, centre, travel
        self._eye: Vector = tuple(centre.tolist())

    def limbs(self, k: int) -> tuple[Contacts, NDArray[np.integer]]:
        curves = self._candidates(k)
        points = np.concatenate([np.zeros((0, 3)), *curves])
        contour = np.repeat(np.arange(len(curves)), [len(c) for c in curves])
        normals, ok = limb_normals(self.geometry.solids, k, points, self._eye)
        rows = self._even(points, contour, self._good(points, normals, ok), LIMB_TRACKS)
        there = np.ones(len(rows), bool)
        none = np.full(len(rows), -1)
        chosen = Contacts(
            points[rows], normals[rows], there, np.full(len(rows), k), none, np.zeros(len(rows))
        )
        return chosen, contour[rows]

    def _candidates(self, k: int) -> list[Array]:
        """Points (n, 3) along the contour generators of a surface, in order."""
        surface = self.geometry.surfaces[k]
        if not isinstance(surface, Superquadric):
            curves = surface._contour(surface._local(self.centre))
            return [surface._world(c[:: max(len(c) // CANDIDATES, 1)]) for c in curves]
        start, planes = _fan(self.geometry.solids, k, self._eye)
        points, ok = self.geometry.limbs(k, start, self.centre, planes)
        return [points[ok]]

    def fixed(self) -> tuple[Contacts, NDArray[np.integer]]:
        x, y, z = self.rotation[:, 2].tolist()
        u, curve, points, normals, ok = sampled_curves(
            self.geometry.fixed, FIXED_STEP, self._eye, (x, y, z), _cosine_of_image(self.camera)
        )
        good = self._good(points, normals, ok)
        rows = self._even(points, curve, good, FIXED_TRACKS)
        none = np.full(len(rows), -1)
        there = np.ones(len(rows), bool)
        return Contacts(points[rows], normals[rows], there, none, curve[rows], u[rows]), curve[rows]

    def _good(self, points: Array, normals: Array, ok: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Whether points (n, 3) that are `ok` stand in the image, off its border, hidden by nothing, across the travel."""
        rows = np.flatnonzero(ok)
        pixels = self.camera.project((points[rows] - self.centre) @ self.rotation)
        high = (self.camera.width - 1 - BORDER, self.camera.height - 1 - BORDER)
        rows = rows[_across(self._eye, self.travel, points[rows], normals[rows], pixels, high)]
        good = np.zeros(len(points), bool)
        good[rows] = ~self.geometry.hidden(self.centre, points[rows])
        return good

    def _even(
        self, points: Array, contour: NDArray[np.integer], good: NDArray[np.bool_], most: int
    ) -> NDArray[np.integer]:
        """Up to `most` rows of good points, at equal distances along their contours in the image."""
        rows = np.flatnonzero(good)
        if len(rows) <= most:
            return rows
        pixels = self.camera.project((points[rows] - self.centre) @ self.rotation)
        return rows[_evenly(pixels, contour[rows], rows, most)]


def _cosine_of_image(camera: Camera) -> float:
    """Of the angle about the optical axis beyond which nothing is in the image."""
    right, bottom = camera.width - 0.5, camera.height - 0.5
    corners = camera.rays([[-0.5, -0.5], [right, -0.5], [-0.5, bottom], [right, bottom]])
    return math.cos(WIDER * math.acos(corners[:, 2].min()))


@compiled
def _evenly(
    pixels: Array, contour: NDArray[np.integer], number: NDArray[np.integer], most: int
) -> NDArray[np.integer]:
    """Up to `most` of n pixels (n, 2) at equal distances along their contours (n,), of which those without a successive number (n,)
    are apart."""
    n = len(pixels)
    along, chosen, count = np.zeros(n), np.empty(most, np.int64), 0
    for i in range(1, n):
        x, y = pixels[i, 0] - pixels[i - 1, 0], pixels[i, 1] - pixels[i - 1, 1]
        joined = contour[i] == contour[i - 1] and number[i] == number[i - 1] + 1
        along[i] = along[i - 1] + (math.sqrt(x * x + y * y) if joined else APART)
    at = 0
    for k in range(most):
        while at < n - 1 and along[at] < (k + 0.5) / most * along[n - 1]:
            at += 1
        if count == 0 or chosen[count - 1] != at:
            chosen[count], count = at, count + 1
    return chosen[:count]


@compiled
def _across(
    eye: Vector,
    travel: Array,
    points: Array,
    normals: Array,
    pixels: Array,
    high: tuple[float, float],
) -> NDArray[np.bool_]:
    """Which (n,) points stand from BORDER to `high` [px] in the image and move across their contours."""
    out, along = np.empty(len(points), np.bool_), (travel[0], travel[1], travel[2])
    for i in range(len(points)):
        ray = plus(row(points, i), -1.0, eye)
        across = plus(along, -dot(ray, along) / dot(ray, ray), ray)
        tilt = abs(dot(row(normals, i), unit(across)))
        x, y = pixels[i, 0], pixels[i, 1]
        out[i] = tilt > STEEPER * LEAST_TILT and BORDER < x < high[0] and BORDER < y < high[1]
    return out


@compiled
def _fan(solids: Solids, k: int, eye: Vector) -> tuple[Array, Array]:
    """Points (n, 3) near the contour generator of a superquadric seen from an eye, and normals (n, 3) of planes through it in which
    they lie: on a convex body every half-plane bounded by the line from its middle to the camera holds one.
    `Surface._contour` finds a few thousand, to rounding."""
    centre = local(solids, k, eye)
    axis = unit(centre)
    u, v = tangents(axis)
    points, planes = np.empty((CANDIDATES, 3)), np.empty((CANDIDATES, 3))
    for i in range(CANDIDATES):
        phi = i * (2 * np.pi / CANDIDATES)
        aside = plus(times(math.cos(phi), u), math.sin(phi), v)
        low, high, p = 0.0, np.pi, aside
        for _ in range(HALVINGS):
            beta = (low + high) / 2
            d = plus(times(math.cos(beta), axis), math.sin(beta), aside)
            F, gradient, _ = differential(solids, k, d, d)
            p = times(1 / (F + 1), d)  # F + 1 is the gauge
            # grad G . (p - c) = 1 - grad G . c, from the side that faces the camera on
            if dot(gradient, centre) < 1:
                high = beta
            else:
                low = beta
        put(points, i, world(solids, k, p))
        put(planes, i, turned(solids.rotation[k], crossed(axis, aside)))
    return points, planes
