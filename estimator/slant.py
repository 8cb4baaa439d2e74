"""The slant of contours against their epipolar planes, smoothed over the views.

A tangent plane cuts the epipolar plane in the line that counts, whatever the slant of the contour there. But when a pose is
in error, out of the plane too, the slant says how far that line moves; and the direction of a short piece of contour is
noisy. Taken as measured, its noise makes motion of all cameras out of the plane look as if the images told of it.

If section and plane move along the plane's normal together, the support of the section h(phi) = s cos phi + q sin phi +
R (1 - cos phi) changes by dh, linear in the changes of s, q and R. With n the tangent plane's normal, N and m those in
and of the epipolar plane, that is the slant:

    n . m / n . N = -dh = c_0 cos phi + c_1 sin phi + c_2 (1 - cos phi)

(of a straight edge with c_2 = 0). These three numbers a track are fitted to all of its views.
"""

import numpy as np

from extremal.estimator.camera import Array

FAR = 3.0  # mean absolute deviations beyond which a direction loses weight
RIDGE = 1e-6  # of the diagonal: decides where few views leave a number open


def smoothed_tangent_planes(
    normals: Array, rays: Array, plane_normals: Array, seen: np.ndarray, reference: int
) -> Array:
    """Unit normals (n, V, 3) through the same lines in the epipolar planes, of smoothed slant.

    Args:
        normals: (n, V, 3) of the tangent planes, of any sign. rays: (n, V, 3). plane_normals: (n, 3) of the epipolar planes.
        seen: (n, V) where a direction was measured; elsewhere it follows from the other views.
        reference: the view at which phi = 0.
    """
    m = plane_normals[:, None]
    across = np.cross(rays, m)
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    # m, but perpendicular to the ray, also where a camera is a little off the plane
    up = np.cross(across, rays)
    first = across[:, reference, None]
    cosine = np.sum(across * first, axis=-1)
    sine = np.sum(np.cross(first, across) * m, axis=-1)
    columns = np.stack([cosine, sine, 1 - cosine], axis=-1)
    steep = np.sum(normals * across, axis=-1)
    steep = np.where(np.abs(steep) > 1e-6, steep, 1e-6)
    slant = np.sum(normals * up, axis=-1) / steep
    # the direction's own error d turns the slant by d / (n . N)^2
    weight = seen * steep**2
    fitted = np.zeros_like(slant)
    for _ in range(3):
        design = columns * weight[..., None]
        gram = np.swapaxes(design, 1, 2) @ design
        diagonal = np.maximum(
            np.diagonal(gram, axis1=1, axis2=2), 1e-12 * np.max(gram, axis=(1, 2), initial=1e-12)[:, None]
        )
        gram = gram + RIDGE * diagonal[:, :, None] * np.eye(3)
        right = np.einsum("nvk,nv->nk", design, weight * slant)
        fitted = np.einsum("nvk,nk->nv", columns, np.linalg.solve(gram, right[..., None])[..., 0])
        off = np.abs(fitted - slant) * steep**2
        scale = np.sum(off * seen, axis=1, keepdims=True) / np.maximum(seen.sum(axis=1, keepdims=True), 1)
        weight = seen * steep**2 * np.minimum(1.0, FAR * np.maximum(scale, 1e-9) / np.maximum(off, 1e-12))
    smooth = across + fitted[..., None] * up
    return smooth / np.linalg.norm(smooth, axis=-1, keepdims=True)
