"""The osculating circle of an epipolar section, from its tangents in three or more views (Cipolla ch. 3, eq. 3.21-3.23).

In the epipolar plane, with N_i the normal of ray i and v_i its camera centre, every ray is a tangent of the
section, and a circle with centre p0 and signed radius R touches them all where

    p0 . N_i + R = v_i . N_i                                                       (3.23)

All normals point to the side to which the camera travels. Hence R > 0 where that is the outside of the surface,
R < 0 where the surface lies on that side, and R = 0 for a fixed feature: the rays meet in one point.

With phi_i the angle from N_0 to N_i and the origin on the first ray, near the contact point, (3.23) reads

    s + q sin(phi_i) - c (1 - cos(phi_i)) = v_i . N_i,      p0 = c N_0 + q T_0,  R = s - c

whose columns are of order 1, phi, phi^2: once scaled, the normal equations are well conditioned however short the
motion is.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from extremal.estimator.camera import Array
from extremal.estimator.errors import DegenerateGeometry, InvalidInput

BLOCK = 4096  # circles solved at once: their intermediate arrays stay in the processor's cache
SINGULAR = 1e-14  # determinant of the scaled normal equations that is rounding alone
SMALLEST_ARC = 1e-7  # [rad] total turn of the rays below which they count as parallel


@dataclass(frozen=True, eq=False)
class OsculatingCircle:
    """Circles, each in its epipolar plane; leading axes (...) as in the call that made them.

    Attributes:
        radius: (...) signed radius of curvature R [m].
        sigma_radius: (...) its standard deviation [m]; infinite where it is not known.
        centre: (..., 3) centre p0 [m].
        normals: (..., V, 3) unit normals N_i in the epipolar plane, to the side to which the camera travels.
        points: (..., V, 3) contact points p0 + R N_i [m] (eq. 3.21).
        valid: (...) whether the rays determine the circle.
        distances: (..., V) distance from camera centre to contact point [m].
        gain: (..., 3, V) change of (s, q, c) per metre of displacement of ray i along N_i.
        residuals: (..., V) v_i.N_i - p0.N_i - R [m]: what the circle leaves of each ray.
        plane_normals: (..., 3) unit normals of the epipolar planes; rotating a ray about it by +delta moves it by
            -distance * delta along N_i.
        sigma_depth: (...) standard deviation [m] of the first contact point along its ray.
        sigma_across: (...) standard deviation [m] of the first contact point across its ray, in the plane.
    """

    radius: Array
    sigma_radius: Array
    centre: Array
    normals: Array
    points: Array
    valid: np.ndarray
    distances: Array
    gain: Array
    residuals: Array
    plane_normals: Array
    sigma_depth: Array
    sigma_across: Array

    @property
    def radius_gradient(self) -> Array:
        """(..., V) change of R per metre of displacement of ray i along N_i (for eq. 3.25 and 3.26)."""
        return self.gain[..., 0, :] - self.gain[..., 2, :]


def osculating_circle(
    centres: ArrayLike,
    rays: ArrayLike,
    ray_sigma: ArrayLike | None = None,
    plane_normals: ArrayLike | None = None,
) -> OsculatingCircle:
    """Circles tangent to the rays of V >= 3 views: exact for three, weighted least squares for more.

    Args:
        centres: (..., V, 3) camera centres v_i [m].
        rays: (..., V, 3) unit rays; leading axes broadcast against those of `centres`.
        ray_sigma: (..., V) standard deviation [rad] of each ray's angle in the epipolar plane; infinite for a ray
            that is to be left out. Without it, more than three rays are weighed alike and sigma comes from their
            residuals; for three it is infinite.
        plane_normals: (..., 3) epipolar planes onto which centres and rays are projected. By default that of the
            first two centres and the first ray: exact for linear motion, the trinocular approximation of
            Vaillant and Faugeras for any other.

    Returns:
        The circles. A row without a circle (zero baseline, parallel rays, contact behind a camera, numbers that
        are not finite) has `valid` False, infinite sigma and zeros elsewhere.

    Raises:
        InvalidInput: shapes that do not fit, or ray_sigma that is not positive.
        DegenerateGeometry: fewer than three views.
    """
    v, p, sigma, m, shape = _checked(centres, rays, ray_sigma, plane_normals)
    count, views = p.shape[1], p.shape[2]
    out = {name: np.zeros((*lead, count)) for name, lead in _outputs(views).items()}

    def solve(start: int) -> None:
        block = slice(start, start + BLOCK)
        solved = _solve_block(
            v[..., block, :] if v.shape[1] > 1 else v,
            p[:, block],
            None if sigma is None else sigma[block],
            None if m is None else m[:, block],
        )
        for name, values in solved.items():
            out[name][..., block] = values

    starts = range(0, count, BLOCK)
    if len(starts) > 4:
        with ThreadPoolExecutor(2) as pool:
            list(pool.map(solve, starts))
    else:
        for start in starts:
            solve(start)
    batched: dict[str, Any] = {k: np.moveaxis(a, -1, 0).reshape(shape + a.shape[:-1]) for k, a in out.items()}
    return OsculatingCircle(**(batched | {"valid": batched["valid"] > 0}))


def _outputs(views: int) -> dict[str, tuple[int, ...]]:
    scalars = ("radius", "sigma_radius", "valid", "sigma_depth", "sigma_across")
    per_view = ("distances", "residuals")
    return (
        {name: () for name in scalars}
        | {name: (views,) for name in per_view}
        | {
            "centre": (3,),
            "plane_normals": (3,),
            "gain": (3, views),
            "normals": (views, 3),
            "points": (views, 3),
        }
    )


def _checked(
    centres: ArrayLike, rays: ArrayLike, ray_sigma: ArrayLike | None, plane_normals: ArrayLike | None
) -> tuple[Array, Array, Array | None, Array | None, tuple[int, ...]]:
    """Inputs as component arrays: v and p (3, n, V) (n = 1 where shared), sigma (n, V), planes (3, n)."""
    v, p = np.asarray(centres, float), np.asarray(rays, float)
    if v.ndim < 2 or p.ndim < 2 or v.shape[-1] != 3 or p.shape[-1] != 3 or v.shape[-2] != p.shape[-2]:
        raise InvalidInput(f"centres {v.shape} and rays {p.shape}; accepted: (..., V, 3) with the same V")
    views = p.shape[-2]
    if views < 3:
        raise DegenerateGeometry(f"{views} views given; a circle needs at least three")
    try:
        shape = np.broadcast_shapes(v.shape[:-2], p.shape[:-2])
        p = np.broadcast_to(p, (*shape, views, 3)).reshape(-1, views, 3)
        if v.ndim > 2:
            v = np.broadcast_to(v, (*shape, views, 3))
        sigma = m = None
        if ray_sigma is not None:
            sigma = np.broadcast_to(np.asarray(ray_sigma, float), (*shape, views)).reshape(-1, views)
        if plane_normals is not None:
            m = np.broadcast_to(np.asarray(plane_normals, float), (*shape, 3)).reshape(-1, 3).T
    except ValueError as error:
        raise InvalidInput(
            f"shapes of centres, rays, ray_sigma and plane_normals do not fit: {error}"
        ) from None
    if sigma is not None and not np.all(sigma > 0):
        raise InvalidInput("ray_sigma must be positive [rad]")
    return np.moveaxis(v.reshape(-1, views, 3), -1, 0), np.moveaxis(p, -1, 0), sigma, m, shape


def _dot(a: Array, b: Array) -> Array:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: Array, b: Array) -> Array:
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _solve_block(v: Array, p: Array, sigma: Array | None, m: Array | None) -> dict[str, Array]:
    """Circles of one block; v, p (3, n, V), sigma (n, V), m (3, n). Views lead from here on: (3, V, n)."""
    with np.errstate(all="ignore"):  # rows that fail are found below, by their values
        v, p = np.ascontiguousarray(np.swapaxes(v, 1, 2)), np.ascontiguousarray(np.swapaxes(p, 1, 2))
        travel = v[:, -1] - v[:, 0]
        m = _cross(v[:, 1] - v[:, 0], p[:, 0]) if m is None else m
        m = m / np.sqrt(_dot(m, m))
        p = p - m[:, None] * _dot(m[:, None], p)
        p = p / np.sqrt(_dot(p, p))
        normals = _cross(p, m[:, None])
        side = np.where(_dot(normals[:, 0], travel) < 0, -1.0, 1.0)
        m, normals = m * side, normals * side
        # origin: on the first ray, where the last one meets it
        offset = _dot(travel[:, None], normals[:, -1:])[0]
        depth0 = offset / _dot(p[:, 0], normals[:, -1])
        origin = v[:, 0] + depth0 * p[:, 0]
        support = _dot(v - origin[:, None], normals)
        sine = -_dot(normals, p[:, :1])  # T_0 = -p_0, so that N turns towards it as the camera travels on
        versine = 1 - _dot(normals, normals[:, :1])
        versine = np.where(versine < 0.1, sine**2 / (1 + np.sqrt(np.maximum(1 - sine**2, 0))), versine)
        columns = np.stack([np.ones_like(sine), sine, -versine])
        distance = _dot(origin[:, None] - v, p)
        weights = None if sigma is None else 1 / (sigma.T * distance) ** 2
        solution, gain, inverse = _least_squares(columns, support, weights)
        s, q, c = solution
        radius = s - c
        centre = origin + c * normals[:, 0] - q * p[:, 0]
        residuals = support - (s + q * sine - c * versine)
        points = centre[:, None] + radius * normals
        distances = _dot(points - v, p)
        variance_scale = np.ones_like(radius)
        if sigma is None:
            freedom = len(sine) - 3
            variance_scale = (
                np.sum(residuals**2, axis=0) / freedom if freedom else np.full_like(radius, np.inf)
            )
        elif len(sine) == 3:  # exact solution: weights did not matter, so take them at the contact points
            inverse = _propagated(gain, sigma.T * distances)
        sigma_radius = np.sqrt((inverse[0, 0] + inverse[2, 2] - 2 * inverse[0, 2]) * variance_scale)
        sigma_depth = np.sqrt(inverse[1, 1] * variance_scale)
        sigma_across = np.sqrt(inverse[0, 0] * variance_scale)
        arc = np.abs(np.arctan2(sine, 1 - versine)).max(axis=0)
        valid = (arc > SMALLEST_ARC) & np.all(distances > 0, axis=0) & np.isfinite(radius)
        valid &= np.all(np.isfinite(gain), axis=(0, 1)) & ~np.isnan(sigma_radius)
        out = {
            "radius": radius,
            "sigma_radius": sigma_radius,
            "centre": centre,
            "normals": np.moveaxis(normals, 0, 1),
            "points": np.moveaxis(points, 0, 1),
            "distances": distances,
            "gain": gain,
            "residuals": residuals,
            "plane_normals": m,
            "sigma_depth": sigma_depth,
            "sigma_across": sigma_across,
        }
        out = {k: np.where(valid, a, np.inf if k.startswith("sigma") else 0.0) for k, a in out.items()}
        return out | {"valid": valid}


def _least_squares(columns: Array, support: Array, weights: Array | None) -> tuple[Array, Array, Array]:
    """Solution (3, n), gain (3, V, n) = d solution / d support and inverse normal matrix (3, 3, n)."""
    weighted = columns if weights is None else columns * weights
    n00, n01, n02 = (np.sum(weighted[0] * columns[k], axis=0) for k in range(3))
    n11, n12 = (np.sum(weighted[1] * columns[k], axis=0) for k in (1, 2))
    n22 = np.sum(weighted[2] * columns[2], axis=0)
    # scaling the columns keeps the determinant of short arcs away from underflow
    d0, d1, d2 = (1 / np.sqrt(n) for n in (n00, n11, n22))
    a, b, c = n01 * d0 * d1, n02 * d0 * d2, n12 * d1 * d2
    i00, i01, i02 = 1 - c * c, b * c - a, a * c - b
    i11, i12, i22 = 1 - b * b, a * b - c, 1 - a * a
    determinant = i00 + a * i01 + b * i02
    determinant = np.where(determinant > SINGULAR, determinant, np.nan)  # fewer than three different rays
    d0, d1, d2 = (d / np.sqrt(determinant) for d in (d0, d1, d2))
    i01, i02, i12 = i01 * d0 * d1, i02 * d0 * d2, i12 * d1 * d2
    i00, i11, i22 = i00 * d0 * d0, i11 * d1 * d1, i22 * d2 * d2
    inverse = np.stack([np.stack([i00, i01, i02]), np.stack([i01, i11, i12]), np.stack([i02, i12, i22])])
    gain = np.stack([sum(inverse[r, k] * weighted[k] for k in range(3)) for r in range(3)])
    return np.sum(gain * support, axis=1), gain, inverse


def _propagated(gain: Array, sigma: Array) -> Array:
    """Covariance (3, 3, n) of the solution for standard deviations (V, n) of the supports (eq. 3.26)."""
    scaled = gain * sigma
    return np.sum(scaled[:, None] * scaled[None], axis=2)
