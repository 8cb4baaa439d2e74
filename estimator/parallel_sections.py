"""A surface near a contour point, as the support functions of its parallel sections; its distance from edgels.

With n0 the surface normal of a contour point, e1 its ray and e2 the tangent of its contour, let g(phi, x) be the support
function of the section in the plane at x along e2, and N(phi) = cos(phi) n0 + sin(phi) e1. Then

    n = N - g_x e2                 a normal (its length is not 1),
    c = g N + g_phi N' + x e2      the contact point of its tangent plane,
    h = n . c = g - x g_x          the plane's support.

It is a Legendre transform, along the contour alone, of the support function of the surface, h(n) (DESIGN, equation 3).
That has no derivatives where the surface is parabolic, the surface's height has none where a curve is fixed; g has
both, as phi is what turns along the ray and x what advances along the contour, at every visible contour point.

It is expanded in terms K_i(phi) x^j / j! with K_i = sum_k (-1)^k phi^(i + 2k) / (i + 2k)!: cos, sin, 1 - cos,
phi - sin, ... Their derivative is K_(i-1), and K_i + K_i'' = phi^(i-2) / (i-2)!: the terms of a section's radius of
curvature. Shifts, circles, cylinders and plane fixed curves are exact.
"""

from dataclasses import dataclass

import numpy as np

from extremal.estimator.camera import Array

HIGHEST = 8  # order i + j of the last terms
HIGHEST_TURN = 6  # largest i
TERMS = tuple(
    (t - j, j) for t in range(HIGHEST + 1) for j in range(t + 1) if t - j <= HIGHEST_TURN
)  # by order
STEP_PHI, STEP_X = (
    0.1,
    0.2,
)  # longest steps towards the foot of an edgel: [rad], and in parts of the largest x
SERIES = 8  # terms of the kernels' power series: exact for |phi| < 1
FOOT_STEPS = 4  # of Newton's method, from what the edgel's own tangent says


def terms_up_to(order: int) -> int:
    """Number of terms K_i x^j / j! with i + j <= order."""
    return sum(i + j <= order for i, j in TERMS)


@dataclass(frozen=True, eq=False)
class Edgels:
    """Edgels (n, M) in the frame (n0, e1, e2) of their contour point.

    Attributes:
        centres, rays: (n, M, 3) camera centres [m] and unit rays.
        inverse_sigma: (n, M) [1/rad] across the contour; 0 for an edgel that is left out.
    """

    centres: Array
    rays: Array
    inverse_sigma: Array


def kernels(phi: Array, order: int) -> Array:
    """K_-2 .. K_order (..., order + 3) at phi (...), where K_-1 = -sin and K_-2 = -cos."""
    P, K, square = powers(phi, order), np.empty((*phi.shape, order + 3)), phi * phi
    for i in (order, order - 1):
        series = np.ones_like(phi)
        for k in range(SERIES, 0, -1):
            series = 1 - square * series / ((i + 2 * k) * (i + 2 * k - 1))
        K[..., i + 2] = P[..., i + 2] * series
    for i in range(order - 2, -3, -1):  # downwards nothing cancels
        K[..., i + 2] = P[..., i + 2] - K[..., i + 4]
    return K


def powers(x: Array, order: int) -> Array:
    """x^j / j! for j = -2 .. order (..., order + 3) at x (...), zero for negative j."""
    X = np.zeros((*x.shape, order + 3))
    X[..., 2] = 1.0
    for j in range(1, order + 1):
        X[..., j + 2] = X[..., j + 1] * x / j
    return X


def columns(phi: Array, x: Array, order: int) -> Array:
    """Derivatives (..., P) of g at (phi, x) (...) by the coefficients of all terms up to `order`."""
    K, X = kernels(phi, order), powers(x, order)
    return np.stack([K[..., i + 2] * X[..., j + 2] for i, j in TERMS[: terms_up_to(order)]], axis=-1)


@dataclass(frozen=True, eq=False)
class Jet:
    """g and its derivatives (n, M) by phi (p) and x."""

    g: Array
    p: Array
    x: Array
    pp: Array
    px: Array
    xx: Array


def jet(coefficients: Array, phi: Array, x: Array, order: int) -> Jet:
    """Of the models with `coefficients` (n, P), at phi, x (n, M)."""
    K, X = kernels(phi, order), powers(x, order)
    table = np.zeros((len(coefficients), order + 1, order + 1))
    for k, (i, j) in enumerate(TERMS[: coefficients.shape[1]]):
        table[:, i, j] = coefficients[:, k]
    along = [X[..., 2 - d : X.shape[-1] - d] @ np.swapaxes(table, 1, 2) for d in range(3)]

    def derivative(p: int, d: int) -> Array:
        return np.sum(K[..., 2 - p : K.shape[-1] - p] * along[d], axis=-1)

    return Jet(*(derivative(p, d) for p, d in ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))))


def in_section(along_n: Array, along_p: Array, along_e: Array, phi: Array) -> Array:
    """along_n N + along_p N' + along_e e2 in the frame (n0, e1, e2)."""
    cos, sin = np.cos(phi), np.sin(phi)
    return np.stack([along_n * cos - along_p * sin, along_n * sin + along_p * cos, along_e], axis=-1)


def feet(coefficients: Array, order: int, edgels: Edgels, phi: Array, x: Array) -> tuple[Array, Array]:
    """(phi, x) (n, M) of the points of the predicted apparent contours that are nearest to the edgels.

    Newton's method for n . d = 0 (the plane passes through the camera centre v) and (p x n) . d = 0 (p points to the
    foot), with d = c - v.
    """
    longest = STEP_X * np.max(np.abs(x), axis=1, keepdims=True) + 1e-6
    for _ in range(FOOT_STEPS):
        phi, x = _nearer(jet(coefficients, phi, x, order), edgels, phi, x, longest)
    return phi, x


def _nearer(j: Jet, edgels: Edgels, phi: Array, x: Array, longest: Array) -> tuple[Array, Array]:
    """(phi, x) (n, M) after a step of Newton's method, no longer than STEP_PHI and `longest` (n, 1)."""
    p, one, zero = edgels.rays, np.ones_like(phi), np.zeros_like(phi)
    n, d = in_section(one, zero, -j.x, phi), contact_point(j, phi, x) - edgels.centres
    n_phi = in_section(zero, one, -j.px, phi)
    sideways, turn = np.cross(p, n), np.cross(d, p)  # d . (p x m) = m . (d x p)
    f1, f2 = np.sum(n * d, -1), np.sum(sideways * d, -1)
    a, b = np.sum(n_phi * d, -1), -j.xx * d[..., 2]
    c = np.sum(in_section(zero, j.g + j.pp, zero, phi) * sideways + turn * n_phi, -1)
    e = np.sum(in_section(j.x, j.px, one, phi) * sideways, -1) - j.xx * turn[..., 2]
    determinant = a * e - b * c
    determinant = np.where(np.abs(determinant) > 1e-300, determinant, np.inf)
    return (
        phi - np.clip((e * f1 - b * f2) / determinant, -STEP_PHI, STEP_PHI),
        x - np.clip((a * f2 - c * f1) / determinant, -longest, longest),
    )


def contact_point(j: Jet, phi: Array, x: Array) -> Array:
    """c (..., 3) in the frame (n0, e1, e2)."""
    return in_section(j.g, j.p, x, phi)


def image_distance(
    coefficients: Array, order: int, edgels: Edgels, phi: Array, x: Array
) -> tuple[Array, Array]:
    """Signed distance (n, M) [rad] of edgels from the predicted apparent contours, and its Jacobian (n, M, P).

    With (phi, x) the feet: the angle of the ray out of the tangent plane there. A change dg of the support moves that
    plane, hence the contour, by dg / |n| at distance |d|, and to first order the foot's own move does not matter.
    """
    j = jet(coefficients, phi, x, order)
    n = in_section(np.ones_like(phi), np.zeros_like(phi), -j.x, phi)
    length = np.linalg.norm(n, axis=-1)
    distance = np.linalg.norm(contact_point(j, phi, x) - edgels.centres, axis=-1)
    error = np.arcsin(np.clip(np.sum(n * edgels.rays, axis=-1) / length, -1, 1))
    return error, -columns(phi, x, order) / (length * distance)[..., None]
