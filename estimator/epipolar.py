"""Epipolar geometry of a sequence of views that move (nearly) along a line."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from extremal.estimator.camera import Array, Camera, View
from extremal.estimator.errors import DegenerateGeometry

SHORTEST_BASELINE = 1e-4  # [m]
LEAST_CERTAINTY = 10.0  # standard deviations of a position that the path must be long


@dataclass(frozen=True, eq=False)
class Sequence3D:
    """V views as arrays: rotations (V, 3, 3) camera to world, centres (V, 3) [m], unit travel (3,) first to last, and
    typical standard deviations (V,) of each pose's position [m] and orientation [rad]."""

    cameras: tuple[Camera, ...]
    rotations: Array
    centres: Array
    travel: Array
    position_sigma: Array
    rotation_sigma: Array

    @staticmethod
    def of(views: Sequence[View]) -> "Sequence3D":
        """Raises DegenerateGeometry for fewer than three views or centres that do not move, or no farther than they are known."""
        if len(views) < 3:
            raise DegenerateGeometry(
                f"{len(views)} view(s) given; curvature from apparent contours needs at least 3"
            )
        centres = np.array([v.centre for v in views])
        rotations = np.array([v.T_world_camera.rotation.as_matrix() for v in views])
        spread = np.linalg.svd(centres - centres.mean(axis=0))[2][0]
        along = (centres - centres[0]) @ spread
        if np.ptp(along) < SHORTEST_BASELINE:
            raise DegenerateGeometry(
                f"the camera centres span {np.ptp(along):.2g} m; accepted: a baseline of at least {SHORTEST_BASELINE} m"
            )
        travel = spread if along[-1] > 0 else -spread
        variance = np.array([np.diagonal(v.pose_covariance) for v in views]).reshape(-1, 2, 3).mean(axis=2)
        unknown = LEAST_CERTAINTY * float(np.sqrt(variance[:, 0].mean()))
        if np.ptp(along) < unknown:
            raise DegenerateGeometry(
                f"the camera centres span {np.ptp(along):.2g} m, no more than their uncertainty brings about; accepted: a "
                f"baseline of at least {unknown:.2g} m ({LEAST_CERTAINTY:g} standard deviations of a position)"
            )
        return Sequence3D(tuple(v.camera for v in views), rotations, centres, travel, *np.sqrt(variance).T)

    def pose_sigma(self, view: int, distance: Array) -> Array:
        """Standard deviation (n,) [rad] of the direction of points at a distance (n,), from the pose of a view."""
        return np.hypot(self.position_sigma[view] / np.maximum(distance, 1e-6), self.rotation_sigma[view])

    def rays(self, view: int, pixels: Array) -> Array:
        """Unit rays (..., 3) in the world through pixels (..., 2) of a view."""
        return self.cameras[view].rays(pixels) @ self.rotations[view].T

    def project(self, view: int, points: Array) -> Array:
        """Pixels (..., 2) of world points (..., 3); NaN behind the camera."""
        return self.cameras[view].project((points - self.centres[view]) @ self.rotations[view])

    def neighbours(self, view: int) -> list[int]:
        """The other views, nearest first."""
        distance = np.linalg.norm(self.centres - self.centres[view], axis=1)
        return [int(i) for i in np.argsort(distance, kind="stable") if i != view]


@dataclass(frozen=True, eq=False)
class EpipolarPlanes:
    """One plane a point (n): through `origin`, spanned by `along` (the travel) and `across`, with unit `normal` (n, 3)."""

    origin: Array
    along: Array
    across: Array
    normal: Array

    @staticmethod
    def through(origin: Array, travel: Array, rays: Array) -> "EpipolarPlanes":
        """Planes that contain the origin, the travel (3,) and rays (n, 3); a ray along the travel has NaN."""
        normal = np.cross(travel, rays)
        with np.errstate(invalid="ignore", divide="ignore"):
            normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        return EpipolarPlanes(origin, travel, np.cross(normal, travel), normal)

    def take(self, rows: np.ndarray) -> "EpipolarPlanes":
        return EpipolarPlanes(self.origin, self.along, self.across[rows], self.normal[rows])

    def coordinates(self, vectors: Array) -> tuple[Array, Array]:
        """Components (n,) of vectors (n, 3) along and across the travel, in their planes."""
        return vectors @ self.along, np.einsum("nk,nk->n", vectors, self.across)
