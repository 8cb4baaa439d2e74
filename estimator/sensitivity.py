"""How every measurement moves the radius of curvature (Cipolla ch. 3, eq. 3.24-3.26).

R = g(w), where w holds the image positions, the cameras' positions and orientations and the intrinsics (3.24). What is
measured in a view is a tangent plane of the surface, through a ray and the image tangent, with unit normal n. An error
that moves the plane at the contact point by the vector d moves its intersection with the epipolar plane, and so the
support of ray i, by

    (n . d) / (n . N_i)     along N_i,

and R by dR/dsupport times that. Errors along the contour do not count; errors out of the epipolar plane count where the
plane is tilted against it. An image error dq moves the plane by d = Z K^-1 dq, with Z the depth of the contact point;
an error of the intrinsics moves every pixel by -dq.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from extremal.estimator.camera import Array, Camera, View
from extremal.estimator.circle import OsculatingCircle
from extremal.estimator.errors import InvalidInput
from extremal.estimator.uncertainty import STEEPEST, pose_gradient


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """Derivatives of the radii R of n points by everything that they were computed from, in V views.

    Attributes:
        image: (n, V, 2) by the image position (x, y) of the point's edgel [m/px]; along the contour they are zero.
        pose: (n, V, 6) by the position [m/m] and the rotation vector [m/rad] of each camera, in its own frame,
            right-multiplied.
        intrinsics: (n, 4) by fx, fy, cx and cy [m/px], which all views share.
        valid: (n,) whether the derivatives exist; elsewhere they are zero, and the variance of R is infinite.
    """

    image: Array
    pose: Array
    intrinsics: Array
    valid: np.ndarray

    @property
    def shared(self) -> Array:
        """(n, 6 V + 4) derivatives by what all points share: poses, view by view, then intrinsics."""
        return np.concatenate([self.pose.reshape(len(self.pose), -1), self.intrinsics], axis=1)

    def change(self, image: ArrayLike = 0.0, pose: ArrayLike = 0.0, intrinsics: ArrayLike = 0.0) -> Array:
        """First-order change dR (n,) [m] by small errors: dR = sum dg/dw_i dw_i (eq. 3.25).

        Args:
            image: (n, V, 2) of the edgels [px].
            pose: (V, 6) of the cameras [m], [rad], in their frames.
            intrinsics: (4,) of fx, fy, cx and cy [px].
        """
        return (
            np.sum(self.image * np.asarray(image, float), axis=(1, 2))
            + np.sum(self.pose * np.asarray(pose, float), axis=(1, 2))
            + np.sum(self.intrinsics * np.asarray(intrinsics, float), axis=1)
        )

    def covariance(self, image: ArrayLike, shared: ArrayLike) -> Array:
        """Covariance (n, n) [m^2] of the radii; for independent errors eq. 3.26, in general J C J'.

        What the points share correlates them: it cancels in R_A - R_B, whose variance is C_AA + C_BB - 2 C_AB.

        Args:
            image: (n, 2 V, 2 V) or (2 V, 2 V) covariance [px^2] of a point's image positions, x and y of the first
                view first; those of two points are independent.
            shared: (6 V + 4, 6 V + 4) covariance of poses and intrinsics, in the order of `shared`.

        Raises:
            InvalidInput: other shapes.
        """
        points, views = self.image.shape[:2]
        image, shared = np.asarray(image, float), np.asarray(shared, float)
        size = 6 * views + 4
        if image.shape not in ((points, 2 * views, 2 * views), (2 * views, 2 * views)):
            raise InvalidInput(
                f"image covariance is {image.shape}; accepted: {(points, 2 * views, 2 * views)} or {(2 * views, 2 * views)}"
            )
        if shared.shape != (size, size):
            raise InvalidInput(
                f"covariance of poses and intrinsics is {shared.shape}; accepted: {(size, size)}"
            )
        own = self.image.reshape(points, -1)
        variance = np.sum(own * (image @ own[..., None])[..., 0], axis=1)
        return self.shared @ shared @ self.shared.T + np.diag(np.where(self.valid, variance, np.inf))


def sensitivity(
    circles: OsculatingCircle, views: Sequence[View], surface_normals: ArrayLike | None = None
) -> Sensitivity:
    """Derivatives of the radii of osculating circles (n) by what they were computed from (eq. 3.24, 3.25).

    The epipolar planes stay where they are. The derivatives are exact for three views; for more, where the rays
    touch their circle.

    Args:
        circles: of n points in V views.
        views: the V views; all with the same intrinsics.
        surface_normals: (n, V, 3) unit normals, in the world, of the tangent planes through rays and image tangents.
            By default the in-plane normals N_i: surfaces that stand upright on their epipolar planes.

    Returns:
        The derivatives; none for circles that are not valid, and for contours along the epipolar plane.

    Raises:
        InvalidInput: shapes that do not fit.
    """
    normals = circles.normals if surface_normals is None else np.asarray(surface_normals, float)
    if normals.shape != circles.normals.shape or normals.shape[1] != len(views):
        raise InvalidInput(
            f"{len(views)} views and surface normals {normals.shape}; accepted: as many views as the circles have, "
            f"and {circles.normals.shape}"
        )
    across = np.abs(np.sum(normals * circles.normals, axis=-1))
    valid = circles.valid & np.all(across > STEEPEST, axis=1)
    some = valid[:, None, None]
    pose = np.where(some, pose_gradient(circles, views, normals), 0.0)
    camera, rotations = views[0].camera, np.array([v.T_world_camera.rotation.as_matrix() for v in views])
    sight = circles.points - np.array([v.centre for v in views])
    p = np.where(some, np.einsum("nvk,vkj->nvj", sight, rotations), [0.0, 0.0, 1.0])
    xy, depth = p[..., :2] / p[..., 2:], p[..., 2:]
    by_pixel = np.linalg.inv(_pixels_by_ideal(camera, xy))
    # dq moves the contact point as a translation of the camera by Z K^-1 dq does
    image = np.einsum("nvk,nvkj->nvj", depth * pose[..., :2], by_pixel)
    # a wrong cx moves all pixels by 1, a wrong fx by the distorted ideal coordinate
    distorted = (camera.distort(xy) - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    intrinsics = -np.concatenate([np.sum(image * distorted, axis=1), np.sum(image, axis=1)], axis=1)
    return Sensitivity(image, pose, intrinsics, valid)


def _pixels_by_ideal(camera: Camera, xy: Array) -> Array:
    """Derivatives (..., 2, 2) of pixels by ideal image coordinates (..., 2)."""
    k1, k2, p1, p2, k3 = camera.distortion
    x, y = xy[..., 0], xy[..., 1]
    r2 = x * x + y * y
    radial, slope = 1 + r2 * (k1 + r2 * (k2 + r2 * k3)), 2 * (k1 + r2 * (2 * k2 + r2 * 3 * k3))
    mixed = slope * x * y + 2 * (p1 * x + p2 * y)
    dx = radial + slope * x * x + 2 * p1 * y + 6 * p2 * x
    dy = radial + slope * y * y + 6 * p1 * y + 2 * p2 * x
    rows = np.stack([np.stack([dx, mixed], axis=-1), np.stack([mixed, dy], axis=-1)], axis=-2)
    return rows * np.array([camera.fx, camera.fy])[:, None]
