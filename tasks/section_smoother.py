"""Sections and camera poses from all looks of a set of tracks at once, with every look.

It is the adjustment of `estimator.adjustment`, of a few dozen tracks: they are so few that the dense system of their unknowns
theta = (s, q, R) is solved in a fraction of a millisecond, once the poses are eliminated look by look (`section_rows`).
`ContourFilter`, which is made for hundreds of tracks, linearises a look but once: with few tracks and poses that are off by
1 mm and 1 mrad, the path that it finds is bent across the sections' planes, by several of its standard deviations. Here a
look keeps its linear equations only as long as the sections stay where they were, and looks do not become many more.
"""

import numpy as np
from scipy.linalg import LinAlgError
from scipy.linalg.lapack import dpotrf, dpotri, dpotrs  # pyright: ignore[reportAttributeAccessIssue]

from extremal.estimator.adjustment import FAR, LOOSE
from extremal.estimator.camera import Array
from extremal.estimator.slant import FAR as FAR_SLANT
from extremal.tasks.section_arcs import widen
from extremal.tasks.section_looks import Looks, Sums
from extremal.tasks.section_rows import placed, tell
from extremal.tasks.section_slant import smoothed
from extremal.tasks.section_solution import Solution, Spread

MOST_LOOKS = 120  # that are kept: of more, the one goes whose neighbours are nearest to each other
EARLY = 12  # looks, before which none is an outlier
FIRST_STEPS = 3  # from nothing known
RECENT = 4  # looks that are linearised anew with every look
MOVED = 0.002  # [m] by which half of the sections have moved when all looks are linearised anew,
GROWTH = 1.25  # or factor on the number of looks
SPREAD_GROWTH = 1.08  # factor on the number of looks, after which covariances are computed anew
ACROSS_PRIOR, DEPTH_PRIOR, RADIUS_PRIOR = 0.1, 0.06, 0.06  # sigma of s [m], q (share of the distance), R [m]
LARGEST_RADIUS = 0.3  # [m] at which looks are linearised


class SectionSmoother:
    """Least squares on all looks.

    Attributes:
        fixed: (n,) sections that are believed to be fixed: where looks are linearised.
        first, last: (n,) [rad] least and largest angle from N_0 in which sections were seen; infinite of none.
        count: number of looks that were taken in.
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
        # objects stand on tables, near where they were first seen
        prior = [np.full(n, ACROSS_PRIOR), DEPTH_PRIOR * distance, np.full(n, RADIUS_PRIOR)]
        self._prior = np.stack(prior, axis=1) ** -2.0
        self._theta = self._at = np.zeros((n, 3))  # now, and where looks were linearised
        self._looks, self._told = Looks(n), 0  # of the first looks is known what they say; the others wait
        self._settled = Sums.prior(self._prior)  # of all but the latest looks
        self._settled_looks, self._repeats = 0, np.zeros(n)
        self.first, self.last, self._views = np.full(n, np.inf), np.full(n, -np.inf), np.zeros(n)
        self._due = self._spread_due = 0.0  # number of looks
        self._spread: Spread | None = None
        self.count = 0

    def update(self, believed: Array, root: Array, normals: Array, sigma: Array) -> None:
        """Take in a look.

        Args:
            believed: (4, 4) pose. root: (6, K) square root of its covariance.
            normals: (n, 3) unit normals of the tangent planes in the camera frame, on the side of N_0.
            sigma: (n,) [rad] of the planes' angles about the camera centre; infinite where unseen.
        """
        self._looks.add(believed, root, normals, sigma)
        widen(believed, normals, sigma, self._sections[1], self.first, self.last, self._views)
        self.count += 1
        if self._looks.count > MOST_LOOKS:
            self._leave_one_out()

    def _leave_one_out(self) -> None:
        i = self._looks.nearest()
        out = self._looks.part(i, i + 1)
        self._views -= np.isfinite(out.sigma[0])
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
        if self.count >= self._due:
            return True
        moved = np.abs(self._theta - self._at).max(axis=1) > MOVED
        return bool(2 * np.count_nonzero(moved) > len(moved))

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
            self._at, self._repeats = self._theta, self._repeated()
        self._tell(first, robust)
        self._told = self._looks.count
        settled = max(first, self._told - RECENT)
        if first == 0:
            self._settled, self._settled_looks = Sums.prior(self._prior), 0
        self._settled.add(self._looks.part(self._settled_looks, settled))
        self._settled_looks = settled
        sums = self._settled.copy()
        sums.add(self._looks.part(settled))
        return sums

    def _tell(self, first: int, robust: bool) -> None:
        """Let looks from the first on say what they do at what is known now."""
        rows, theta, far = self._looks.part(first), self._theta, FAR if robust else np.inf
        said = rows.loss, rows.pull, rows.inverse
        z, poses, planes = placed(rows.believed, rows.root, rows.normals, theta, *said)
        origin, frame, distance = self._sections
        if self._noisy_slant and first == 0:
            planes = smoothed(poses, planes, rows.sigma, theta, origin, frame, FAR_SLANT)
        tell(
            poses, z, planes, rows.root, rows.sigma, theta, origin, frame, distance, self._repeats, far,
            rows.blocks, rows.loss, rows.right, rows.pull, rows.inverse,
        )  # fmt: skip

    def _repeated(self) -> Array:
        """What is added to sigma (n,) [rad] in quadrature, for errors that repeat."""
        arc = np.maximum(self.last - self.first, 0.0)
        return self._systematic * np.sqrt(np.maximum(self._views / (1 + arc / self._turn), 1.0))

    def _step(self, sums: Sums) -> Solution:
        """Solve normal equations, which are lost."""
        factor, failed = dpotrf(sums.matrix.T, lower=1, clean=0, overwrite_a=1)
        if failed:
            raise LinAlgError("the information on sections is not positive definite")
        theta = dpotrs(factor, sums.right, lower=1)[0].reshape(-1, 3)
        if self._spread is None or self.count >= self._spread_due:
            covariance = dpotri(factor, lower=1, overwrite_c=1)[0].T
            self._spread = Spread(covariance, sums.blocks, self._sections[2])
            self._spread_due = SPREAD_GROWTH * self.count
        solution = Solution(theta, self._spread)
        held = solution.held_theta(self.fixed)
        self._theta = np.minimum(np.maximum(held, -self._reach), self._reach)
        return solution
