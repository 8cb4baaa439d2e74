"""Propagation of covariance from rays and camera poses to radii of curvature (Cipolla ch. 3, eq. 3.25-3.26)."""

from collections.abc import Sequence

import numpy as np

from extremal.estimator.camera import Array, View
from extremal.estimator.circle import OsculatingCircle

STEEPEST = 1e-3  # sine of the angle between contour and epipolar line, below which it counts as this


def pose_gradient(
    circles: OsculatingCircle, views: Sequence[View], tangent_planes: Array | None = None
) -> Array:
    """Change (n, V, 6) of R per pose error of each view: translation [m] and rotation vector [rad] in the camera frame.

    `tangent_planes` (n, V, 3) are the unit normals, of any sign, of the planes through each ray and the contour's tangent;
    by default they are perpendicular to the epipolar planes.
    """
    return circles.radius_gradient[..., None] * _support_gradient(circles, views, tangent_planes)


def pose_angle_sigma(
    circles: OsculatingCircle, views: Sequence[View], tangent_planes: Array | None = None
) -> Array:
    """Angle (n, V) [rad] in the epipolar plane by which the poses' uncertainty moves each ray at its contact point."""
    covariance = np.array([v.pose_covariance for v in views])
    gradient = _support_gradient(circles, views, tangent_planes)
    gradient /= np.maximum(circles.distances, 1e-6)[..., None]
    return np.sqrt(np.einsum("nvi,vij,nvj->nv", gradient, covariance, gradient))


def _support_gradient(
    circles: OsculatingCircle, views: Sequence[View], tangent_planes: Array | None
) -> Array:
    """Displacement (n, V, 6) along N_i of where each tangent plane cuts the epipolar plane, per pose error of its view.

    At the contact point r a pose error moves the tangent plane by n . (t + w x (r - v)) along its own normal n, and so its
    trace in the epipolar plane by that over n . N_i: where a contour is tilted, motion out of the plane counts, too.
    """
    rotations = np.array([v.T_world_camera.rotation.as_matrix() for v in views])
    normals = circles.normals if tangent_planes is None else tangent_planes
    slant = np.sum(normals * circles.normals, axis=-1)
    normals = normals / np.where(np.abs(slant) < STEEPEST, np.copysign(STEEPEST, slant), slant)[..., None]
    rays = np.cross(circles.plane_normals[:, None], circles.normals)
    translation = np.einsum("nvk,vkj->nvj", normals, rotations)
    lever = circles.distances[..., None] * np.cross(rays, normals)
    return np.concatenate([translation, np.einsum("nvk,vkj->nvj", lever, rotations)], axis=-1)


def relative_radius(
    circles: OsculatingCircle,
    image_variance: Array,
    gradient: Array,
    views: Sequence[View],
    a: np.ndarray,
    b: np.ndarray,
) -> tuple[Array, Array]:
    """R_A - R_B (k,) [m] and its standard deviation for pairs of points a, b (k,) (parallax; Cipolla eq. 2.57-2.59).

    The poses are shared: their errors enter through the difference of the gradients (n, V, 6), in which what is
    common to both points cancels. `image_variance` (n,) [m^2] is that of each R from the image alone.
    """
    covariance = np.array([v.pose_covariance for v in views])
    difference = gradient[a] - gradient[b]
    shared = np.einsum("kvi,vij,kvj->k", difference, covariance, difference)
    return circles.radius[a] - circles.radius[b], np.sqrt(image_variance[a] + image_variance[b] + shared)
