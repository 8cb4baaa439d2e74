"""Which points of a scene's edges are tracked: few and far enough apart for their errors to be independent."""

import numpy as np
from numpy.typing import NDArray

from extremal.estimator.camera import Array, Camera
from extremal.scenes import Superquadric, Surface
from extremal.scenes.surface import tangent_basis
from extremal.tasks.contacts import Contacts, EdgeGeometry
from extremal.tasks.section_tracks import LEAST_TILT, STEEPER

LIMB_TRACKS = 12  # of every surface
FIXED_TRACKS = 20  # of all fixed curves
CANDIDATES = 120  # of a contour generator
HALVINGS = 7  # of half a turn: 25 mrad about a superquadric's middle
FIXED_STEP = 8  # samples between candidates on fixed curves: 2 to 4 mm
BORDER = 8.0  # [px] of the image in which no track starts


def choose(
    geometry: EdgeGeometry, camera: Camera, rotation: Array, centre: Array, travel: Array
) -> tuple[Contacts, NDArray[np.integer]]:
    """Contacts that a camera at `centre` (3,) with `rotation` (3, 3) to the world sees, and the contour (n,) of each.

    Args:
        travel: (3,) unit vector of its motion.
    """
    chooser = _Chooser(geometry, camera, rotation, centre, travel)
    parts = [chooser.limbs(k, surface) for k, surface in enumerate(geometry.surfaces)]
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

    def limbs(self, k: int, surface: Surface) -> tuple[Contacts, NDArray[np.integer]]:
        curves = self._candidates(k, surface)
        points = np.concatenate([np.zeros((0, 3)), *curves])
        contour = np.repeat(np.arange(len(curves)), [len(c) for c in curves])
        n, S = surface._frame(surface._local(points))
        ray = points - self.centre
        local = ray @ surface._rotation
        ok = np.vecdot(local, (S @ local[..., None])[..., 0]) > 0
        normals = n @ surface._rotation.T
        rows = self._even(points, contour, self._good(points, normals, ok), LIMB_TRACKS)
        there = np.ones(len(rows), bool)
        none = np.full(len(rows), -1)
        chosen = Contacts(
            points[rows], normals[rows], there, np.full(len(rows), k), none, np.zeros(len(rows))
        )
        return chosen, contour[rows]

    def _candidates(self, k: int, surface: Surface) -> list[Array]:
        """Points (n, 3) along the contour generators of a surface, in order."""
        if k not in self.geometry.smooth:
            return []
        if not isinstance(surface, Superquadric):
            curves = surface._contour(surface._local(self.centre))
            return [surface._world(c[:: max(len(c) // CANDIDATES, 1)]) for c in curves]
        start, planes = _fan(surface, surface._local(self.centre))
        points, _, ok = self.geometry.smooth[k].limb(
            surface._world(start), self.centre, planes @ surface._rotation.T
        )
        return [points[ok]]

    def fixed(self) -> tuple[Contacts, NDArray[np.integer]]:
        fixed = self.geometry.fixed
        curve = np.repeat(np.arange(len(fixed.first)), fixed.last - fixed.first + 1)[::FIXED_STEP]
        u = np.arange(len(fixed.points), dtype=float)[::FIXED_STEP]
        if not len(u):
            none = np.zeros(0, int)
            blank = np.zeros((0, 3))
            return Contacts(blank, blank, none > 0, none, none, u), none
        points, chord, i = fixed.at(u, curve)
        ray = points - self.centre
        normals = np.cross(ray, chord)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
        good = self._good(points, normals, fixed.facing(i, ray))
        rows = self._even(points, curve, good, FIXED_TRACKS)
        none = np.full(len(rows), -1)
        there = np.ones(len(rows), bool)
        return Contacts(points[rows], normals[rows], there, none, curve[rows], u[rows]), curve[rows]

    def _good(self, points: Array, normals: Array, ok: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Whether points (n, 3) that are `ok` stand in the image, off its border, hidden by nothing, across the travel."""
        ray = points - self.centre
        across = self.travel - (ray @ self.travel / np.sum(ray * ray, axis=1))[:, None] * ray
        tilt = np.abs(np.sum(normals * across, axis=1)) / np.maximum(np.linalg.norm(across, axis=1), 1e-9)
        pixels = self.camera.project(ray @ self.rotation)
        high = np.array([self.camera.width, self.camera.height]) - 1 - BORDER
        ok = ok & (tilt > STEEPER * LEAST_TILT) & np.all((pixels > BORDER) & (pixels < high), axis=1)
        rows = np.flatnonzero(ok)
        ok[rows] = ~self.geometry.hidden(self.centre, points[rows])
        return ok

    def _even(
        self, points: Array, contour: NDArray[np.integer], good: NDArray[np.bool_], most: int
    ) -> NDArray[np.integer]:
        """Up to `most` rows of good points, at equal distances along their contours in the image."""
        rows = np.flatnonzero(good)
        if len(rows) <= most:
            return rows
        pixels = self.camera.project((points[rows] - self.centre) @ self.rotation)
        step = np.linalg.norm(np.diff(pixels, axis=0), axis=1)
        step[(np.diff(contour[rows]) != 0) | (np.diff(rows) > 1)] = 1e-6
        along = np.concatenate([[0.0], np.cumsum(step)])
        wanted = (np.arange(most) + 0.5) / most * along[-1]
        return rows[np.unique(np.minimum(np.searchsorted(along, wanted), len(rows) - 1))]


def _fan(surface: Superquadric, centre: Array) -> tuple[Array, Array]:
    """Points (n, 3) near the contour generator seen from `centre` (3,), and normals (n, 3) of planes through it in which they
    lie, in the object frame: on a convex body every half-plane bounded by the line from its middle to the camera holds one.
    `Surface._contour` finds a few thousand, to rounding."""
    axis = centre / np.linalg.norm(centre)
    u, v = tangent_basis(axis)
    phi = np.arange(CANDIDATES)[:, None] * (2 * np.pi / CANDIDATES)
    aside = np.cos(phi) * u + np.sin(phi) * v
    low, high = np.zeros(CANDIDATES), np.full(CANDIDATES, np.pi)
    points = aside
    for _ in range(HALVINGS):
        beta = ((low + high) / 2)[:, None]
        d = np.cos(beta) * axis + np.sin(beta) * aside
        gauge, gradient = surface._gauge(d)[:2]
        points = d / gauge[:, None]
        behind = (
            gradient @ centre < 1
        )  # grad G . (p - c) = 1 - grad G . c, from the side that faces the camera on
        low, high = np.where(behind, low, beta[:, 0]), np.where(behind, beta[:, 0], high)
    return points, np.cross(axis, aside)
