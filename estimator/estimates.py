"""What tracks tell of shape with the poses as believed: osculating circles, absolute and by parallax."""

from dataclasses import dataclass, replace

import numpy as np

from extremal.estimator.camera import Array, View
from extremal.estimator.circle import OsculatingCircle, osculating_circle
from extremal.estimator.contours import SYSTEMATIC
from extremal.estimator.epipolar import Sequence3D
from extremal.estimator.pooling import window_sum
from extremal.estimator.poses import PosePrior
from extremal.estimator.references import bootstrap
from extremal.estimator.section import varying_sections
from extremal.estimator.tracking import Tracks
from extremal.estimator.uncertainty import pose_angle_sigma, pose_gradient

LEAST_VIEWS = 3
POOLED = 3  # neighbours on each side along the contour that share their misfit
DRIFT = (
    0.1  # [px/rad^2] how an edge's bias bends as the view turns about a shaded surface: it enters R as it is
)
OUTLIER = 4.0  # standard deviations of a ray's residual beyond which its view is dropped
OVERLAP = 3.0  # neighbouring edgels that a spline ties together
REPEATING = 0.05  # [rad] turn of the view within which what models of shading leave of an edge stays alike
SHADED = 0.5  # evidence of a limb from which a point is hardly a fixed feature
FIXED_PRIOR, SHADED_PRIOR = 0.6, 0.1  # probability of a fixed feature before its motion is looked at
REFERENCES = 1 / 3  # of the fixed points, the best known, serve as references for parallax


@dataclass(frozen=True, eq=False)
class Estimate:
    """Shape at n tracked points.

    radius, sigma_radius: (n,) [m] by which a point is labelled. relative, sigma_relative: (n,) [m] to the point relative_to
    (n,), -1 without. position: (n, 3) [m], covariance: (n, 3, 3) [m^2], in the reference view. seen: (n, V) rays that were
    used. valid: (n,). T_world_camera of the reference view is that of the tracks.
    """

    radius: Array
    sigma_radius: Array
    relative: Array
    sigma_relative: Array
    relative_to: np.ndarray
    position: Array
    covariance: Array
    seen: np.ndarray
    valid: np.ndarray


@dataclass(frozen=True, eq=False)
class Circles:
    """Osculating circles of n tracks with the poses as believed; views in the order `order`, the reference first."""

    order: np.ndarray
    circles: OsculatingCircle
    seen: np.ndarray  # (n, V) rays that the circles use
    sigma: Array  # (n, V) [rad] from the image alone; infinite where not seen
    inflation: Array  # (n,) factor on all variances, for what the circle leaves of the rays


def fit_circles(views: list[View], sequence: Sequence3D, tracks: Tracks) -> Circles:
    """Circles with the poses' uncertainty in the weights; the worst outliers of each left out."""
    order = np.array([tracks.reference, *(i for i in range(len(views)) if i != tracks.reference)])
    ordered = [views[i] for i in order]
    centres, rays, sigma = sequence.centres[order], tracks.rays[:, order], tracks.sigma[:, order]
    seen, tangent_planes = tracks.seen[:, order].copy(), tracks.tangent_planes[:, order]
    circles = osculating_circle(centres, rays, sigma, tracks.planes.normal)
    sigma = np.hypot(sigma, _repeated(circles, tangent_planes, ordered[0].camera.fx))
    total = np.hypot(sigma, pose_angle_sigma(circles, ordered, tangent_planes))
    for _ in range(2):
        residual = np.where(
            seen, np.abs(circles.residuals) / (total * np.maximum(circles.distances, 1e-6)), 0.0
        )
        worst = (residual > OUTLIER) & (residual == residual.max(axis=1, keepdims=True))
        worst[:, 0] = False
        worst[seen.sum(axis=1) <= LEAST_VIEWS] = False
        seen &= ~worst
        total = np.where(seen, total, np.inf)
        circles = osculating_circle(centres, rays, total, tracks.planes.normal)
    weight = np.where(seen, 1 / (total * np.maximum(circles.distances, 1e-6)), 0.0)
    inflation = misfit(weight * circles.residuals, seen, tracks.contour)
    circles = varying_sections(circles, weight, tracks.contour)
    return Circles(order, circles, seen, np.where(seen, sigma, np.inf), inflation)


def _repeated(circles: OsculatingCircle, tangent_planes: Array, fx: float) -> Array:
    """What to add (n, V) [rad] to sigma in quadrature where views lie so close that what models of shading leave of an edge
    is alike in them: as many views as the arc holds average it, not more."""
    views = circles.normals.shape[1]
    cosine = np.sum(circles.normals[:, :1] * circles.normals, axis=-1)
    arc = 2 * np.arccos(np.clip(cosine, -1, 1)).max(axis=1)
    excess = np.sqrt(np.maximum(views / (1 + arc / REPEATING) - 1, 0.0))
    slant = np.abs(np.sum(tangent_planes * circles.normals, axis=-1))
    return SYSTEMATIC / fx * excess[:, None] / np.maximum(slant, 1e-3)


def misfit(residual: Array, seen: np.ndarray, contour: np.ndarray) -> Array:
    """chi2 (n,) per degree of freedom, pooled with the nearest neighbours along the contour; at least 1."""
    chi2, freedom = np.sum(residual**2, axis=1), np.maximum(seen.sum(axis=1) - 3.0, 0.0)
    pooled, _ = window_sum(chi2, contour, POOLED)
    count, _ = window_sum(freedom, contour, POOLED)
    return np.maximum(1.0, pooled / np.maximum(count, 1.0))


def circle_estimate(views: list[View], tracks: Tracks, fit: Circles) -> Estimate:
    """Absolute radii, and relative ones by parallax (2.57-2.59) to bootstrapped references."""
    circles = fit.circles
    ordered = [views[i] for i in fit.order]
    valid = circles.valid & (fit.seen.sum(axis=1) >= LEAST_VIEWS)
    drift = DRIFT * circles.distances[:, 0] / views[0].camera.fx
    sigma_radius = np.hypot(circles.sigma_radius * np.sqrt(fit.inflation), drift)
    weight = np.where(fit.seen, circles.radius_gradient, 0.0) * np.where(fit.seen, fit.sigma, 0.0)
    own = np.sum((weight * circles.distances) ** 2, axis=1) * fit.inflation + drift**2
    gradient = pose_gradient(circles, ordered, tracks.tangent_planes[:, fit.order])
    gradient = np.where(fit.seen[..., None], gradient, 0.0)
    shared = np.einsum("nvi,vik->nvk", gradient, PosePrior.of(ordered).root)
    shared = shared.reshape(len(gradient), shared.shape[1] * shared.shape[2])
    own = np.where(valid, own, np.inf)
    references = bootstrap(circles.radius, own, shared, tracks.contour, fixed_prior(tracks), OVERLAP)
    relative, sigma_relative, relative_to = parallax(circles.radius, own, shared, references.fixed, tracks)
    return Estimate(
        circles.radius,
        sigma_radius,
        relative,
        sigma_relative,
        relative_to,
        circles.points[:, 0],
        _position_covariance(circles, fit),
        fit.seen,
        valid,
    )


def parallax_estimate(estimate: Estimate) -> Estimate:
    """The relative radius takes the place of the absolute one, where a reference is known."""
    known = estimate.relative_to >= 0
    return replace(
        estimate,
        radius=np.where(known, estimate.relative, estimate.radius),
        sigma_radius=np.where(known, estimate.sigma_relative, estimate.sigma_radius),
    )


def fixed_prior(tracks: Tracks) -> Array:
    """Probability (n,) of a fixed feature from shading alone: an extremal boundary is shaded like a limb."""
    return np.where(np.abs(mean_limb(tracks)) < SHADED, FIXED_PRIOR, SHADED_PRIOR)


def mean_limb(tracks: Tracks) -> Array:
    """Mean photometric evidence (n,) of a limb, over the views."""
    return np.sum(tracks.limb * tracks.seen, axis=1) / np.maximum(tracks.seen.sum(axis=1), 1)


def parallax(
    radius: Array, own: Array, shared: Array, references: np.ndarray, tracks: Tracks
) -> tuple[Array, Array, np.ndarray]:
    """R_A - R_B (n,), its sigma and B: the nearest reference in the image on another contour, -1 without.

    Only the better known third of the references serve: what is uncertain in a reference enters every difference. The
    covariances keep what A and B share. `references` (n,) says which points are fixed.
    """
    n = len(radius)
    relative, sigma, chosen = np.full(n, np.nan), np.full(n, np.inf), np.full(n, -1)
    fixed = np.flatnonzero(references)
    if len(fixed) == 0:
        return relative, sigma, chosen
    fixed = fixed[own[fixed] <= np.quantile(own[fixed], REFERENCES)]
    at = tracks.pixels[:, tracks.reference]
    distance = np.linalg.norm(at[:, None] - at[fixed], axis=2)
    distance[tracks.contour[:, None] == tracks.contour[fixed]] = np.inf
    nearest = fixed[np.argmin(distance, axis=1)]
    ok = np.isfinite(distance.min(axis=1))
    variance = own + own[nearest] + np.sum((shared - shared[nearest]) ** 2, axis=1)
    return (
        np.where(ok, radius - radius[nearest], np.nan),
        np.where(ok, np.sqrt(variance), np.inf),
        np.where(ok, nearest, -1),
    )


def _position_covariance(circles: OsculatingCircle, fit: Circles) -> Array:
    """Covariance (n, 3, 3) [m^2] of the contact point in the reference view: along the ray, across it, off the plane."""
    normal, plane = circles.normals[:, 0], circles.plane_normals
    ray = np.cross(plane, normal)
    off = fit.sigma[:, 0] * circles.distances[:, 0]
    terms = ((circles.sigma_depth, ray), (circles.sigma_across, normal), (off, plane))
    with np.errstate(invalid="ignore"):
        outer = [(s**2)[:, None, None] * d[:, :, None] * d[:, None, :] for s, d in terms]
        return np.sum(np.stack(outer), axis=0) * fit.inflation[:, None, None]


def nothing(tracks: Tracks) -> Estimate:
    """An estimate without a valid point."""
    n = len(tracks.seen)
    unknown = np.full(n, np.inf)
    return Estimate(
        np.zeros(n),
        unknown,
        np.full(n, np.nan),
        unknown.copy(),
        np.full(n, -1),
        np.zeros((n, 3)),
        np.full((n, 3, 3), np.inf),
        np.zeros_like(tracks.seen),
        np.zeros(n, bool),
    )
