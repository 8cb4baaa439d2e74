"""Propagation of covariance from rays and camera poses to radii of curvature (Cipolla ch. 3, eq. 3.25-3.26)."""

from collections.abc import Sequence

import numpy as np

from extremal.estimator.camera import Array, View
from extremal.estimator.circle import OsculatingCircle


def pose_gradient(circles: OsculatingCircle, views: Sequence[View]) -> Array:
    """Change (n, V, 6) of R per pose error of each view: translation [m] and rotation vector [rad] in the camera frame."""
    return circles.radius_gradient[..., None] * _support_gradient(circles, views)


def pose_angle_sigma(circles: OsculatingCircle, views: Sequence[View]) -> Array:
    """Angle (n, V) [rad] in the epipolar plane by which the poses' uncertainty moves each ray at its contact point."""
    covariance = np.array([v.pose_covariance for v in views])
    gradient = _support_gradient(circles, views) / np.maximum(circles.distances, 1e-6)[..., None]
    return np.sqrt(np.einsum("nvi,vij,nvj->nv", gradient, covariance, gradient))


def _support_gradient(circles: OsculatingCircle, views: Sequence[View]) -> Array:
    """Displacement (n, V, 6) of each ray along N_i, at its contact point, per pose error of its view.

    A translation t moves the support of ray i by N_i . t; a rotation w turns the ray, which at distance lambda_i moves
    it by -lambda_i (m . w) along N_i, with m the normal of the epipolar plane.
    """
    rotations = np.array([v.T_world_camera.rotation.as_matrix() for v in views])
    translation = np.einsum("nvk,vkj->nvj", circles.normals, rotations)
    rotation = -circles.distances[..., None] * np.einsum("nk,vkj->nvj", circles.plane_normals, rotations)
    return np.concatenate([translation, rotation], axis=-1)


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
