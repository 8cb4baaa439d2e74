"""From views to surface shape: the whole of the estimator in one page (Cipolla ch. 3)."""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from scipy.spatial.transform import RigidTransform

from extremal.estimator.camera import Array, View
from extremal.estimator.contours import Contours, find_contours
from extremal.estimator.epipolar import Sequence3D
from extremal.estimator.errors import InvalidInput
from extremal.estimator.estimates import (
    Estimate,
    circle_estimate,
    fit_circles,
    mean_limb,
    parallax_estimate,
)
from extremal.estimator.joint import joint_estimate
from extremal.estimator.matching import EdgelMap, reach_of
from extremal.estimator.poses import PosePrior
from extremal.estimator.threads import one_blas_thread
from extremal.estimator.tracking import Tracks, track

CONFIDENCE = 1.96  # standard deviations: 95 % (eq. 3.27)
LASTING = 0.8  # of the views, the first and the last among them, make a track that lasts the whole sequence

Estimator = Literal["circle", "parallax", "joint"]


@dataclass(frozen=True, eq=False)
class Shape:
    """n contour points of the reference view, with what their motion through V views tells of the surface.

    Attributes:
        reference: index of the view in which the points are given.
        T_world_camera: poses (V) of the views, as adjusted where the estimate is joint.
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
    T_world_camera: RigidTransform
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


def estimate_shape(
    views: Sequence[View],
    progress: Callable[[int, int], None] | None = None,
    estimator: Estimator | None = None,
    prior: PosePrior | None = None,
) -> Shape:
    """Depth, signed radius of curvature and label, with covariance, of every contour point that could be tracked.

    Args:
        views: three or more frames with the poses that the robot believes, in order of the motion.
        progress: called with (frames done, frames) while contours are found.
        estimator: "circle": osculating circles with the poses as believed (eq. 3.23); "parallax": their radii relative
            to bootstrapped references (2.57-2.59); "joint": poses and shape together. By default "joint" where poses
            are uncertain, else "circle".
        prior: what is known of the poses, with errors common to all views; by default what the views' own
            covariances say. Only "joint" uses what is common.

    Raises:
        DegenerateGeometry: fewer than three views, or a camera that does not move.
        InvalidInput: an unknown estimator, or a prior of another number of views.
        NotConverged: the joint estimate did not settle.
    """
    _checked(views, estimator, prior)
    return shape_from_contours(views, all_contours(views, progress), estimator, prior)


def shape_from_contours(
    views: Sequence[View],
    contours: list[Contours],
    estimator: Estimator | None = None,
    prior: PosePrior | None = None,
) -> Shape:
    """`estimate_shape` of views whose contours are known already: other poses, another estimator, at less cost.

    Raises InvalidInput for another number of contours than of views, and as `estimate_shape`.
    """
    prior, estimator = _checked(views, estimator, prior)
    if len(contours) != len(views):
        raise InvalidInput(f"contours of {len(contours)} views; accepted: {len(views)}, as there are views")
    sequence, reference = Sequence3D.of(views), len(views) // 2
    with one_blas_thread():  # many small matrices: views are spread over the processors instead
        reach = reach_of(sequence)
        maps = [
            EdgelMap(c, v.camera.width, v.camera.height, reach) for c, v in zip(contours, views, strict=True)
        ]

        def tracker(moved: Sequence3D) -> Tracks:
            return track(moved, contours, maps, reference)

        if estimator == "joint":
            moved, tracks, estimate = joint_estimate(list(views), prior, tracker)
        else:
            moved, tracks = list(views), tracker(sequence)
            estimate = circle_estimate(moved, tracks, fit_circles(moved, sequence, tracks))
            if estimator == "parallax":
                estimate = parallax_estimate(estimate)
        return _shape(moved, tracks, estimate)


def _checked(
    views: Sequence[View], estimator: Estimator | None, prior: PosePrior | None
) -> tuple[PosePrior, Estimator]:
    """The prior and the estimator that hold; an error before any image is looked at."""
    if estimator is not None and estimator not in get_args(Estimator):
        raise InvalidInput(f"estimator is {estimator!r}; accepted: {', '.join(get_args(Estimator))}")
    Sequence3D.of(views)
    prior = PosePrior.of(views) if prior is None else prior
    if len(prior.T_world_camera) != len(views):
        raise InvalidInput(
            f"the prior has {len(prior.T_world_camera)} poses; accepted: {len(views)}, as there are views"
        )
    return prior, estimator or ("circle" if prior.exact else "joint")


def all_contours(views: Sequence[View], progress: Callable[[int, int], None] | None = None) -> list[Contours]:
    """The contours of every view; progress as in `estimate_shape`."""

    def find(view: View) -> Contours:
        return find_contours(view.image, view.camera, view.ignored)

    with one_blas_thread(), ThreadPoolExecutor(min(len(views), os.cpu_count() or 1)) as pool:
        found = []
        for contours in pool.map(find, views):
            found.append(contours)
            if progress:
                progress(len(found), len(views))
    return found


def _shape(views: list[View], tracks: Tracks, estimate: Estimate) -> Shape:
    """The valid points of an estimate, labelled."""
    chosen = np.flatnonzero(estimate.valid)
    extremal = np.abs(estimate.radius) > CONFIDENCE * estimate.sigma_radius
    side = np.where(extremal, np.sign(estimate.radius), 0).astype(int)
    renumber = np.full(len(estimate.valid) + 1, -1)
    renumber[chosen] = np.arange(len(chosen))
    return Shape(
        reference=tracks.reference,
        T_world_camera=RigidTransform.concatenate([v.T_world_camera for v in views]),
        contour=tracks.contour[chosen],
        pixels=tracks.pixels[chosen, tracks.reference],
        rays=tracks.rays[chosen, tracks.reference],
        tangent_planes=tracks.tangent_planes[chosen, tracks.reference],
        epipolar_planes=tracks.planes.normal[chosen],
        radius=estimate.radius[chosen],
        sigma_radius=estimate.sigma_radius[chosen],
        relative_radius=estimate.relative[chosen],
        sigma_relative_radius=estimate.sigma_relative[chosen],
        relative_to=renumber[estimate.relative_to[chosen]],
        position=estimate.position[chosen],
        covariance=estimate.covariance[chosen],
        extremal=extremal[chosen],
        side=side[chosen],
        gaussian_sign=_gaussian_sign(tracks, side)[chosen],
        views=estimate.seen.sum(axis=1)[chosen],
        complete=_lasting(tracks.seen)[chosen],
        limb=mean_limb(tracks)[chosen],
        tangents=(tracks.tangents * np.where(side * tracks.ahead < 0, -1.0, 1.0)[:, None])[chosen],
    )


def _lasting(seen: np.ndarray) -> np.ndarray:
    return seen[:, 0] & seen[:, -1] & (seen.mean(axis=1) >= LASTING)


def _gaussian_sign(tracks: Tracks, side: np.ndarray) -> np.ndarray:
    """Sign (n,) of K: that of the apparent contour's curvature seen from the surface (Koenderink; DESIGN eq. 5).

    The curvature is averaged over the views, in which the contour generator moves but little. It is positive where
    the contour bends towards its bright side, and the surface lies on that side where the image normal, carried into
    the world, points against the outward normal.
    """
    curvature = np.sum(tracks.curvature * tracks.seen, axis=1) / tracks.seen.sum(axis=1)
    bright_is_ahead = np.sign(tracks.ahead)
    return (np.sign(curvature) * np.where(side > 0, -1, 1) * bright_is_ahead * (side != 0)).astype(int)
