"""Joint estimation: poses and shape from the same tracks, with references that bootstrap themselves.

With poses as uncertain as a robot's, tracks first follow what the robot believes. An adjustment with all radii free fixes
the cameras but for what looks like a common change of all radii; features of zero relative R are the fixed ones, and
holding these fixed settles the rest. Contours are then tracked once more with the adjusted poses, which tells
epipolar planes and matches better, and adjusted again, with the robot's prior as it was.
"""

import itertools
from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np

from extremal.estimator.adjustment import STEPS, Adjustment, Shapes, adjust, survey
from extremal.estimator.camera import Array, View
from extremal.estimator.epipolar import EpipolarPlanes, Sequence3D
from extremal.estimator.errors import NotConverged
from extremal.estimator.estimates import (
    DRIFT,
    LEAST_VIEWS,
    OVERLAP,
    SHADED,
    Circles,
    Estimate,
    fit_circles,
    fixed_prior,
    mean_limb,
    misfit,
    nothing,
    parallax,
)
from extremal.estimator.gauge import Gauge, moved_estimate, moved_views
from extremal.estimator.pooling import window_sum
from extremal.estimator.poses import PosePrior
from extremal.estimator.references import bootstrap
from extremal.estimator.section import NEIGHBOURS, pooled_evidence
from extremal.estimator.support import CIRCLE, FIXED, MOST, Sections
from extremal.estimator.tracking import PARALLEL, Tracks

Tracker = Callable[[Sequence3D], Tracks]
LEAST_GUIDES = 6  # unshaded features that suffice to find the cameras
OUTLIER = 6.0  # standard deviations from which a tangent plane is a false match
VARYING_VIEWS = 7  # least number of views for a section whose curvature varies


@dataclass(frozen=True, eq=False)
class _Round:
    """Tracks followed with the poses of `sequence`; those [chosen] as sections, and the adjustment; views as it left them."""

    views: list[View]
    sequence: Sequence3D
    tracks: Tracks
    chosen: np.ndarray
    sections: Sections | None
    adjustment: Adjustment | None
    shapes: Shapes | None


def joint_estimate(
    views: list[View], prior: PosePrior, tracker: Tracker
) -> tuple[list[View], Tracks, Estimate]:
    """Views with adjusted poses, their tracks, and the estimate.

    Args:
        views: with the poses that the robot believes. prior: what is known of these poses.
        tracker: finds the tracks of a sequence.

    Raises NotConverged.
    """
    gauge = Gauge.of(prior)
    first = _round(views, gauge.still, tracker, None)
    second = _round(first.views, gauge.still, tracker, first.adjustment)
    found = second.adjustment
    if found is None:
        return second.views, second.tracks, _estimate(second)
    if not found.converged:
        raise NotConverged(
            f"the joint adjustment of {len(views)} views and {len(second.chosen)} tracks did not settle in {STEPS} steps; "
            "accepted: poses whose errors are as their covariance says, or --estimator circle"
        )
    world, root = gauge.world(found.u, found.root)
    placed = moved_views(second.views, world)
    tracks = _carried(second.tracks, second.sequence, placed)
    return placed, tracks, moved_estimate(_estimate(second), world, root)


def _carried(tracks: Tracks, sequence: Sequence3D, views: list[View]) -> Tracks:
    """The tracks' directions, turned with the cameras from the poses with which they were followed to the adjusted ones."""
    after = np.array([v.T_world_camera.rotation.as_matrix() for v in views])
    turns = after @ np.swapaxes(sequence.rotations, 1, 2)
    turn, planes = turns[tracks.reference], tracks.planes
    turned = EpipolarPlanes(
        views[tracks.reference].centre, turn @ planes.along, planes.across @ turn.T, planes.normal @ turn.T
    )
    rays = np.einsum("vij,nvj->nvi", turns, tracks.rays)
    tangent_planes = np.einsum("vij,nvj->nvi", turns, tracks.tangent_planes)
    return replace(tracks, planes=turned, rays=rays, tangent_planes=tangent_planes)


def _round(views: list[View], prior: PosePrior, tracker: Tracker, start: Adjustment | None) -> _Round:
    sequence = Sequence3D.of(views)
    tracks = tracker(sequence)
    fit = fit_circles(views, sequence, tracks)
    chosen = np.flatnonzero(fit.circles.valid & (fit.seen.sum(axis=1) >= LEAST_VIEWS))
    if len(chosen) == 0:
        return _Round(views, sequence, tracks, chosen, None, None, None)
    sections = sections_of(sequence, tracks, fit, chosen)
    adjustment, sections, shapes = _bootstrapped(prior, sections, tracks, chosen, start.u if start else None)
    return _Round(_moved(views, prior, adjustment), sequence, tracks, chosen, sections, adjustment, shapes)


def sections_of(sequence: Sequence3D, tracks: Tracks, fit: Circles, chosen: np.ndarray) -> Sections:
    """The tracks [chosen] as sections with all radii free: each edgel a tangent plane.

    Contours along their epipolar lines tell nothing of R and hardly where they were crossed; they are left out.
    """
    back = np.argsort(fit.order)
    planes, rays = tracks.planes.normal[chosen], tracks.rays[chosen]
    across = np.cross(rays, planes[:, None])  # in the epipolar plane, perpendicular to the ray
    across *= np.where(across @ sequence.travel < 0, -1.0, 1.0)[..., None]
    normals = tracks.tangent_planes[chosen]
    tilt = np.sum(normals * across, axis=-1) / np.linalg.norm(across, axis=-1)
    normals = normals * np.where(tilt < 0, -1.0, 1.0)[..., None]
    seen = fit.seen[chosen][:, back] & (np.abs(tilt) > PARALLEL)
    sigma = np.where(seen, np.where(seen, fit.sigma[chosen][:, back], 1.0) * np.abs(tilt), np.inf)
    first = across[:, tracks.reference] / np.linalg.norm(across[:, tracks.reference], axis=-1, keepdims=True)
    ray = np.cross(
        planes, np.cross(rays[:, tracks.reference], planes)
    )  # in the plane, also where poses put it a little off
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    return Sections(
        np.einsum("nvk,vkj->nvj", normals, sequence.rotations)[:, None],
        sigma[:, None],
        fit.circles.points[chosen, 0],
        np.stack([first, ray, np.cross(first, ray)], axis=1),
        np.full(len(chosen), CIRCLE),
    )


def _bootstrapped(
    prior: PosePrior, sections: Sections, tracks: Tracks, chosen: np.ndarray, start: Array | None
) -> tuple[Adjustment, Sections, Shapes]:
    """Adjusted cameras, the sections with references held fixed and of the orders that the data call for, their shapes.

    While cameras are adjusted, all other sections may vary as much as they can: a circle that is none would bend the
    cameras' path. With the cameras known, evidence decides on their orders.
    """
    contour = tracks.contour[chosen]
    free = adjust(prior, [sections], OVERLAP, start)
    shape, sections = free.shapes[0], _without_outliers(sections, free.shapes[0])
    fixed = bootstrap(
        shape.radius, shape.own_variance, shape.shared, contour, fixed_prior(tracks)[chosen], OVERLAP
    ).fixed
    many = np.isfinite(sections.sigma[:, 0]).sum(axis=1) >= VARYING_VIEWS
    sections = replace(sections, order=np.where(fixed, FIXED, np.where(many, MOST, CIRCLE)))
    guides = np.flatnonzero(fixed | (np.abs(mean_limb(tracks)[chosen]) < SHADED))
    if len(guides) < LEAST_GUIDES:
        guides = np.arange(len(chosen))
    held = adjust(prior, [sections.take(guides)], OVERLAP, free.u)
    held = adjust(prior, [_without_outliers(sections.take(guides), held.shapes[0])], OVERLAP, held.u)
    sections = _without_outliers(sections, survey(prior, sections, held))
    varying = ~fixed & many
    order, full = _orders(prior, sections, held, varying, contour)
    sections = replace(sections, order=order)
    surveyed = survey(prior, sections, held)
    surveyed = _undecided(surveyed, full, varying, contour)
    return held, sections, _combined(held.shapes[0], surveyed, fixed, guides)


def _undecided(chosen: Shapes, full: Shapes, varying: np.ndarray, contour: np.ndarray) -> Shapes:
    """The chosen shapes with variances widened by what the full order would make of R, beyond what chance does.

    Evidence leaves terms out that are there, but do not stand out; R takes their part. Points of a contour move alike then.
    """
    both = varying & chosen.valid & full.valid
    count = np.maximum(window_sum(both.astype(float), contour, NEIGHBOURS)[0], 1.0)

    def mean(values: Array) -> Array:
        return window_sum(np.where(both, values, 0.0), contour, NEIGHBOURS)[0] / count

    with np.errstate(invalid="ignore"):  # of rows that are not valid
        more = np.maximum(full.own_variance - chosen.own_variance, 0.0)
    shift = mean(full.radius - chosen.radius) ** 2 - mean(more) * OVERLAP / count
    extra = np.where(both, np.maximum(shift, 0.0), 0.0)
    return replace(
        chosen,
        own_variance=chosen.own_variance + extra,
        sigma_radius=np.sqrt(chosen.sigma_radius**2 + extra),
    )


def _combined(held: Shapes, surveyed: Shapes, fixed: np.ndarray, guides: np.ndarray) -> Shapes:
    """The shapes that references have in the adjustment of the guides, and the surveyed ones of all others."""
    among, there = np.flatnonzero(fixed[guides]), guides[fixed[guides]]

    def either(a: Array, b: Array) -> Array:
        out = b.copy()
        out[there] = a[(among, *(slice(0, width) for width in b.shape[1:]))]
        return out

    return Shapes(*(either(getattr(held, f.name), getattr(surveyed, f.name)) for f in fields(Shapes)))


def _without_outliers(sections: Sections, shapes: Shapes) -> Sections:
    far = np.abs(shapes.residuals) > OUTLIER
    return replace(sections, sigma=np.where(far, np.inf, sections.sigma))


def _orders(
    prior: PosePrior, sections: Sections, held: Adjustment, varying: np.ndarray, contour: np.ndarray
) -> tuple[np.ndarray, Shapes]:
    """Order (n,) of every section, for those that may vary by evidence pooled along contours; the shapes of the full order."""
    order = np.where(sections.order == FIXED, FIXED, CIRCLE)
    tried = [
        survey(prior, replace(sections, order=np.where(varying, k, order)), held)
        for k in range(CIRCLE, MOST + 1)
    ]
    chi2 = [np.sum(shapes.residuals**2, axis=(1, 2)) for shapes in tried]
    for k, (before, after) in enumerate(itertools.pairwise(chi2), CIRCLE + 1):
        order[pooled_evidence(before - after, varying, contour) & varying] = k
    return order, tried[-1]


def _moved(views: list[View], prior: PosePrior, adjustment: Adjustment) -> list[View]:
    """The views with adjusted poses, and with what is uncertain about each pose by itself: errors that all views share move
    scene and cameras together, and don't matter to tracking. It stays as it was where the adjustment can't tell."""
    count, _, own = prior.root.shape
    spread = adjustment.root[:, : count * own].reshape(len(adjustment.root), count, own)
    spread = np.einsum("vik,uvk->viu", prior.root, spread)
    covariance = spread @ np.swapaxes(spread, 1, 2)
    return [
        replace(
            view,
            T_world_camera=adjustment.T_world_camera[i],
            pose_covariance=covariance[i] if adjustment.converged else view.pose_covariance,
        )
        for i, view in enumerate(views)
    ]


def _estimate(found: _Round) -> Estimate:
    """The adjustment's shapes, their variances widened by what they leave of the edgels."""
    views, tracks, chosen, sections = found.views, found.tracks, found.chosen, found.sections
    out = nothing(tracks)
    if sections is None or found.shapes is None or found.adjustment is None:
        return out
    shape, reference = found.shapes, tracks.reference
    seen = np.isfinite(sections.sigma[:, 0])
    inflation = misfit(np.clip(shape.residuals[:, 0], -6, 6), seen, tracks.contour[chosen])
    distance = np.linalg.norm(sections.origin - views[reference].centre, axis=1)
    drift = DRIFT * distance / views[0].camera.fx
    own = shape.own_variance * inflation + drift**2
    excess = np.where(shape.valid, shape.own_variance, 0.0) * (inflation - 1)
    sigma = np.sqrt(shape.sigma_radius**2 + excess + drift**2)

    fixed = np.zeros(len(tracks.seen), bool)
    fixed[chosen] = (sections.order == FIXED) & shape.valid
    out.radius[chosen], out.sigma_radius[chosen] = shape.radius, sigma
    out.seen[chosen], out.valid[chosen] = seen, shape.valid & (seen.sum(axis=1) >= LEAST_VIEWS)
    every, shared = np.full(len(fixed), np.inf), np.zeros((len(fixed), shape.shared.shape[1]))
    every[chosen], shared[chosen] = own, shape.shared
    relative = parallax(out.radius, every, shared, fixed, tracks)
    pixels = tracks.pixels[chosen, reference]
    view = replace(views[reference], pose_covariance=found.adjustment.pose_covariance[reference])
    position, covariance = _contact(view, pixels, sections, shape, reference)
    out.position[chosen] = position
    out.covariance[chosen] = covariance * inflation[:, None, None]
    return replace(out, **dict(zip(("relative", "sigma_relative", "relative_to"), relative, strict=True)))


def _contact(
    view: View, pixels: Array, sections: Sections, shape: Shapes, reference: int
) -> tuple[Array, Array]:
    """Contact points (n, 3) on the rays of the reference view and their covariance (n, 3, 3): in the section's plane that of
    its parameters, off it that of the view's pose, which says where the pixel's ray runs."""
    rotation = view.T_world_camera.rotation.as_matrix()
    normals = sections.normals[:, 0, reference] @ rotation.T
    local = np.einsum("nij,nj->ni", sections.frame, normals)[:, None, None]
    contact = sections.contact(local, shape.theta)[:, 0, 0]
    position = sections.origin + np.einsum("ni,nij->nj", contact, sections.frame)
    # adjusted, the ray leaves the section a little, along the contour generator
    rays = view.rays(pixels)
    position = view.centre + np.sum((position - view.centre) * rays, axis=1, keepdims=True) * rays
    off = sections.frame[:, 2] @ rotation
    lever = np.concatenate([off, np.cross((position - view.centre) @ rotation, off)], axis=1)
    covariance = np.zeros((len(position), 3, 3))
    covariance[:, :2, :2] = np.where(shape.valid[:, None, None], shape.covariance[:, :2, :2], 0.0)
    covariance[:, 2, 2] = np.einsum("ni,ij,nj->n", lever, view.pose_covariance, lever)
    covariance = np.swapaxes(sections.frame, 1, 2) @ covariance @ sections.frame
    covariance[~shape.valid] = np.inf
    return position, covariance
