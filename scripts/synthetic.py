"""Synthetic views without images: exact tangent planes of spheres, straight lines and points, with errors put on them."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial.transform import RigidTransform

from extremal.estimator.camera import Array
from extremal.estimator.poses import PosePrior, pose_exp
from extremal.estimator.support import CIRCLE, FIXED, Features, Points, Sections

ROUGH = 0.02  # of its distance, by which the depth of a feature's origin is off (standard deviation)


@dataclass(frozen=True, eq=False)
class TangentScene:
    """n contours, each touched in a plane of its own through the cameras' path, and k fixed points.

    The cameras lie on a line; or on any curve in one plane that holds all contours, too.

    Attributes:
        T_world_camera: true poses (V).
        centres: (n, 3) centres of the circles in which the planes cut the spheres [m].
        radii: (n,) of the circles [m], positive where the surface lies behind as the camera travels on; 0 for a
            straight line through the centre.
        heights: (n,) of the spheres' own centres above their planes [m]: the sections are oblique where it is not 0.
        lines: (n, 3) directions of the straight lines.
        points: (k, 3) [m].
    """

    T_world_camera: RigidTransform
    centres: Array
    radii: Array
    heights: Array
    lines: Array
    points: Array

    @cached_property
    def travel(self) -> Array:
        """(3,) unit vector from the first camera to the last."""
        v = self.T_world_camera.translation
        return _unit(v[-1] - v[0])

    @cached_property
    def plane_normals(self) -> Array:
        """(n, 3) unit normals of the contours' planes."""
        v = self.T_world_camera.translation
        return _unit(np.cross(self.travel, self.centres - v[len(v) // 2]))

    @cached_property
    def in_plane_normals(self) -> Array:
        """(n, V, 3) unit normals N_i of the rays that touch the circles, to the side of the travel."""
        across = np.cross(self.plane_normals, self.travel)
        towards = self.centres[:, None] - self.T_world_camera.translation
        x, y = towards @ self.travel, np.einsum("nvk,nk->nv", towards, across)
        angle = np.arctan2(x, y) + np.arcsin(self.radii[:, None] / np.hypot(x, y))
        return np.cos(angle)[..., None] * self.travel - np.sin(angle)[..., None] * across[:, None]

    @cached_property
    def contacts(self) -> Array:
        """(n, V, 3) points where the rays touch."""
        return self.centres[:, None] + self.radii[:, None, None] * self.in_plane_normals

    @cached_property
    def rays(self) -> Array:
        """(n, V, 3) unit rays to the contacts."""
        return _unit(self.contacts - self.T_world_camera.translation)

    @cached_property
    def normals(self) -> Array:
        """(n, V, 3) unit normals of the tangent planes, on the side of N_i."""
        height = (self.heights[:, None] * self.plane_normals)[:, None]
        of_spheres = self.radii[:, None, None] * self.in_plane_normals - height
        of_lines = np.cross(self.rays, self.lines[:, None])
        normals = _unit(np.where((self.radii == 0)[:, None, None], of_lines, of_spheres))
        return normals * np.sign(np.sum(normals * self.in_plane_normals, axis=-1, keepdims=True))

    def section_radii(self, sections: Sections) -> Array:
        """True radii (n,) [m] in the planes of `sections`, which lie as the poses are believed: slightly elsewhere."""
        up = self.plane_normals
        spheres = self.centres + self.heights[:, None] * up
        away = np.sum((spheres - sections.origin) * sections.frame[:, 2], axis=1)
        square = self.radii**2 + self.heights**2 - away**2
        return np.where(self.radii == 0, 0.0, np.sign(self.radii) * np.sqrt(np.maximum(square, 0)))


@dataclass(frozen=True, eq=False)
class Observation:
    """What an estimator is given of a scene, and the true factor on the focal length.

    features: the contours, then the fixed points if there are any.
    """

    prior: PosePrior
    features: list[Features]
    focal: float


def observe(
    scene: TangentScene, errors: PosePrior, sigma: float, rng: np.random.Generator, fixed_known: bool = True
) -> Observation:
    """Draw errors of the cameras, and of all planes' angles about the camera centres.

    Args:
        errors: what is uncertain of the cameras, about the true poses.
        sigma: [rad] of every tangent plane.
        fixed_known: whether straight lines are held fixed, or fitted with circles, too.
    """
    u = rng.standard_normal(errors.unknowns)
    believed = errors.T_world_camera * pose_exp(errors.errors(u)).inv()
    focal = 1 + errors.focal_sigma * float(u[-1]) if errors.focal_sigma else 1.0
    seen = _Seen(scene.T_world_camera, believed, focal, sigma, rng)
    sections = seen.sections(scene)
    if not fixed_known:
        sections = replace(sections, order=np.full(len(sections), CIRCLE))
    features: list[Features] = [sections, *([seen.points(scene)] if len(scene.points) else [])]
    return Observation(replace(errors, T_world_camera=believed), features, focal)


@dataclass(frozen=True, eq=False)
class _Seen:
    """True cameras, as the estimator believes them to be."""

    poses: RigidTransform
    believed: RigidTransform
    focal: float
    sigma: float
    rng: np.random.Generator

    def sections(self, scene: TangentScene) -> Sections:
        normals = self.measured(scene.normals[:, None], scene.rays[:, None])
        ray, origin = self.placed(scene.contacts[:, len(self.poses) // 2])
        first = np.cross(ray, _unit(np.cross(scene.travel, ray)))
        first *= np.sign(first @ scene.travel)[:, None]
        frame = np.stack([first, ray, np.cross(first, ray)], axis=1)
        order = np.where(scene.radii == 0, FIXED, CIRCLE)
        return Sections(normals, self.spread(normals), origin, frame, order)

    def points(self, scene: TangentScene) -> Points:
        rays = _unit(scene.points[:, None] - self.poses.translation)
        first = _unit(np.cross(rays, scene.travel))
        normals = self.measured(np.stack([first, np.cross(rays, first)], axis=1), rays[:, None])
        _, origin = self.placed(scene.points)
        frame = np.tile(np.eye(3), (len(origin), 1, 1))
        return Points(normals, self.spread(normals), origin, frame, np.full(len(origin), 3))

    def spread(self, normals: Array) -> Array:
        return np.full(normals.shape[:-1], self.sigma)

    def placed(self, points: Array) -> tuple[Array, Array]:
        """Unit rays (n, 3) of the middle view to true points, and rough positions, both as they are believed to lie."""
        middle = len(self.poses) // 2
        seen = self.believed[middle] * self.poses[middle].inv()
        here = self.believed.translation[middle]
        away = seen.apply(points) - here
        return _unit(away), here + away * (1 + ROUGH * self.rng.standard_normal((len(points), 1)))

    def measured(self, normals: Array, rays: Array) -> Array:
        """Planes (n, L, V, 3) of the world in the camera frames, turned about the camera centres by random angles."""
        angles = self.sigma * self.rng.standard_normal(normals.shape[:-1])
        turned = normals + angles[..., None] * rays
        normals = np.einsum("nlvk,vkj->nlvj", turned, self.poses.rotation.as_matrix())
        return _unit(normals / (self.focal, self.focal, 1.0))


def _unit(vectors: Array) -> Array:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
