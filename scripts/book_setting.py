"""The book's experiment on a table: three views of a point A of an extremal boundary, a marking B and fixed points."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from extremal.estimator import Camera, InvalidInput, OsculatingCircle, View, osculating_circle
from extremal.estimator.adjustment import Adjustment, adjust
from extremal.estimator.camera import Array
from extremal.estimator.poses import PosePrior, pose_exp
from extremal.estimator.sensitivity import Sensitivity, sensitivity
from extremal.estimator.support import CIRCLE, Points, Sections
from extremal.sim import fixating

BASELINE = 0.1  # [m] total translation, in three views
TRAVEL, AXIS = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])  # axis: normal of the epipolar plane
CAMERA = Camera()
FIXED_POINTS = 12
SPREAD = 0.06  # [m] half the side of the cube around A that they are spread over


@dataclass(frozen=True)
class BookSetting:
    """Three views over 0.1 m along y, which fixate A at the origin from -x; everything lies in the plane z = 0.

    A is on the extremal boundary of an upright vase, whose axis passes through (0, -radius); B is a fixed feature.

    Attributes:
        radius: of the vase [m]; 0 makes A a fixed feature.
        marking: (x, y) of B [m].
        distance: from the middle view to A [m].
    """

    radius: float
    marking: tuple[float, float]
    distance: float = 0.5

    @staticmethod
    def with_vase(radius: float, arc: float, distance: float) -> "BookSetting":
        """B as a marking of the vase, `arc` [m] from A towards the cameras.

        Raises InvalidInput where a length is out of range, or B is not visible in every view.
        """
        for name, value, low, high in (("radius", radius, 1e-3, 1.0), ("distance", distance, 0.1, 10.0)):
            if not low <= value <= high:
                raise InvalidInput(f"--{name} is {value:g}; accepted: {low:g} to {high:g} [m]")
        if distance < 2 * radius:
            raise InvalidInput(
                f"--distance is {distance:g}; accepted: at least twice the radius, {2 * radius:g} [m]"
            )
        arcs = np.linspace(0, np.pi * radius, 2001)
        seen = arcs[_seen(radius, distance, arcs)]
        if not (seen.size and seen[0] <= arc <= seen[-1]):
            accepted = f"{seen[0]:.4f} to {seen[-1]:.4f} [m]" if seen.size else "none at this distance"
            raise InvalidInput(f"--marking is {arc:g}, hidden from a view; accepted: {accepted}")
        turn = arc / radius
        return BookSetting(radius, (-radius * np.sin(turn), radius * (np.cos(turn) - 1)), distance)

    @cached_property
    def T_world_camera(self) -> RigidTransform:
        """Poses (3)."""
        return fixating(
            np.array([[-self.distance, y, 0.0] for y in (-BASELINE / 2, 0, BASELINE / 2)]), np.zeros(3)
        )

    @property
    def rotation(self) -> float:
        """Total rotation [rad] from the first to the last view."""
        return float((self.T_world_camera[0].inv() * self.T_world_camera[2]).rotation.magnitude())

    @cached_property
    def views(self) -> list[View]:
        """The three views; there is nothing on their images."""
        image = np.zeros((CAMERA.height, CAMERA.width), np.uint8)
        return [View(CAMERA, pose, image) for pose in self.T_world_camera]

    @cached_property
    def pixels(self) -> Array:
        """Exact image positions (2, 3, 2) of A and B: A's is where the ray touches the vase."""
        v = self.T_world_camera.translation
        towards = np.array([0.0, -self.radius, 0.0]) - v
        far = np.linalg.norm(towards, axis=1)
        sine = self.radius / far
        u = towards / far[:, None]
        touching = v + (far * np.sqrt(1 - sine**2))[:, None] * _turned(u, np.arcsin(sine))
        points = np.stack([touching, np.tile([*self.marking, 0.0], (3, 1))])
        return np.stack([view.project(points[:, i]) for i, view in enumerate(self.views)], axis=1)

    def circles(self, edge_errors: Array, pose_errors: Array) -> OsculatingCircle:
        """Circles (..., 2) at A and B, re-estimated in the epipolar plane.

        Args:
            edge_errors: (..., 2, 3) of the image positions, along the epipolar line [px].
            pose_errors: (..., 3, 6) of the believed poses [m], [rad], in the camera frames.
        """
        along = np.stack([edge_errors, np.zeros_like(edge_errors)], axis=-1)
        return self._circles(self.pixels + along, AXIS, pose_errors)

    def circles_around(self, edge_errors: Array, point_errors: Array, pose_errors: Array) -> OsculatingCircle:
        """Circles (..., 13) at A and the fixed points, as if none were known to be fixed, each in its epipolar plane.

        Args:
            edge_errors: (..., 3) of A, along the epipolar line [px].
            point_errors: (..., 12, 3, 2) of the fixed points [px].
            pose_errors: (..., 3, 6) of the believed poses [m], [rad], in the camera frames.
        """
        a = self.pixels[0] + np.stack([edge_errors, np.zeros_like(edge_errors)], axis=-1)
        pixels = np.concatenate([a[..., None, :, :], self.fixed_pixels + point_errors], axis=-3)
        planes = _unit(np.cross(TRAVEL, self.fixed_points - self.T_world_camera[1].translation))
        return self._circles(pixels, np.concatenate([AXIS[None], planes]), pose_errors)

    def _circles(self, pixels: Array, planes: Array, pose_errors: Array) -> OsculatingCircle:
        """Circles (..., n) of image positions (..., n, 3, 2) in planes (n, 3)."""
        rotations = self.T_world_camera.rotation.as_matrix()
        turned = Rotation.from_rotvec(pose_errors[..., 3:].reshape(-1, 3)).as_matrix()
        turned = rotations @ turned.reshape(*pose_errors.shape[:-1], 3, 3)
        moved = np.einsum("vij,...vj->...vi", rotations, pose_errors[..., :3])
        rays = np.einsum("...vij,...nvj->...nvi", turned, CAMERA.rays(pixels))
        centres = self.T_world_camera.translation + moved
        return osculating_circle(centres[..., None, :, :], rays, 1e-4, planes)

    def sensitivity(self) -> Sensitivity:
        """Derivatives of R at A and B."""
        return sensitivity(self.circles(np.zeros((2, 3)), np.zeros((3, 6))), self.views)

    @cached_property
    def fixed_points(self) -> Array:
        """(12, 3) fixed points around A [m], the same ones always."""
        return np.random.default_rng(12).uniform(-SPREAD, SPREAD, (FIXED_POINTS, 3))

    @cached_property
    def fixed_pixels(self) -> Array:
        """Exact image positions (12, 3, 2) of the fixed points."""
        return np.stack([view.project(self.fixed_points) for view in self.views], axis=1)

    def joint(
        self,
        edge_errors: Array,
        point_errors: Array,
        pose_errors: Array,
        edge_sigma: float,
        pose_sigma: Array,
    ) -> Adjustment:
        """Contour bundle adjustment of A and the fixed points; A is the only one of the first set of features.

        Args:
            edge_errors: (3,) of A, along the epipolar line [px].
            point_errors: (12, 3, 2) of the fixed points [px].
            pose_errors: (3, 6) of the believed poses [m], [rad], in the camera frames.
            edge_sigma: standard deviation of all image errors [px].
            pose_sigma: (6,) standard deviations of the pose errors [m], [rad].
        """
        believed = self.T_world_camera * pose_exp(pose_errors)
        prior = PosePrior(believed, np.tile(np.diag(pose_sigma), (3, 1, 1)))
        upright = np.array([0.0, 1.0, 0.0])  # the image tangent of A, in the camera frames
        rays = CAMERA.rays(self.pixels[0] + np.stack([edge_errors, np.zeros(3)], axis=1))
        normals = _unit(np.cross(rays, upright))
        sigma = np.full(3, edge_sigma / CAMERA.fx)
        contour = Sections(
            normals[None, None],
            sigma[None, None],
            np.zeros((1, 3)),
            np.stack([TRAVEL, np.array([1.0, 0.0, 0.0]), AXIS])[None],
            np.array([CIRCLE]),
        )
        rays = CAMERA.rays(self.fixed_pixels + point_errors)
        planes = np.stack([_unit(np.cross(rays, axis)) for axis in np.eye(3)[:2]], axis=1)
        points = Points(
            planes,
            np.full(planes.shape[:-1], edge_sigma / CAMERA.fx),
            self.fixed_points,
            np.tile(np.eye(3), (FIXED_POINTS, 1, 1)),
            np.full(FIXED_POINTS, 3),
        )
        return adjust(prior, [contour, points])


def _turned(vectors: Array, angles: Array) -> Array:
    """Vectors (n, 3) in the plane z = 0, turned by angles (n,) from x to y."""
    return np.cos(angles)[:, None] * vectors + np.sin(angles)[:, None] * np.cross(AXIS, vectors)


def _seen(radius: float, distance: float, arcs: Array) -> np.ndarray:
    """Whether points (n,) of the vase, at arcs [m] from A, face all three views."""
    turn = arcs / radius
    normals = np.stack([-np.sin(turn), np.cos(turn)], axis=1)
    ends = np.array([[-distance, -BASELINE / 2], [-distance, BASELINE / 2]])
    points = radius * (normals - (0.0, 1.0))
    return np.all(np.sum((ends[:, None] - points) * normals, axis=2) > 0, axis=0)


def _unit(vectors: Array) -> Array:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
