"""A strip of surface near its extremal boundaries: contour generators and osculating arcs (Cipolla ch. 3, figure 3.14).

The conjugate grid of the epipolar parameterisation r(s, t): s-curves are the contour generators of the views, t-curves the
arcs on which epipolar planes cut the surface. Every vertex lies on one of each.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from extremal.estimator.camera import Array, View
from extremal.estimator.contours import LONGEST_GAP, Contours
from extremal.estimator.epipolar import Sequence3D
from extremal.estimator.errors import DegenerateGeometry, InvalidInput
from extremal.estimator.estimates import DRIFT, LEAST_VIEWS, fit_circles
from extremal.estimator.gauge import Gauge
from extremal.estimator.joint import joint_estimate, sections_of
from extremal.estimator.matching import EdgelMap, reach_of
from extremal.estimator.pooling import window_sum
from extremal.estimator.poses import PosePrior, square_root
from extremal.estimator.projection import adjoint
from extremal.estimator.strip_arcs import Arcs, fit_arcs
from extremal.estimator.strip_grid import grid_faces, grid_normals, normal_sigma
from extremal.estimator.threads import one_blas_thread
from extremal.estimator.tracking import Tracks, track
from extremal.estimator.uncertainty import pose_angle_sigma

CONFIDENCE = 1.96  # standard deviations: 95 % (eq. 3.27)
VOTERS = 3  # arcs on each side along the contour that decide together whether they are extremal
SHORTEST = 5  # arcs: a shorter run is no strip
LEAST_CERTAINTY = (
    10.0  # standard deviations of R: the edge of a thin plate, where its corners change places, reaches 9
)
BIAS = 0.01  # [px] what models of shading leave of a limb in all views alike; a strip's points share it
WORST_MISFIT = 9.0  # chi2 per degree of freedom above which an arc is no section of a smooth surface
LOOSEST = 0.002  # [m] standard deviation along the normal above which a vertex is none


@dataclass(frozen=True, eq=False)
class Strip:
    """S arcs (t-curves) by T contour generators (s-curves); arcs of one `run` are neighbours on a surface, in order.

    Attributes:
        points: (S, T, 3) [m]; covariance: (S, T, 3, 3) [m^2]; normals: (S, T, 3) unit, out of the surface.
        valid: (S, T) whether the arc was seen as far as that: from its first view to its last.
        view: (T,) the view of each s-curve, in order along the travel.
        run: (S,) number of the piece of contour, non-decreasing.
        side: (S,) +1 where the outward normal points to the travel, -1 where against it.
        arcs: the sections themselves; phi: (S, T) [rad] where on them the vertices lie.
        world: (6, C) motion of the whole world (translation [m], rotation vector [rad]) per unit of errors that all poses
            share, and that no image can tell; no columns where poses are exact.
    """

    points: Array
    covariance: Array
    normals: Array
    valid: np.ndarray
    view: np.ndarray
    run: np.ndarray
    side: np.ndarray
    arcs: Arcs
    phi: Array
    world: Array

    @property
    def sigma(self) -> Array:
        """(S, T) standard deviation [m] along the normal."""
        return normal_sigma(self.normals, self.covariance)

    @property
    def faces(self) -> np.ndarray:
        """(F, 3) triangles of rows of points.reshape(-1, 3), counter-clockwise seen from outside."""
        return grid_faces(self.points, self.normals, self.valid, self.run)

    def at(self, phi: Array) -> tuple[Array, Array, Array]:
        """Points (S, K, 3), covariance (S, K, 3, 3) and normals (S, K, 3) of the arcs at phi (S, K), beyond the views, too."""
        return surface_at(self.arcs, phi, self.run, self.side, self.world)


def surface_at(
    arcs: Arcs, phi: Array, run: np.ndarray, side: np.ndarray, world: Array
) -> tuple[Array, Array, Array]:
    """What `Strip.at` gives."""
    points, covariance = arcs.points(phi)
    axes = arcs.axes(phi)
    normals = grid_normals(points, axes[..., 1, :], axes[..., 0, :] * side[:, None, None], run)
    turned = -np.cross(points[..., None, :], world[3:].T).swapaxes(-1, -2)  # w x p, by columns
    spread = world[:3] + turned
    return points, covariance + spread @ np.swapaxes(spread, -1, -2), normals


def recover_strip(
    views: Sequence[View], contours: list[Contours], prior: PosePrior | None = None
) -> tuple[list[View], Strip]:
    """The strip that contours of views show, and the views, their poses adjusted where they were uncertain.

    Args:
        views: three or more, in order of the motion, nearly along a line. contours: those of each.
        prior: what is known of the poses; by default what the views' own covariances say.

    Raises:
        DegenerateGeometry: fewer than three views, a camera that does not move, or no extremal boundary in sight.
        InvalidInput: another number of contours, or of poses, than of views.
        NotConverged: poses could not be adjusted.
    """
    sequence = Sequence3D.of(views)
    prior = PosePrior.of(views) if prior is None else prior
    if not len(contours) == len(prior.T_world_camera) == len(views):
        raise InvalidInput(
            f"contours of {len(contours)} and {len(prior.T_world_camera)} poses for {len(views)} views; accepted: as many of each"
        )
    reference = len(views) // 2
    with one_blas_thread():
        reach = reach_of(sequence)
        maps = [
            EdgelMap(c, v.camera.width, v.camera.height, reach) for c, v in zip(contours, views, strict=True)
        ]

        def tracker(moved: Sequence3D) -> Tracks:
            return track(moved, contours, maps, reference)

        if prior.exact:
            moved, tracks = list(views), tracker(sequence)
        else:
            moved, tracks, _ = joint_estimate(list(views), prior, tracker)
        return moved, strip_of(moved, tracks, _common_motion(prior, moved[reference]))


def _common_motion(prior: PosePrior, view: View) -> Array:
    """Motion (6, C) of the world that no image tells, as `Strip.world`.

    Errors that were independent have a mean, too, which an adjustment leaves: it is taken to be as uncertain as one pose.
    """
    own = adjoint(view.T_world_camera) @ square_root(view.pose_covariance[None])[0]
    return np.concatenate([Gauge.of(prior).motion, own], axis=1)


def strip_of(views: list[View], tracks: Tracks, world: Array) -> Strip:
    """The strip of tracks followed with the poses of the views; world as in `Strip`.

    Raises DegenerateGeometry where no track is extremal.
    """
    sequence = Sequence3D.of(views)
    fit = fit_circles(views, sequence, tracks)
    chosen = np.flatnonzero(fit.circles.valid & (fit.seen.sum(axis=1) >= LEAST_VIEWS))
    sections = sections_of(sequence, tracks, fit, chosen)
    normals = np.einsum("vij,nvj->nvi", sequence.rotations, sections.normals[:, 0])
    back = np.argsort(fit.order)
    ordered = [views[i] for i in fit.order]
    pose = pose_angle_sigma(fit.circles, ordered, tracks.tangent_planes[:, fit.order])[chosen][:, back]
    tilt = np.abs(np.sum(normals * fit.circles.normals[chosen][:, back], axis=-1))
    sigma = np.hypot(sections.sigma[:, 0], pose * tilt)
    arcs, phi = fit_arcs(
        sections.origin,
        sections.frame,
        normals,
        sequence.centres,
        sigma,
        _biases(views, sigma),
        tracks.contour[chosen],
    )
    side = _sides(arcs, tracks.contour[chosen], sections.origin, views[tracks.reference])
    run, rows = _runs(side, arcs, tracks.contour[chosen], chosen)
    if len(rows) == 0:
        raise DegenerateGeometry(
            f"none of {len(chosen)} tracked contour points lies on an extremal boundary that {len(views)} views show to be curved; "
            "accepted: views of a curved object, over a longer path"
        )
    order = np.argsort(sequence.centres @ sequence.travel, kind="stable")
    return _grid(arcs.take(rows), phi[rows][:, order], order, run, side[rows], world)


def _biases(views: list[View], sigma: Array) -> Array:
    """What is common (n, V, 1) [rad] to all views of a contour (n, V)."""
    bias = np.array([BIAS / view.camera.fx for view in views])
    return np.broadcast_to(bias[:, None], (*sigma.shape, 1))


def _sides(arcs: Arcs, contour: np.ndarray, origin: Array, view: View) -> np.ndarray:
    """Side (n,) of the surface where an arc is extremal (eq. 3.27), as its neighbours agree; else 0."""
    radius, sigma = (a[:, 0] for a in arcs.radius(np.zeros((len(arcs), 1))))
    drift = DRIFT * np.linalg.norm(origin - view.centre, axis=1) / view.camera.fx
    certainty = radius / np.hypot(sigma, drift)
    votes, count = window_sum(np.sign(certainty) * (np.abs(certainty) > CONFIDENCE), contour, VOTERS)
    agreed = np.where(np.abs(votes) > 0.5 * count, np.sign(votes), 0.0)
    return np.where(agreed * certainty > LEAST_CERTAINTY, agreed, 0.0).astype(int)


def _runs(
    side: np.ndarray, arcs: Arcs, contour: np.ndarray, edgel: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Runs (S,) of neighbours on one contour and one side, and the arcs (S,) that belong to one.

    `edgel` (n,) numbers the points of the reference view: at gaps of LONGEST_GAP runs end.
    """
    good = (side != 0) & (arcs.misfit < WORST_MISFIT) & (arcs.first < 0) & (arcs.last > 0)
    rows = np.flatnonzero(good)
    new = (np.diff(edgel[rows]) > LONGEST_GAP) | (np.diff(contour[rows]) != 0) | (np.diff(side[rows]) != 0)
    run = np.concatenate([[0], np.cumsum(new)]) if len(rows) else rows
    enough = np.bincount(run)[run] >= SHORTEST if len(rows) else rows > 0
    return np.unique(run[enough], return_inverse=True)[1], rows[enough]


def _grid(arcs: Arcs, phi: Array, view: np.ndarray, run: np.ndarray, side: np.ndarray, world: Array) -> Strip:
    points, covariance, normals = surface_at(arcs, phi, run, side, world)
    valid = (phi >= arcs.first[:, None]) & (phi <= arcs.last[:, None])
    valid &= normal_sigma(normals, arcs.points(phi)[1]) < LOOSEST
    return Strip(points, covariance, normals, valid, view, run, side, arcs, phi, world)
