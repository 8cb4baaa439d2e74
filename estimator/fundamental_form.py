"""Principal curvatures, radii and directions from what contours show: beta, gamma and alpha (see `second_order`).

beta S = [[1, -gamma], [-gamma, alpha beta + gamma^2]] is finite for fixed curves and parabolic points alike. Its eigenvalues mu, of
product alpha beta, give curvatures mu / beta = alpha / mu' and radii beta / mu = mu' / alpha, of which the well conditioned form
is taken. With u the unit eigenvector of a curvature k = 1 / R,

    dk = -k^2 u1^2 dbeta - 2 k u1 u2 dgamma + u2^2 dalpha,      dR = -R^2 dk.
"""

import numpy as np

from extremal.estimator.camera import Array

KINDS = ("undetermined", "elliptic", "hyperbolic", "parabolic", "fixed curve", "fixed point")
CONFIDENT = 1.96  # standard deviations: 95 %


def curvatures(
    beta: Array, gamma: Array, alpha: Array, covariance: Array, axes: Array, known: np.ndarray
) -> dict[str, Array]:
    """Second-order quantities by name (as `SecondOrderShape` has them) with standard deviations.

    Args:
        beta, gamma, alpha: (n,) radius along the ray [m], skew, curvature of the contour [1/m].
        covariance: (n, 3, 3) of these, infinite where not known.
        axes: (n, 2, 3) ray and tangent of the contour.
        known: (n,) whether all three are.
    """
    mu, direction = _eigen(beta, gamma, alpha)
    large = np.argmax(np.abs(mu), axis=1)[:, None] == np.arange(2)
    other = mu[:, ::-1]
    with np.errstate(divide="ignore", invalid="ignore"):
        curvature = np.where(large, mu / beta[:, None], alpha[:, None] / other)
        radius = np.where(large, beta[:, None] / mu, other / alpha[:, None])
        u1, u2 = direction[..., 0], direction[..., 1]
        by_curvature = np.stack([-((curvature * u1) ** 2), -2 * curvature * u1 * u2, u2**2], axis=-1)
        by_radius = np.stack([u1**2, 2 * radius * u1 * u2, -((radius * u2) ** 2)], axis=-1)
        gaussian, mean = alpha / beta, 0.5 * ((1 + gamma**2) / beta + alpha)
        by_gaussian = np.stack([-gaussian / beta, np.zeros_like(beta), 1 / beta], axis=-1)
        by_mean = np.stack([-0.5 * (1 + gamma**2) / beta**2, gamma / beta, np.full_like(beta, 0.5)], axis=-1)
        found: dict[str, Array] = {
            "principal_curvatures": np.where(known[:, None], curvature, 0.0),
            "sigma_curvatures": _sigma(by_curvature, covariance, known[:, None]),
            "principal_radii": np.where(known[:, None], radius, 0.0),
            "sigma_radii": _sigma(by_radius, covariance, known[:, None]),
            "gaussian": np.where(known, gaussian, 0.0),
            "sigma_gaussian": _sigma(by_gaussian, covariance, known),
            "mean": np.where(known, mean, 0.0),
            "sigma_mean": _sigma(by_mean, covariance, known),
        }
    return found | {"principal_directions": direction @ axes}


def kinds(beta: Array, alpha: Array, covariance: Array, valid: np.ndarray, known: np.ndarray) -> np.ndarray:
    """What 95 % confidence allows to say of points: strings (n,) of KINDS."""
    fixed = valid & (np.abs(beta) < CONFIDENT * np.sqrt(covariance[:, 0, 0]))
    flat = known & (np.abs(alpha) < CONFIDENT * np.sqrt(covariance[:, 2, 2]))
    kind = np.where(alpha * beta > 0, "elliptic", "hyperbolic")
    kind = np.where(flat, "parabolic", kind)
    return np.where(fixed, "fixed curve", np.where(known, kind, "undetermined")).astype("U12")


def _eigen(beta: Array, gamma: Array, alpha: Array) -> tuple[Array, Array]:
    """Eigenvalues (n, 2) of beta S and unit eigenvectors (n, 2, 2), ordered so that mu / beta rises."""
    corner = alpha * beta + gamma**2
    half, spread = 0.5 * (1 + corner), np.hypot(0.5 * (1 - corner), gamma)
    largest = half + np.where(half < 0, -spread, spread)
    smallest = alpha * beta / largest
    upper, lower = np.maximum(largest, smallest), np.minimum(largest, smallest)
    angle = 0.5 * np.arctan2(-2 * gamma, 1 - corner)
    of_upper = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    of_lower = np.stack([-np.sin(angle), np.cos(angle)], axis=-1)
    mu, u = np.stack([lower, upper], axis=1), np.stack([of_lower, of_upper], axis=1)
    falls = beta < 0
    return np.where(falls[:, None], mu[:, ::-1], mu), np.where(falls[:, None, None], u[:, ::-1], u)


def _sigma(gradient: Array, covariance: Array, known: np.ndarray) -> Array:
    """Standard deviation of what has this gradient (n, ..., 3); infinite where not known."""
    C = covariance if gradient.ndim == 2 else covariance[:, None]
    variance = np.einsum("...i,...ij,...j->...", gradient, C, gradient)
    return np.where(known & np.isfinite(variance), np.sqrt(np.maximum(variance, 0)), np.inf)
