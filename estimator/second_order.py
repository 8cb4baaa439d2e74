"""Contact point and second fundamental form from the tangent planes of all views, for any motion (DESIGN, equation 3).

Every edgel is one tangent plane of the object. In the frame of a contour point (outward normal n, ray t1, contour's
tangent t2 = the tangent of the apparent contour lifted to the surface) the surface has, to second order,

    beta   radius of curvature of its normal section along the ray, which the motion shows,
    alpha  curvature of its contour seen along the ray, which one image shows but for the distance,
    gamma  how far the contour generator turns from t2 towards the ray,

    second fundamental form  S = [[1 / beta, -gamma / beta], [-gamma / beta, alpha + gamma^2 / beta]]
    radii of curvature       B = [[beta + gamma^2 / alpha, gamma / alpha], [gamma / alpha, 1 / alpha]] = S^-1

and K = alpha / beta (Koenderink 1984). A fixed curve has beta = 0, where S has no values; a parabolic point
alpha = 0, where B has none; alpha, beta and gamma, which are what is measured, are finite for both.

**The outside.** For an opaque surface beta is never negative seen from outside. Where it differs from 0 the normal is
turned so that it is positive: the motion tells the side on which the surface lies (Cipolla ch. 3). A fixed feature has
no outside, and keeps the normal that it was given with.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from extremal.estimator.camera import Array
from extremal.estimator.errors import DegenerateGeometry, InvalidInput
from extremal.estimator.fundamental_form import curvatures, kinds
from extremal.estimator.parallel_sections import Edgels
from extremal.estimator.section_fit import BROAD, UNKNOWN, SectionFit, fit_sections

BLOCK = 128  # points solved at once
FEWEST = 7  # edgels
CONVERGED = 0.3  # last step, in standard deviations of the whole fit
WORST_MISFIT = 4.0  # chi2 per degree of freedom above which the edgels belong to no smooth surface
CORNER = 0.1  # [rad] scatter of the tangents of edgels at one point from which it is no curve's


@dataclass(frozen=True, eq=False)
class SecondOrderShape:
    """Surfaces to second order at contour points; leading axes (...) as in the call that made them.

    What is not determined is zero (`principal_curvatures` and `principal_radii`: infinite where they are), with an
    infinite standard deviation.

    Attributes:
        position: (..., 3) contact point [m]. It lies in the plane of the ray and the normal that were given, by definition.
        frame: (..., 3, 3) rows: unit outward normal n, ray t1, tangent of the contour t2.
        ray_radius: (...) beta [m]; positive, but for the noise of a fixed feature.
        skew: (...) gamma.
        contour_curvature: (...) alpha [1/m].
        covariance: (..., 6, 6) of position along n [m], position along t1 [m], tilt of n towards t2 [rad], beta, gamma,
            alpha.
        principal_curvatures: (..., 2) [1/m], the smaller first; positive where convex seen from outside.
        sigma_curvatures: (..., 2) their standard deviations.
        principal_radii: (..., 2) [m] their inverses, in the same order.
        sigma_radii: (..., 2) their standard deviations.
        principal_directions: (..., 2, 3) unit tangents of the surface, in the same order.
        gaussian, sigma_gaussian: (...) Gaussian curvature K [1/m^2].
        mean, sigma_mean: (...) mean curvature H [1/m].
        kind: (...) what 95 % confidence allows to say: "elliptic", "hyperbolic", "parabolic", "fixed curve", "fixed point" or
            "undetermined".
        misfit: (...) chi2 per degree of freedom; where it exceeds 1 by more than chance the covariance has grown by it.
        valid: (...) whether the edgels determine position and beta.
    """

    position: Array
    frame: Array
    ray_radius: Array
    skew: Array
    contour_curvature: Array
    covariance: Array
    principal_curvatures: Array
    sigma_curvatures: Array
    principal_radii: Array
    sigma_radii: Array
    principal_directions: Array
    gaussian: Array
    sigma_gaussian: Array
    mean: Array
    sigma_mean: Array
    kind: np.ndarray
    misfit: Array
    valid: np.ndarray

    @property
    def position_covariance(self) -> Array:
        """(..., 3, 3) [m^2] in the world: none across the plane that defines the point."""
        axes = self.frame[..., :2, :]
        with np.errstate(invalid="ignore"):
            covariance = np.swapaxes(axes, -1, -2) @ self.covariance[..., :2, :2] @ axes
        return np.where(np.isnan(covariance), np.inf, covariance)


def second_order_shape(
    centres: ArrayLike, rays: ArrayLike, normals: ArrayLike, sigma: ArrayLike
) -> SecondOrderShape:
    """Second-order shape at the first edgel of each row, from all edgels around it (see `surroundings`).

    Signed image distances of the edgels from the predicted apparent contours are minimised, so that their tangents,
    which are noisy, serve as a start alone.

    Args:
        centres: (..., M, 3) camera centres [m].
        rays: (..., M, 3) unit rays.
        normals: (..., M, 3) unit normals of the planes through ray and contour's tangent; their sign does not matter.
        sigma: (..., M) standard deviation [rad] of each ray's angle across the contour; infinite for an edgel that is
            left out.

    Returns:
        The shapes. A row that is not determined (one camera centre, motion along the ray, edgels of no smooth surface)
        has `valid` False and an infinite covariance.

    Raises:
        InvalidInput: shapes that do not fit, numbers that are not finite, sigma that is not positive.
        DegenerateGeometry: fewer than FEWEST edgels a row.
    """
    v, p, n, s, shape = _checked(centres, rays, normals, sigma)
    blocks = [_solve_block(*(a[i : i + BLOCK] for a in (v, p, n, s))) for i in range(0, len(s), BLOCK)]
    merged: dict[str, Any] = {
        k: np.concatenate([b[k] for b in blocks]).reshape(shape + blocks[0][k].shape[1:]) for k in blocks[0]
    }
    return SecondOrderShape(**merged)


def _checked(
    centres: ArrayLike, rays: ArrayLike, normals: ArrayLike, sigma: ArrayLike
) -> tuple[Array, Array, Array, Array, tuple[int, ...]]:
    v, p, n = (np.asarray(a, float) for a in (centres, rays, normals))
    s = np.asarray(sigma, float)
    if s.ndim < 1 or any(a.shape != (*s.shape, 3) for a in (v, p, n)) or s.size == 0:
        raise InvalidInput(
            f"centres {v.shape}, rays {p.shape}, normals {n.shape} and sigma {s.shape}; "
            "accepted: (..., M, 3) for the vectors and (..., M) for sigma, not empty"
        )
    if s.shape[-1] < FEWEST:
        raise DegenerateGeometry(f"{s.shape[-1]} edgels a point given; at least {FEWEST} are needed")
    if not np.all(s > 0):
        raise InvalidInput(f"sigma holds {s[~(s > 0)][0]}; accepted: positive angles [rad]")
    for name, a in (("centres", v), ("rays", p), ("normals", n)):
        if not np.all(np.isfinite(a)):
            raise InvalidInput(f"{name} holds a number that is not finite")
    for name, a in (("rays", p), ("normals", n)):
        length = np.linalg.norm(a, axis=-1)
        if np.any(np.abs(length - 1) > 1e-6):
            raise InvalidInput(
                f"{name} holds a vector of length {length.ravel()[np.argmax(np.abs(length - 1))]}; 1 is accepted"
            )
    m = s.shape[-1]
    return v.reshape(-1, m, 3), p.reshape(-1, m, 3), n.reshape(-1, m, 3), s.reshape(-1, m), s.shape[:-1]


def _solve_block(v: Array, p: Array, n: Array, sigma: Array) -> dict[str, Array]:
    """Results by name of points (n,) with edgels (n, M)."""
    frame = _frame(p[:, 0], n[:, 0])
    n = n * np.where(np.einsum("nmk,nk->nm", n, frame[:, 0]) < 0, -1.0, 1.0)[..., None]
    weight = 1 / sigma
    depth, ahead = _rough_depth(v, p, n, weight)
    origin = v[:, 0] + depth[:, None] * p[:, 0]
    with np.errstate(all="ignore"):  # rows that fail are found below, by their values
        local = (np.einsum("nij,nmj->nmi", frame, a) for a in (v - origin[:, None], p, n))
        centres, rays, normals = local
        fit = fit_sections(Edgels(centres, rays, weight), normals)
        out = _described(fit, frame, origin, ahead)
        _mark_fixed_points(out, v, p, normals, weight, ahead)
    return out


def _frame(ray: Array, normal: Array) -> Array:
    """Rows n0, e1, e2 (n, 3, 3): the normal made orthogonal to the ray, the ray, the contour's tangent."""
    across = normal - np.sum(normal * ray, axis=-1, keepdims=True) * ray
    length = np.linalg.norm(across, axis=-1, keepdims=True)
    if np.any(length < 0.1):
        raise InvalidInput(
            "a normal is nearly parallel to its ray; accepted: normals of planes through the rays"
        )
    return np.stack([across / length, ray, np.cross(across / length, ray)], axis=1)


def _rough_depth(v: Array, p: Array, n: Array, weight: Array) -> tuple[Array, np.ndarray]:
    """Distance (n,) [m] along the first rays at which the planes come nearest; whether it is known and ahead."""
    slope = np.einsum("nmk,nk->nm", n, p[:, 0]) * weight
    offset = np.einsum("nmk,nmk->nm", n, v - v[:, :1]) * weight
    square = np.sum(slope**2, axis=1)
    depth = np.sum(slope * offset, axis=1) / np.where(square > 0, square, 1.0)
    ahead = (depth > 1e-3) & np.isfinite(depth)
    return np.where(ahead, depth, 1.0), ahead


def _described(fit: SectionFit, frame: Array, origin: Array, ahead: np.ndarray) -> dict[str, Array]:
    """What the terms (height, depth, slope, beta, gamma, -alpha in the frame of the start) mean."""
    terms = np.where(np.isfinite(fit.terms), fit.terms, 0.0)
    height, depth, slope = terms[:, 0], terms[:, 1], terms[:, 2]
    w = np.sqrt(1 + slope**2)  # of the frame at the estimate, whose normal is (n0 - slope e2) / w
    freedom = np.maximum(fit.used - 6, 1)
    misfit = fit.chi2 / freedom
    gain = np.stack([w**0, w**0, -1 / w**2, w, 1 / w, -1 / w**3], axis=1)
    outward = np.where(terms[:, 3] < 0, -1.0, 1.0)
    sigma = np.sqrt(np.einsum("nii->ni", fit.covariance))
    turns = np.where(np.abs(terms[:, 3]) > 1.96 * sigma[:, 3], outward, 1.0)
    gain *= np.where((turns < 0)[:, None], [-1.0, 1, -1, -1, 1, -1], 1.0)
    inflation = np.where(misfit > 1 + 3 * np.sqrt(2 / freedom), misfit, 1.0)
    covariance = fit.covariance * (gain[:, :, None] * gain[:, None, :] * inflation[:, None, None])
    unknown = ~(sigma < UNKNOWN * BROAD)
    valid = ahead & (fit.step < CONVERGED) & (misfit < WORST_MISFIT)
    valid &= (fit.used >= FEWEST) & ~unknown[:, [0, 1, 3]].any(axis=1)
    unknown |= ~valid[:, None]
    covariance[unknown[:, :, None] | unknown[:, None, :]] = 0.0
    covariance[:, np.arange(6), np.arange(6)] = np.where(unknown, np.inf, np.einsum("nii->ni", covariance))
    normal = (frame[:, 0] - slope[:, None] * frame[:, 2]) / w[:, None] * turns[:, None]
    tangent = (frame[:, 2] + slope[:, None] * frame[:, 0]) / w[:, None]
    position = origin + height[:, None] * frame[:, 0] + depth[:, None] * frame[:, 1]
    beta, gamma, alpha = np.where(unknown, 0.0, terms * gain)[:, 3:].T
    shape, known = covariance[:, 3:, 3:], ~unknown.any(axis=1)
    axes = np.stack([frame[:, 1], tangent], axis=1)
    return {
        "position": np.where(valid[:, None], position, 0.0),
        "frame": np.concatenate([normal[:, None], axes], axis=1),
        "ray_radius": beta,
        "skew": gamma,
        "contour_curvature": alpha,
        "covariance": covariance,
        "misfit": misfit,
        "valid": valid,
        "kind": kinds(beta, alpha, shape, valid, known),
        **curvatures(beta, gamma, alpha, shape, axes, known),
    }


def _mark_fixed_points(
    out: dict[str, Array], v: Array, p: Array, normals: Array, weight: Array, ahead: np.ndarray
) -> None:
    """Rows whose rays all meet in one point, with tangents of more than one curve: B = 0 there.

    `normals` (n, M, 3) are in the frames of the points. Those of one curve differ by its turn along the ray, to first
    order, and by nothing else.
    """
    across = np.eye(3) - p[..., :, None] * p[..., None, :]
    distance = np.linalg.norm(v - out["position"][:, None], axis=-1)
    information = across * ((weight / np.maximum(distance, 1e-3)) ** 2)[..., None, None]
    total = information.sum(axis=1) + 1e-9 * np.eye(3)
    point = np.linalg.solve(total, np.einsum("nmij,nmj->ni", information, v)[..., None])[..., 0]
    offset = np.einsum("nmij,nmj->nmi", across, point[:, None] - v)
    distance = np.linalg.norm(point[:, None] - v, axis=-1)
    used = np.count_nonzero(weight, axis=1)
    chi2 = np.sum((np.linalg.norm(offset, axis=-1) * weight / distance) ** 2, axis=1)
    phi = np.arctan2(normals[..., 1], normals[..., 0])
    tilt = normals[..., 2] / np.hypot(normals[..., 0], normals[..., 1])
    here = ahead & (chi2 < 2 * (2 * used - 3)) & (_scatter(phi, tilt, weight > 0) > CORNER)
    covariance = out["frame"] @ np.linalg.inv(total) @ np.swapaxes(out["frame"], 1, 2)
    out["position"][here] = point[here]
    out["covariance"][here] = np.diag([0.0, 0, np.inf, np.inf, np.inf, np.inf])
    out["covariance"][here, :2, :2] = covariance[here, :2, :2]
    out["kind"][here], out["valid"][here] = "fixed point", True
    for name in ("ray_radius", "skew", "contour_curvature", "gaussian", "mean", "principal_radii"):
        out[name][here] = 0.0
    for name in ("sigma_curvatures", "sigma_radii", "sigma_gaussian", "sigma_mean", "principal_curvatures"):
        out[name][here] = np.inf


def _scatter(x: Array, y: Array, present: np.ndarray) -> Array:
    """Standard deviation (n,) of y about its line over x, of those present (n, M)."""
    count = np.maximum(present.sum(axis=1), 1)
    x, y = (np.where(present, a - (np.sum(a * present, axis=1) / count)[:, None], 0.0) for a in (x, y))
    slope = np.sum(x * y, axis=1) / np.maximum(np.sum(x * x, axis=1), 1e-12)
    return np.sqrt(np.sum((y - slope[:, None] * x) ** 2 * present, axis=1) / count)
