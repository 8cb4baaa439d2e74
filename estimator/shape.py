"""From views to surface shape: the whole of the estimator in one page (Cipolla ch. 3)."""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from threadpoolctl import threadpool_limits

from extremal.estimator.camera import Array, View
from extremal.estimator.circle import OsculatingCircle, osculating_circle
from extremal.estimator.contours import Contours, find_contours
from extremal.estimator.epipolar import Sequence3D
from extremal.estimator.matching import EdgelMap, reach_of
from extremal.estimator.pooling import window_sum
from extremal.estimator.section import varying_sections
from extremal.estimator.tracking import Tracks, track
from extremal.estimator.uncertainty import pose_angle_sigma, pose_gradient, relative_radius

CONFIDENCE = 1.96  # standard deviations: 95 % (eq. 3.27)
LEAST_VIEWS = 3
POOLED = 3  # neighbours on each side along the contour that share their misfit
LASTING = 0.8  # of the views, the first and the last among them, make a track that lasts the whole sequence
DRIFT = (
    0.1  # [px/rad^2] how an edge's bias bends as the view turns about a shaded surface: it enters R as it is
)
SHADED = 0.5  # evidence of a limb from which a point is no reference for parallax
REFERENCES = 1 / 3  # of the fixed points, the best known, serve as references for parallax
OUTLIER = 4.0  # standard deviations of a ray's residual beyond which its view is dropped


@dataclass(frozen=True, eq=False)
class Shape:
    """n contour points of the reference view, with what their motion through V views tells of the surface.

    Attributes:
        reference: index of the view in which the points are given.
        contour: (n,) index of the image contour in that view. pixels: (n, 2) [px].
        rays: (n, 3) world rays of the points; tangent_planes, epipolar_planes: (n, 3) unit normals through them.
        radius, sigma_radius: (n,) signed radius of curvature R of the epipolar section [m]; its sign as in
            `osculating_circle`.
        relative_radius, sigma_relative_radius: (n,) R minus that of the nearest fixed reference on another contour
            [m]; NaN and infinity where there is none. relative_to: (n,) index of that reference, -1 without.
        position: (n, 3) contact point [m]; covariance: (n, 3, 3) [m^2].
        extremal: (n,) label by eq. 3.27: True where R differs from zero.
        side: (n,) sign of R where extremal, else 0: +1 where the surface lies behind as the camera travels on (its
            outward normal points to the travel), -1 where it lies ahead.
        gaussian_sign: (n,) sign of the Gaussian curvature where extremal, else 0.
        views: (n,) number of views in which the point was seen; complete: (n,) whether its track lasts the whole
            sequence: from the first view to the last, but for short occlusions.
        limb: (n,) mean photometric evidence of a limb.
        tangents: (n, 2) unit tangents [px] of the image contour, the surface to their right where extremal.
    """

    reference: int
    contour: np.ndarray
    pixels: Array
    rays: Array
    tangent_planes: Array
    epipolar_planes: Array
    radius: Array
    sigma_radius: Array
    relative_radius: Array
    sigma_relative_radius: Array
    relative_to: np.ndarray
    position: Array
    covariance: Array
    extremal: np.ndarray
    side: np.ndarray
    gaussian_sign: np.ndarray
    views: np.ndarray
    complete: np.ndarray
    limb: Array
    tangents: Array


def estimate_shape(views: Sequence[View], progress: Callable[[int, int], None] | None = None) -> Shape:
    """Depth, signed radius of curvature and label, with covariance, of every contour point that could be tracked.

    Args:
        views: three or more frames with the poses that the robot believes, in order of the motion.
        progress: called with (frames done, frames) while contours are found.

    Raises:
        DegenerateGeometry: fewer than three views, or a camera that does not move.
    """
    sequence = Sequence3D.of(views)
    with threadpool_limits(1, "blas"):  # many small matrices: views are spread over the processors instead
        contours, maps = _all_contours(views, reach_of(sequence), progress)
        reference = len(views) // 2
        tracks = track(sequence, contours, maps, reference)
        order = np.array([reference, *(i for i in range(len(views)) if i != reference)])
        ordered = [views[i] for i in order]
        return _shape(ordered, tracks, _fit_circles(ordered, sequence, tracks, order), order)


def _all_contours(
    views: Sequence[View], reach: int, progress: Callable[[int, int], None] | None
) -> tuple[list[Contours], list[EdgelMap]]:
    def find(view: View) -> tuple[Contours, EdgelMap]:
        contours = find_contours(view.image, view.camera)
        return contours, EdgelMap(contours, view.camera.width, view.camera.height, reach)

    with ThreadPoolExecutor(min(len(views), os.cpu_count() or 1)) as pool:
        found = []
        for result in pool.map(find, views):
            found.append(result)
            if progress:
                progress(len(found), len(views))
    return [c for c, _ in found], [m for _, m in found]


@dataclass(frozen=True, eq=False)
class _Fit:
    circles: OsculatingCircle  # the reference view first
    seen: np.ndarray  # (n, V) rays that the circles use
    sigma: Array  # (n, V) [rad] from the image alone
    inflation: Array  # (n,) factor on all variances, for what the circle leaves of the rays


def _fit_circles(views: list[View], sequence: Sequence3D, tracks: Tracks, order: np.ndarray) -> _Fit:
    """Osculating circles of the tracks; the poses' uncertainty in the weights, the worst outlier of each left out."""
    centres, rays, sigma = sequence.centres[order], tracks.rays[:, order], tracks.sigma[:, order]
    seen = tracks.seen[:, order].copy()
    circles = osculating_circle(centres, rays, sigma, tracks.planes.normal)
    tangent_planes = tracks.tangent_planes[:, order]
    total = np.hypot(sigma, pose_angle_sigma(circles, views, tangent_planes))
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
    inflation = _misfit(weight * circles.residuals, seen, tracks.contour)
    circles = varying_sections(circles, weight, tracks.contour)
    return _Fit(circles, seen, np.where(seen, sigma, np.inf), inflation)


def _misfit(residual: Array, seen: np.ndarray, contour: np.ndarray) -> Array:
    """chi2 (n,) per degree of freedom, pooled with the nearest neighbours along the contour; at least 1."""
    chi2, freedom = np.sum(residual**2, axis=1), np.maximum(seen.sum(axis=1) - 3.0, 0.0)
    pooled, _ = window_sum(chi2, contour, POOLED)
    count, _ = window_sum(freedom, contour, POOLED)
    return np.maximum(1.0, pooled / np.maximum(count, 1.0))


def _shape(views: list[View], tracks: Tracks, fit: _Fit, order: np.ndarray) -> Shape:
    circles, chosen = fit.circles, np.flatnonzero(fit.circles.valid & (fit.seen.sum(axis=1) >= LEAST_VIEWS))
    drift = DRIFT * circles.distances[:, 0] / views[0].camera.fx
    sigma_radius = np.hypot(circles.sigma_radius * np.sqrt(fit.inflation), drift)
    gradient = pose_gradient(circles, views, tracks.tangent_planes[:, order])
    weight = np.where(fit.seen, circles.radius_gradient, 0.0) * np.where(fit.seen, fit.sigma, 0.0)
    image_variance = np.sum((weight * circles.distances) ** 2, axis=1) * fit.inflation + drift**2
    extremal = np.abs(circles.radius) > CONFIDENCE * sigma_radius
    limb = np.sum(tracks.limb * tracks.seen, axis=1) / tracks.seen.sum(axis=1)
    reference = _nearest_reference(chosen[~extremal[chosen]], image_variance, tracks)
    ok = reference >= 0
    relative, sigma_relative = np.full(len(ok), np.nan), np.full(len(ok), np.inf)
    relative[ok], sigma_relative[ok] = relative_radius(
        circles, image_variance, gradient, views, np.flatnonzero(ok), reference[ok]
    )
    side = np.where(extremal, np.sign(circles.radius), 0).astype(int)
    renumber = np.full(len(ok) + 1, -1)
    renumber[chosen] = np.arange(len(chosen))
    return Shape(
        reference=tracks.reference,
        contour=tracks.contour[chosen],
        pixels=tracks.pixels[chosen, tracks.reference],
        rays=tracks.rays[chosen, tracks.reference],
        tangent_planes=tracks.tangent_planes[chosen, tracks.reference],
        epipolar_planes=tracks.planes.normal[chosen],
        radius=circles.radius[chosen],
        sigma_radius=sigma_radius[chosen],
        relative_radius=relative[chosen],
        sigma_relative_radius=sigma_relative[chosen],
        relative_to=renumber[reference[chosen]],
        position=circles.points[chosen, 0],
        covariance=_position_covariance(circles, fit, tracks)[chosen],
        extremal=extremal[chosen],
        side=side[chosen],
        gaussian_sign=_gaussian_sign(tracks, side)[chosen],
        views=fit.seen.sum(axis=1)[chosen],
        complete=_lasting(tracks.seen)[chosen],
        limb=limb[chosen],
        tangents=(tracks.tangents * np.where(side * tracks.ahead < 0, -1.0, 1.0)[:, None])[chosen],
    )


def _lasting(seen: np.ndarray) -> np.ndarray:
    return seen[:, 0] & seen[:, -1] & (seen.mean(axis=1) >= LASTING)


def _nearest_reference(fixed: np.ndarray, image_variance: Array, tracks: Tracks) -> np.ndarray:
    """Index (n,) of the nearest fixed point in the image on another contour, -1 without; rows `fixed` (k,) are fixed.

    Only the better known third of them serve: what is uncertain in the reference enters every difference.
    """
    reference = np.full(len(image_variance), -1)
    fixed = fixed[np.abs(tracks.limb[fixed]).mean(axis=1) < SHADED]
    if len(fixed) == 0:
        return reference
    fixed = fixed[image_variance[fixed] <= np.quantile(image_variance[fixed], REFERENCES)]
    at = tracks.pixels[:, tracks.reference]
    distance = np.linalg.norm(at[:, None] - at[fixed], axis=2)
    distance[tracks.contour[:, None] == tracks.contour[fixed]] = np.inf
    nearest = np.argmin(distance, axis=1)
    return np.where(np.isfinite(distance.min(axis=1)), fixed[nearest], -1)


def _position_covariance(circles: OsculatingCircle, fit: _Fit, tracks: Tracks) -> Array:
    """Covariance (n, 3, 3) [m^2] of the contact point in the reference view: along the ray, across it, off the plane."""
    normal, plane = circles.normals[:, 0], circles.plane_normals
    ray = np.cross(plane, normal)
    off = fit.sigma[:, 0] * circles.distances[:, 0]
    terms = ((circles.sigma_depth, ray), (circles.sigma_across, normal), (off, plane))
    with np.errstate(invalid="ignore"):
        outer = [(s**2)[:, None, None] * d[:, :, None] * d[:, None, :] for s, d in terms]
        return np.sum(np.stack(outer), axis=0) * fit.inflation[:, None, None]


def _gaussian_sign(tracks: Tracks, side: np.ndarray) -> np.ndarray:
    """Sign (n,) of K: that of the apparent contour's curvature seen from the surface (Koenderink; DESIGN eq. 5).

    The curvature is averaged over the views, in which the contour generator moves but little. It is positive where
    the contour bends towards its bright side, and the surface lies on that side where the image normal, carried into
    the world, points against the outward normal.
    """
    curvature = np.sum(tracks.curvature * tracks.seen, axis=1) / tracks.seen.sum(axis=1)
    bright_is_ahead = np.sign(tracks.ahead)
    return (np.sign(curvature) * np.where(side > 0, -1, 1) * bright_is_ahead * (side != 0)).astype(int)
