"""Derivatives of images of points: by the point, by the camera's own motion and by its intrinsics."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from extremal.estimator.camera import Array, Camera

INTRINSICS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")


def projection(camera: Camera, p_camera: Array) -> tuple[Array, Array, Array]:
    """Pixels (..., 2) of points (..., 3) before the camera, and derivatives by the point (..., 2, 3) and intrinsics (..., 2, 9)."""
    k1, k2, p1, p2, k3 = camera.distortion
    x, y = p_camera[..., 0] / p_camera[..., 2], p_camera[..., 1] / p_camera[..., 2]
    r2 = x * x + y * y
    radial, slope = 1 + r2 * (k1 + r2 * (k2 + r2 * k3)), k1 + r2 * (2 * k2 + 3 * r2 * k3)
    bent = np.stack(
        [
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        ],
        -1,
    )
    focal = np.array([camera.fx, camera.fy])
    across = 2 * (x * y * slope + p1 * x + p2 * y)
    by_ideal = np.stack(
        [
            np.stack([radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x, across], -1),
            np.stack([across, radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x], -1),
        ],
        axis=-2,
    )
    zero, one = np.zeros_like(x), np.ones_like(x)
    ideal_by_point = np.stack([np.stack([one, zero, -x], -1), np.stack([zero, one, -y], -1)], axis=-2)
    by_point = focal[:, None] * by_ideal @ (ideal_by_point / p_camera[..., None, 2:])
    by_intrinsics = np.zeros((*x.shape, 2, len(INTRINSICS)))
    by_intrinsics[..., 0, 0], by_intrinsics[..., 1, 1] = bent[..., 0], bent[..., 1]
    by_intrinsics[..., 0, 2] = by_intrinsics[..., 1, 3] = 1.0
    terms = [
        (x * r2, y * r2),
        (x * r2**2, y * r2**2),
        (2 * x * y, r2 + 2 * y * y),
        (r2 + 2 * x * x, 2 * x * y),
    ]
    for k, (u, v) in enumerate([*terms, (x * r2**3, y * r2**3)]):
        by_intrinsics[..., 0, 4 + k], by_intrinsics[..., 1, 4 + k] = camera.fx * u, camera.fy * v
    return bent * focal + (camera.cx, camera.cy), by_point, by_intrinsics


def point_by_twist(p_camera: Array) -> Array:
    """Change (..., 3, 6) of points (..., 3) in the camera frame as the camera moves by a twist in its own frame."""
    return np.concatenate(
        [np.broadcast_to(-np.eye(3), (*p_camera.shape, 3)), cross_matrix(p_camera)], axis=-1
    )


def cross_matrix(v: Array) -> Array:
    """(..., 3, 3): cross_matrix(v) @ w = v x w."""
    out = np.zeros((*v.shape, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    return out - np.swapaxes(out, -1, -2)


def adjoint(poses: RigidTransform) -> Array:
    """(V, 6, 6): T exp(xi) T^-1 = exp(adjoint(T) xi), twists xi = (translation [m], rotation vector [rad])."""
    R = poses.rotation.as_matrix()
    out = np.zeros((*R.shape[:-2], 6, 6))
    out[..., :3, :3] = out[..., 3:, 3:] = R
    out[..., :3, 3:] = cross_matrix(poses.translation) @ R
    return out


def intrinsics(camera: Camera) -> Array:
    """Values (9,) of `INTRINSICS`."""
    return np.array([camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion])


def with_intrinsics(camera: Camera, values: Array) -> Camera:
    """The camera with other values (9,) of `INTRINSICS`; InvalidInput as `Camera`'s."""
    fx, fy, cx, cy, *distortion = values.tolist()
    return replace(camera, fx=fx, fy=fy, cx=cx, cy=cy, distortion=tuple(distortion))


def turning(camera: Camera) -> Array:
    """Pose errors (6, 9) that move the rays near the optical axis as errors of the intrinsics do, per unit of each.

    Errors are actual minus believed. Only the principal point turns these rays; the focal length is `focal_sigma`'s.
    """
    turned = np.zeros((6, len(INTRINSICS)))
    turned[4, INTRINSICS.index("cx")] = -1 / camera.fx
    turned[3, INTRINSICS.index("cy")] = 1 / camera.fy
    return turned


def focal_sigma(camera: Camera, intrinsics_root: Array) -> float:
    """Standard deviation of the mean focal length, as a fraction of it."""
    mean = intrinsics_root[:2] / np.array([[2 * camera.fx], [2 * camera.fy]])
    return float(np.linalg.norm(mean.sum(axis=0)))
