"""Sections and camera poses from all looks of a set of tracks at once, with every look.

It is the adjustment of `estimator.adjustment`, of a few dozen tracks: they are so few that the dense system of their unknowns
theta = (s, q, R, c) is solved in a fraction of a millisecond, once the poses are eliminated look by look (`section_rows`).
`ContourFilter`, which is made for hundreds of tracks, linearises a look but once: with few tracks and poses that are off by
1 mm and 1 mrad, the path that it finds is bent across the sections' planes, by several of its standard deviations. Here a
look keeps its linear equations only as long as the sections stay where they were, and looks do not become many more.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError
from scipy.linalg.lapack import dpotrf, dtrtri, dtrtrs  # pyright: ignore[reportAttributeAccessIssue]

from extremal.estimator.adjustment import FAR, LOOSE
from extremal.estimator.camera import Array
from extremal.estimator.poses import six_columns
from extremal.estimator.slant import FAR as FAR_SLANT
from extremal.tasks.compiled import compiled
from extremal.tasks.section_arcs import arc_middle, widen
from extremal.tasks.section_corners import beyond_corners
from extremal.tasks.section_looks import Looks, Rows, Sums
from extremal.tasks.section_misfit import repeated
from extremal.tasks.section_rows import missed, placed, tell
from extremal.tasks.section_slant import smoothed
from extremal.tasks.section_solution import Solution, Spread
from extremal.tasks.section_strays import strays
from extremal.tasks.section_unknowns import moved, within, without_change

MOST_LOOKS = 120  # that are kept: of more, the one goes whose neighbours are nearest to each other
EARLY = 12  # looks, before which none is an outlier
FIRST_STEPS = 3  # from nothing known
RECENT = 4  # looks that are linearised anew with every look
MOVED = 0.002  # [m] by which half of the sections have moved when all looks are linearised anew,
GROWTH = 1.25  # or factor on the number of looks
SPREAD_GROWTH = 1.08  # factor on the number of looks, after which covariances are computed anew, and misfits
ACROSS_PRIOR, DEPTH_PRIOR, RADIUS_PRIOR = 0.1, 0.06, 0.06  # sigma of s [m], q (share of the distance), R [m]
TOGETHER = 0.2  # sigma of q that all have in common, share of the distance
CHANGE_PRIOR, LEAST_CHANGE = 0.5, 0.001  # sigma of c, in R; and [m/rad]
LARGEST_RADIUS = 0.3  # [m] at which looks are linearised
JUDGING = 4  # looks, from which on others are judged by them: as long as they are EARLY, match by match
BEFORE = 2  # looks in which a contour may have been another already
BENDS = 24.0  # how far radii that change by themselves in a radian leave a circle: R arc^3 / BENDS
ALIKE = 0.5  # standard deviations of errors of edges that are common to a contour


class SectionSmoother:
    """Least squares on all looks.

    Attributes:
        fixed: (n,) sections that are believed to be fixed: where looks are linearised.
        first, last: (n,) [rad] least and largest angle from N_0 in which sections were seen; infinite of none.
        middle: (n,) [rad] where they have the radius R, and change: (n,) [m/rad] c.
        count: number of looks that were taken in.
        anew: (n,) sections of which the last `strayed` has forgotten all looks.
    """

    def __init__(
        self, origin: Array, frame: Array, distance: Array, systematic: float, turn: float, noisy_slant: bool
    ) -> None:
        """
        Args:
            origin: (n, 3) [m] near the contact points. frame: (n, 3, 3) rows N_0, T_0, N_0 x T_0 in the world.
            distance: (n,) [m] of the origins from the camera.
            systematic: [rad] standard deviation of errors of edges that repeat in looks from nearly the same direction, until
                it has turned by `turn` [rad]: as many looks as the arc holds average them, not more.
            noisy_slant: whether the direction of a contour is measured with errors of its own, to be smoothed (`slant`).
        """
        n = len(origin)
        self.fixed = np.zeros(n, bool)
        self._sections = tuple(np.ascontiguousarray(values, float) for values in (origin, frame, distance))
        self._systematic, self._turn, self._noisy_slant = systematic, turn, noisy_slant
        # where little is known, a step may lead out of what the linear model means
        self._reach = np.stack([LOOSE * distance] * 2 + [np.full(n, LARGEST_RADIUS)], axis=1)
        self._prior = _prior(distance)
        self._theta = self._at = np.zeros((n, 4))  # now, and where looks were linearised
        self.middle = np.zeros(n)
        self._looks, self._told = Looks(n), 0  # of the first looks is known what they say; the others wait
        self._settled = Sums.prior(self._prior)  # of all but the latest looks
        self._settled_looks, self._repeats = 0, np.zeros(n)
        self.first, self.last = np.full(n, np.inf), np.full(n, -np.inf)
        self._refused, self.anew = np.zeros(n, int), np.zeros(n, bool)
        self._due = self._spread_due = self._repeats_due = 0.0  # number of looks
        self._corners_due = float(EARLY)
        self._spread: Spread | None = None
        self.count = 0

    @property
    def change(self) -> Array:
        return self._theta[:, 3]

    def update(self, believed: Array, root: Array, normals: Array, sigma: Array) -> None:
        """Take in a look.

        Args:
            believed: (4, 4) pose. root: (6, K) square root of its covariance.
            normals: (n, 3) unit normals of the tangent planes in the camera frame, on the side of N_0.
            sigma: (n,) [rad] of the planes' angles about the camera centre; infinite where unseen.
        """
        self._looks.add(believed, root, normals, sigma)
        widen(believed, normals, sigma, self._sections[1], self.first, self.last)
        self.count += 1
        if self._looks.count > MOST_LOOKS:
            self._leave_one_out()

    def strayed(
        self, believed: Array, root: Array, normals: Array, sigma: Array, contour: NDArray[np.integer]
    ) -> NDArray[np.bool_]:
        """Which (n,) planes of a look, as `update` takes it, are of other contours; contour: (n,) of each section.

        What such sections showed in the looks just before is forgotten: contours that come apart were one for a while. Where
        more has been left out than is left, what is left is not believed either: such sections begin anew.
        """
        self.anew[:] = False
        if self.count < JUDGING or not np.isfinite(sigma).any():
            return np.zeros(len(sigma), bool)
        if self._told < self._looks.count:
            self.solve()
        if self.count >= self._corners_due:
            self._part_at_corners(contour)
        planes = self._smoothed_last(believed, normals @ believed[:3, :3].T, sigma)
        out = self._judged(believed, root, planes, sigma, contour)
        self._looks.forget(out, BEFORE)
        self._refused += out
        if out.any():
            seen = np.sum(np.isfinite(self._looks.part(0).sigma), axis=0)
            self._begin_anew(out & (self._refused > seen))
        return out

    def _judged(
        self, believed: Array, root: Array, planes: Array, sigma: Array, contour: NDArray[np.integer]
    ) -> NDArray[np.bool_]:
        """Which (n,) tangent planes (n, 3) of a look, in the world, are of other contours, by what is known of the sections."""
        assert self._spread is not None
        out, rows, n = np.zeros(len(sigma), bool), np.flatnonzero(np.isfinite(sigma)), len(sigma)
        origin, frame, distance = (values[rows] for values in self._sections)
        spread, theta = np.hypot(sigma, self._repeats)[rows], self._theta[rows]
        X, O, r = missed(
            believed, six_columns(root), planes[rows], spread, theta, self.middle[rows], origin, frame, distance,
        )  # fmt: skip
        P = self._spread.covariance.reshape(n, 3, n, 3)[rows][:, :, rows]
        arc = np.maximum(self.last - self.first, 0.0)[rows]
        bend = np.abs(theta[:, 2]) * arc**3 / BENDS / (spread * distance)
        # a turned camera that sees a contact point elsewhere than it is believed to be: of second order, and not small at first
        depth = np.sqrt(np.maximum(np.einsum("iaia->i", P), 0.0))
        common = np.hypot(ALIKE, np.sqrt(np.sum(root[3:] ** 2)) * depth / (spread * distance))
        judged = contour[rows] if self.count >= EARLY else np.arange(len(rows))
        out[rows] = strays(X, O, r, P, 1.0 + bend**2, common, judged)
        return out

    def _part_at_corners(self, contour: NDArray[np.integer]) -> None:
        """Forget the lesser part of sections with a corner, and what is of other contours by what the others say then."""
        self._corners_due = GROWTH * self.count
        rows, (origin, frame, distance) = self._looks.part(0), self._sections
        poses, planes = self._placed(rows)
        beyond = beyond_corners(poses, planes, rows.sigma, self._theta, self.middle, origin, frame, distance)
        if not beyond.any():
            return
        # misfits of other sections may have come of these
        self._repeats, self._repeats_due = np.zeros(len(self._theta)), np.inf
        self._leave_out(beyond)
        poses, planes = self._placed(rows)
        if self._noisy_slant:
            planes = smoothed(poses, planes, rows.sigma, self._theta, origin, frame, FAR_SLANT)
        turned = planes @ poses[:, :3, :3] @ np.swapaxes(rows.believed[:, :3, :3], 1, 2)
        out = np.zeros_like(beyond)
        for v in range(len(out)):
            out[v] = self._judged(rows.believed[v], rows.root[v], turned[v], rows.sigma[v], contour)
        self._repeats_due = 0.0
        self._leave_out(out)
        self._corners_due = 0.0  # a part may have a corner, too

    def _leave_out(self, planes: NDArray[np.bool_]) -> None:
        """Forget planes (V, n) of the looks."""
        rows = self._looks.part(0)
        rows.sigma[planes] = np.inf
        self.first[:], self.last[:] = np.inf, -np.inf
        for believed, normals, sigma in zip(rows.believed, rows.normals, rows.sigma, strict=True):
            widen(believed, normals, sigma, self._sections[1], self.first, self.last)
        self._due = 0.0
        self.solve()

    def _placed(self, rows: Rows) -> tuple[Array, Array]:
        """Poses (V, 4, 4) of looks that fit best what is known, and their tangent planes (V, n, 3) in the world."""
        return placed(
            rows.believed, rows.root, rows.normals, self._theta, rows.loss, rows.pull, rows.inverse
        )[1:]

    def _begin_anew(self, sections: NDArray[np.bool_]) -> None:
        """Forget all that was seen of `sections` (n,)."""
        self._looks.forget(sections, self._looks.count)
        self._theta = np.where(sections[:, None], 0.0, self._theta)
        self.first[sections], self.last[sections], self._refused[sections] = np.inf, -np.inf, 0
        self.anew = sections

    def _smoothed_last(self, believed: Array, planes: Array, sigma: Array) -> Array:
        """Tangent planes (n, 3) of a new look in the world, their slant smoothed by the looks before it where it is noisy."""
        if not self._noisy_slant:
            return planes
        rows, (origin, frame, _) = self._looks.part(0), self._sections
        poses, before = self._placed(rows)
        poses, before = np.concatenate([poses, believed[None]]), np.concatenate([before, planes[None]])
        sigma = np.concatenate([rows.sigma, sigma[None]])
        return smoothed(poses, before, sigma, self._theta, origin, frame, FAR_SLANT)[-1]

    def _leave_one_out(self) -> None:
        i = self._looks.nearest()
        out = self._looks.part(i, i + 1)
        if i < self._settled_looks:
            self._settled.add(out, -1.0)
            self._settled_looks -= 1
        if i < self._told:
            self._told -= 1
        self._looks.leave_out(i)

    def solve(self) -> Solution:
        """Step from the last solution, and what is known of all sections. Without a new look, a further Gauss-Newton step."""
        anew = self._is_stale()
        if anew:
            self._due = min(GROWTH * self.count, EARLY) if self.count < EARLY else GROWTH * self.count
        if not self._told:
            for _ in range(FIRST_STEPS - 1):
                self._step(self._linearise(0))
        if anew:
            self._spread = None
        latest = self._looks.count if anew or self._noisy_slant else RECENT
        return self._step(self._linearise(max(self._looks.count - latest, 0)))

    def _is_stale(self) -> bool:
        return self.count >= self._due or moved(self._theta, self._at, MOVED) > 0.5 * len(self._at)

    def _linearise(self, first: int) -> Sums:
        """Linearise looks from the first on, and those that wait, anew: at what is known now. The sum of all."""
        robust = self.count >= EARLY
        if 0 < self._told < self._looks.count and not self._noisy_slant:
            # A new look is weighed by how far it is from what is known once its pose is fitted, not from where it is believed.
            # Measured directions may be of other contours: a pose that fits them all would hide it.
            self._tell(self._told, robust=False)
            self._tell(self._told, robust)
        first = min(first, self._told)
        if first == 0:
            self._at, self.middle = self._theta, arc_middle(self.first, self.last)
            # an edge stays one: what has no radius does not get another
            of_change = np.arange(len(self._at))
            self._prior[of_change, of_change] = (
                CHANGE_PRIOR * np.abs(self._theta[:, 2]) + LEAST_CHANGE
            ) ** -2.0
            self._update_repeats()
        self._tell(first, robust)
        self._told = self._looks.count
        if self._noisy_slant:
            sums = Sums.prior(self._prior)  # all is told anew with every look
            sums.add(self._looks.part(0))
            return sums
        settled = max(first, self._told - RECENT)
        if first == 0:
            self._settled, self._settled_looks = Sums.prior(self._prior), 0
        self._settled.add(self._looks.part(self._settled_looks, settled))
        self._settled_looks = settled
        sums = self._settled.copy()
        sums.add(self._looks.part(settled))
        return sums

    def _update_repeats(self) -> None:
        """What is added to the sigma of looks changes as slowly as covariances do."""
        if self.count >= self._repeats_due:
            told = self._looks.part(0, self._told)
            self._repeats = repeated(
                self._systematic, self._turn, self.first, self.last, told.off, told.sigma
            )
            self._repeats_due = SPREAD_GROWTH * self.count

    def _tell(self, first: int, robust: bool) -> None:
        """Let looks from the first on say what they do at what is known now."""
        far, smooth = FAR if robust else np.inf, self._noisy_slant and first == 0
        origin, frame, distance = self._sections
        _tell(
            self._looks.part(first), origin, frame, distance, self._theta, self.middle, self._repeats, far, smooth,
        )  # fmt: skip

    def _step(self, sums: Sums) -> Solution:
        """Solve normal equations, which are lost."""
        n = len(self._theta)
        factor, failed = dpotrf(sums.matrix.T, lower=1, clean=0, overwrite_a=1)
        if failed:
            raise LinAlgError("the information on sections is not positive definite")
        of_change, across, of_rest = factor[:n, :n], factor[n:, :n], factor[n:, n:]
        half = dtrtrs(factor, sums.right, lower=1)[0]
        theta = dtrtrs(of_rest, half[n:], lower=1, trans=1)[0].reshape(-1, 3)
        if self._spread is None or self.count >= self._spread_due:
            root = dtrtri(of_rest, lower=1)[0].T
            self._spread = Spread(
                root, without_change(sums.blocks, self._prior.diagonal()[:n]), self._sections[2]
            )
            self._spread_due = SPREAD_GROWTH * self.count
        solution = Solution(theta, self._spread)
        held = within(solution.held_theta(self.fixed), self._reach)
        change = dtrtrs(of_change, half[:n] - across.T @ held.ravel(), lower=1, trans=1)[0]
        self._theta = np.concatenate([held, change[:, None]], axis=1)
        return solution


def _prior(distance: Array) -> Array:
    """Information (4 n, 4 n) before any look, on sections at distances (n,) [m].

    Objects stand on tables, near where they were first seen; but first depths are wrong together, where poses were. If forty sections
    were each sure of theirs, they would be six times as sure of the mean, and radii would have to make up for it.
    """
    n = len(distance)
    depth = DEPTH_PRIOR**2 * np.eye(n) + TOGETHER**2
    information, of_depth = np.zeros((4 * n, 4 * n)), n + 1 + 3 * np.arange(n)
    information[np.ix_(of_depth, of_depth)] = np.linalg.inv(depth * distance[:, None] * distance)
    for others, sigma in (
        (slice(0, n), LEAST_CHANGE),
        (slice(n, None, 3), ACROSS_PRIOR),
        (slice(n + 2, None, 3), RADIUS_PRIOR),
    ):
        information[others, others] = np.eye(n) / sigma**2
    return information


@compiled
def _tell(
    rows: Rows,
    origin: Array,
    frame: Array,
    distance: Array,
    theta: Array,
    middle: Array,
    repeats: Array,
    far: float,
    smooth: bool,
) -> None:
    """What looks say, linearised at theta (n, 4) and the poses that fit it best, of measured or smoothed slants."""
    z, poses, planes = placed(
        rows.believed, rows.root, rows.normals, theta, rows.loss, rows.pull, rows.inverse
    )
    if smooth:
        planes = smoothed(poses, planes, rows.sigma, theta, origin, frame, FAR_SLANT)
    tell(
        poses, z, planes, rows.root, rows.sigma, theta, middle, origin, frame, distance, repeats, far,
        rows.blocks, rows.loss, rows.right, rows.pull, rows.inverse, rows.off,
    )  # fmt: skip
