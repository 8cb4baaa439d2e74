"""Shape while the camera moves: contours of every new view, matched to the tracks and taken into the contour filter.

The first few views are held until they can start the tracks, by the sweep of `tracking`. From then on a view is found,
matched and absorbed in a time that doesn't depend on how many came before: an information filter on circles
predicts where contours cross their epipolar planes (`circle_filter`), the contour filter keeps what all views tell of
shape and poses together. Tracks that start later are not picked up.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from extremal.estimator.camera import Array, View
from extremal.estimator.circle_filter import CircleFilter
from extremal.estimator.contour_filter import ContourFilter
from extremal.estimator.contours import Contours, find_contours
from extremal.estimator.epipolar import SHORTEST_BASELINE, Sequence3D
from extremal.estimator.errors import DegenerateGeometry, InvalidInput
from extremal.estimator.estimates import DRIFT, LEAST_VIEWS, OVERLAP, fit_circles
from extremal.estimator.joint import sections_of
from extremal.estimator.matching import ALIKE, EdgelMap, cross, reach_of
from extremal.estimator.poses import pose_root
from extremal.estimator.references import bootstrap
from extremal.estimator.threads import one_blas_thread
from extremal.estimator.tracking import GATE, LEAST_GATE, NEAREST, PARALLEL, track

ROUGH = 0.04  # of the distance: sigma of a depth from the first views
LEAST_IN_STEP = 12  # matches from which on they tell of the pose that they share
IN_STEP_ROUNDS = 6
LEAST_SPREAD = 0.1  # [px] of predictions among each other
COMPANY = 6.0  # [px] across, within which another edge may be taken for a contour, where both are off by errors of pose
ABREAST = 3.0  # [px] along, to the next edgel of an edge that runs beside it
CONFIDENCE = 1.96  # standard deviations: 95 % (eq. 3.27)


@dataclass(frozen=True, eq=False)
class LiveShape:
    """n contour points after the views so far.

    Attributes:
        radius, sigma_radius: (n,) [m] signed radius of curvature of the epipolar section; sigma is infinite where unknown.
        own_variance, shared: (n,) [m^2], (n, m) of the radii's joint covariance, as in `SectionEstimates`.
        position: (n, 3) [m] contact point in the view in which the tracks started; covariance: (n, 3, 3) [m^2] in the
            epipolar plane.
        extremal: (n,) label by eq. 3.27. contour: (n,) image contour on which a point started.
        pixels: (n, 2) where it was last seen. views: (n,) in which it was seen.
        T_world_camera, pose_covariance: of the latest view, (6, 6) in its frame.
    """

    radius: Array
    sigma_radius: Array
    own_variance: Array
    shared: Array
    position: Array
    covariance: Array
    extremal: np.ndarray
    contour: np.ndarray
    pixels: Array
    views: np.ndarray
    T_world_camera: RigidTransform
    pose_covariance: Array


class SequentialShape:
    """Tracks contour points and estimates their shape view by view.

    Attributes:
        fixed: (n,) points that are believed to be fixed, once tracks have started; set it as references become known.
        started: whether there are tracks.
    """

    def __init__(self, start: int = 5, baseline: float = 0.02, nearest: float = NEAREST) -> None:
        """
        Args:
            start: number of views, at least 3, and baseline: way of the camera [m], that have to be seen before tracks start.
                Until then a view from where the last one was is left out.
            nearest: depth [m] from which on contours are looked for.
        """
        if start < LEAST_VIEWS or not baseline > SHORTEST_BASELINE:
            raise InvalidInput(
                f"start is {start!r}, baseline {baseline!r}; accepted: from {LEAST_VIEWS} views, above {SHORTEST_BASELINE} m"
            )
        self._start, self._baseline, self._nearest = start, baseline, nearest
        self._waiting: list[tuple[View, Contours]] = []
        self.started = False

    @property
    def fixed(self) -> np.ndarray:
        self._require_tracks()
        return self._filter.fixed

    @fixed.setter
    def fixed(self, fixed: np.ndarray) -> None:
        self._require_tracks()
        self._filter.fixed = fixed

    def update(self, view: View, contours: Contours | None = None) -> None:
        """Take in a view, and its contours where they are known; its pose covariance must have the same rank as those before it.

        Raises InvalidInput for a pose covariance that is not positive semi-definite.
        """
        with one_blas_thread():
            contours = contours or find_contours(view.image, view.camera)
            if self.started:
                self._follow(view, contours)
                return
            step = self._baseline / (2 * self._start)
            if self._waiting and np.linalg.norm(view.centre - self._waiting[-1][0].centre) < step:
                return  # the sweep needs views from different places
            if (
                len(self._waiting) >= 2 * self._start
            ):  # the camera hardly gets on: half of these views will do
                self._waiting = self._waiting[::2]
            self._waiting.append((view, contours))
            centres = np.array([v.centre for v, _ in self._waiting])
            if (
                len(centres) >= self._start
                and np.linalg.norm(centres - centres[0], axis=1).max() >= self._baseline
            ):
                self._begin()

    def _begin(self) -> None:
        """Tracks from the sweep over the first views, which the filters then take in."""
        views, contours = [v for v, _ in self._waiting], [c for _, c in self._waiting]
        sequence = Sequence3D.of(views)
        self._reach, self._travel, middle = reach_of(sequence), sequence.travel, len(views) // 2
        maps = [EdgelMap(c, v.camera.width, v.camera.height, self._reach) for v, c in self._waiting]
        tracks = track(sequence, contours, maps, middle, self._nearest)
        fit = fit_circles(views, sequence, tracks)
        chosen = np.flatnonzero(fit.circles.valid & (fit.seen.sum(axis=1) >= LEAST_VIEWS))
        sections = sections_of(sequence, tracks, fit, chosen)
        distance = np.linalg.norm(sections.origin - sequence.centres[middle], axis=1)
        self._drift = DRIFT * distance / views[middle].camera.fx
        self._filter = ContourFilter(sections.origin, sections.frame, ROUGH * distance, OVERLAP)
        self._origin, self._frame, self._contour = sections.origin, sections.frame, tracks.contour[chosen]
        self._planes = tracks.planes.take(chosen)
        self._loose = np.isinf(sections.sigma[:, 0, middle])
        self._pixels, self._views = tracks.pixels[chosen, -1], np.zeros(len(chosen), int)
        rays, sigma = tracks.rays[chosen], tracks.sigma[chosen]
        self._circles = CircleFilter(self._planes, rays[:, middle], distance, sigma[:, middle])
        for i, view in enumerate(views):
            pose_sigma = sequence.pose_sigma(i, distance)
            if i != middle:
                total = np.hypot(sigma[:, i], pose_sigma)
                self._circles.update(tracks.seen[chosen, i], view.centre, rays[:, i], total, sections.origin)
            slid = _slid(tracks.curvature[chosen, i], pose_sigma * view.camera.fx) / view.camera.fx
            self._absorb(
                view,
                sections.normals[:, 0, i],
                np.hypot(sections.sigma[:, 0, i], slid),
                tracks.contrast[chosen, i],
            )
        tangents = tracks.tangents[chosen]
        bright = np.stack([tangents[:, 1], -tangents[:, 0]], axis=1)
        self._direction = bright @ sequence.rotations[middle][:, :2].T
        self.started, self._waiting = True, []

    def _absorb(self, view: View, normals: Array, sigma: Array, contrast: Array) -> np.ndarray:
        """Take in tangent planes of a view, and say which (n,) are of other contours, by what is known of them and of their contrast
        [grey levels]: of none, here."""
        self._views += np.isfinite(sigma)
        self._filter.update(view.T_world_camera, pose_root(view.pose_covariance), normals, sigma)
        return np.zeros(len(sigma), bool)

    def _follow(self, view: View, contours: Contours) -> None:
        """Match the tracks with the contours of a view."""
        sequence = _alone(view, self._travel)
        points, spread = self._circles.predict(view.centre)
        distance = np.linalg.norm(points - view.centre, axis=1)
        edgels = EdgelMap(contours, view.camera.width, view.camera.height, self._reach)
        found = cross(sequence, contours, edgels, 0, self._planes, points, self._direction, self._loose)
        pose_sigma = sequence.pose_sigma(0, distance)
        sigma = np.hypot(found.sigma, pose_sigma)
        gate = LEAST_GATE / view.camera.fx + GATE * np.hypot(spread, sigma)
        ok = found.found & (np.abs(self._circles.innovation(view.centre, points, found.rays)) < gate)
        ok = in_step(ok, view, points, found.tangent_planes @ sequence.rotations[0])
        ok[ok] = ~in_company(contours, found.pixels[ok])
        across = np.cross(found.rays, self._planes.normal)
        across *= np.where(across @ self._travel < 0, -1.0, 1.0)[:, None]
        tilt = np.sum(found.tangent_planes * across, axis=1) / np.linalg.norm(across, axis=1)
        normals = found.tangent_planes * np.where(tilt < 0, -1.0, 1.0)[:, None]
        told = ok & (np.abs(tilt) > PARALLEL)
        slid = _slid(found.curvature, pose_sigma * view.camera.fx) / view.camera.fx
        turned = np.hypot(np.where(told, found.sigma, 1.0) * np.abs(tilt), slid)
        sigma_told = np.where(told, turned, np.inf)
        ok &= ~self._absorb(view, normals @ sequence.rotations[0], sigma_told, found.contrast)
        self._circles.update(ok, view.centre, found.rays, sigma, points)
        self._direction = np.where(ok[:, None], found.directions, self._direction)
        self._pixels = np.where(ok[:, None], found.pixels, self._pixels)

    def bootstrap(self) -> None:
        """Find the references among the points and set `fixed` (see `references`). Of use once the baseline tells radii apart.

        Raises DegenerateGeometry before there are tracks.
        """
        self._require_tracks()
        free = self._filter.sections(np.zeros(len(self._contour), bool))
        own = np.where(free.valid, free.own_variance, np.inf)
        self.fixed = bootstrap(free.radius, own, free.shared, self._contour, overlap=OVERLAP).fixed

    def _require_tracks(self) -> None:
        if not self.started:
            raise DegenerateGeometry(
                f"{len(self._waiting)} view(s) wait; tracks start with {self._start} views over {self._baseline} m"
            )

    def shape(self) -> LiveShape:
        """Shape from all views so far; points `fixed` are taken for references.

        Raises DegenerateGeometry before there are tracks.
        """
        self._require_tracks()
        found = self._filter.sections(self.fixed)
        sigma = np.hypot(found.sigma_radius, self._drift)
        plane = self._frame[:, :2]
        position = self._origin + np.einsum("ni,nij->nj", found.theta[:, :2], plane)
        spread = np.where(found.valid[:, None, None], found.covariance, 0.0)[:, :2, :2]
        covariance = np.swapaxes(plane, 1, 2) @ spread @ plane
        covariance[~found.valid] = np.inf
        return LiveShape(
            found.radius,
            sigma,
            found.own_variance,
            found.shared,
            position,
            covariance,
            np.abs(found.radius) > CONFIDENCE * sigma,
            self._contour,
            self._pixels,
            self._views,
            self._filter.T_world_camera,
            self._filter.pose_covariance,
        )


def in_step(ok: np.ndarray, view: View, points: Array, normals: Array) -> np.ndarray:
    """Which matches `ok` (n,) move as the others do.

    An error d of the pose moves all contours together: a tangent plane n (in the camera frame) passes its contact point p by
    n.p = [n, p x n] d. What is left of these distances, once the likeliest d for most of the tracks is taken out, tells a track
    that has gone over to another contour, as where an edge goes behind a limb, long before it is as far off as a pose may be.

    Args:
        points: (n, 3) [m] predicted contact points, in the world. normals: (n, 3) unit, of the tangent planes, in the camera frame.
    """
    rows = np.flatnonzero(ok)
    if len(rows) < LEAST_IN_STEP:
        return ok
    normals = normals[rows]
    p = (points[rows] - view.centre) @ view.T_world_camera.as_matrix()[:3, :3]
    distance = np.linalg.norm(p, axis=1)
    misses = np.sum(normals * p, axis=1) / distance
    A = (
        np.concatenate([normals, np.cross(p, normals)], axis=1)
        @ pose_root(view.pose_covariance)
        / distance[:, None]
    )
    left, scale = misses, 0.0
    for _ in range(IN_STEP_ROUNDS):
        scale = max(1.48 * float(np.median(np.abs(left))), LEAST_SPREAD / view.camera.fx)
        weight = 1 / (scale * np.maximum(np.abs(left), scale))  # Huber's: of far ones, the sign counts
        weighted = A.T * weight
        left = misses - A @ np.linalg.solve(weighted @ A + np.eye(A.shape[1]), weighted @ misses)
    alike = np.zeros_like(ok)
    alike[rows] = np.abs(left) < LEAST_GATE / view.camera.fx + GATE * scale
    return alike


def in_company(contours: Contours, pixels: Array) -> np.ndarray:
    """Beside which of pixels (n, 2) on contours another contour runs, for which it could be taken."""
    if len(contours.positions) == 0:
        return np.zeros(len(pixels), bool)
    apart = contours.positions - pixels[:, None]
    nearest = np.argmin(np.sum(apart**2, axis=2), axis=1)
    normals, contour = contours.normals[nearest], contours.contour[nearest]
    across = np.abs(np.einsum("nmi,ni->nm", apart, normals))
    along = np.abs(apart[..., 0] * normals[:, None, 1] - apart[..., 1] * normals[:, None, 0])
    beside = (across < COMPANY) & (along < ABREAST) & (contours.contour != contour[:, None])
    return np.any(beside & (np.abs(normals @ contours.normals.T) > ALIKE), axis=1)


def _slid(curvature: Array, pose_sigma: Array) -> Array:
    """Standard deviation (n,) [px] across contours of a curvature (n,) [1/px], where planes cross them that are believed to lie
    elsewhere, by pose_sigma (n,) [px]: of curvature d^2 / 2, d ~ N(0, pose_sigma^2)."""
    return np.sqrt(0.75) * np.abs(curvature) * pose_sigma**2


def _alone(view: View, travel: Array) -> Sequence3D:
    """One view as a sequence with the travel of those before it."""
    variance = np.diagonal(view.pose_covariance).reshape(1, 2, 3).mean(axis=2)
    rotation = view.T_world_camera.as_matrix()[:3, :3]
    return Sequence3D((view.camera,), rotation[None], view.centre[None], travel, *np.sqrt(variance).T)
