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

from extremal.estimator.adjustment import LOOSE
from extremal.estimator.camera import Array
from extremal.tasks.section_rows import Looks, SectionModel, Sums, Told, fitting_poses
from extremal.tasks.section_solution import Solution, Spread

MOST_LOOKS = 120  # that are kept: of more, the one goes whose neighbours are nearest to each other
EARLY = 12  # looks, before which none is an outlier
FIRST_STEPS = 2  # from nothing known
RECENT = 8  # looks that are linearised anew with every look
MOVED = 0.002  # [m] by which half of the sections have moved when all looks are linearised anew,
GROWTH = 1.25  # or factor on the number of looks
SPREAD_GROWTH = 1.08  # factor on the number of looks, after which covariances are computed anew
ACROSS_PRIOR, DEPTH_PRIOR, RADIUS_PRIOR = 0.1, 0.06, 0.06  # sigma of s [m], q (share of the distance), R [m]
LARGEST_RADIUS = 0.3  # [m] at which looks are linearised


class SectionSmoother:
    """Least squares on all looks.

    Attributes:
        fixed: (n,) sections that are believed to be fixed: where looks are linearised.
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
        self._model = SectionModel(origin, frame, distance, systematic, turn, noisy_slant)
        self._distance = distance
        # where little is known, a step may lead out of what the linear model means
        self._reach = np.stack([LOOSE * distance] * 2 + [np.full(n, LARGEST_RADIUS)], axis=1)
        # objects stand on tables, near where they were first seen
        prior = [np.full(n, ACROSS_PRIOR), DEPTH_PRIOR * distance, np.full(n, RADIUS_PRIOR)]
        self._prior = np.stack(prior, axis=1) ** -2.0
        self._theta = self._at = np.zeros((n, 3))  # now, and where looks were linearised
        self._looks: list[Looks] = []
        self._told: list[Told] = []  # of the first looks; the others wait
        self._settled = self._sums = Sums.prior(self._prior)  # of all but the latest looks, and of all
        self._settled_looks, self._repeats = 0, np.zeros(n)
        self._due = self._spread_due = 0.0  # number of looks
        self._spread: Spread | None = None
        self.count = 0

    def update(self, believed: Array, root: Array, normals: Array, sigma: Array) -> None:
        """Take in a look.

        Args:
            believed: (4, 4) pose. root: (6, K) square root of its covariance, K the same in all looks.
            normals: (n, 3) unit normals of the tangent planes in the camera frame, on the side of N_0.
            sigma: (n,) [rad] of the planes' angles about the camera centre; infinite where unseen.
        """
        self._looks.append(Looks.one(believed, root, normals, sigma))
        self.count += 1
        if len(self._looks) > MOST_LOOKS:
            self._leave_one_out()

    def _leave_one_out(self) -> None:
        centres = np.array([look.believed[0, :3, 3] for look in self._looks])
        gap = np.linalg.norm(centres[2:] - centres[:-2], axis=1)
        i = 1 + int(np.argmin(gap))
        del self._looks[i]
        if i < self._settled_looks:
            self._settled.add(self._told[i], -1.0)
            self._settled_looks -= 1
        del self._told[i : i + 1]

    def solve(self) -> Solution:
        """Step from the last solution, and what is known of all sections. Without a new look, a further Gauss-Newton step."""
        latest = len(self._looks) if self._model.noisy_slant else RECENT
        if self._is_stale():
            self._due = min(GROWTH * self.count, EARLY) if self.count < EARLY else GROWTH * self.count
            for _ in range(1 if self._told else FIRST_STEPS):
                self._linearise(len(self._looks))
                self._step()
            self._spread = None
        else:
            self._linearise(latest)
            self._step()
        # a new look is weighed by how far it is from what is known with it, not from what was known before
        self._linearise(latest)
        theta = self._step()
        if self._spread is None or self.count >= self._spread_due:
            self._spread = self._found_spread()
            self._spread_due = SPREAD_GROWTH * self.count
        return Solution(theta, self._spread)

    def _is_stale(self) -> bool:
        if self._model.noisy_slant or self.count >= self._due or len(self._told) == len(self._looks):
            return True
        moved = np.abs(self._theta - self._at).max(axis=1) > MOVED
        return bool(2 * np.count_nonzero(moved) > len(moved))

    def _linearise(self, latest: int) -> None:
        """Linearise the `latest` looks anew, those that wait among them: at what is known now."""
        first = min(max(len(self._looks) - latest, 0), len(self._told))
        looks, old = Looks.together(self._looks[first:]), self._told[first:]
        if old:
            looks.z[: len(old)] = fitting_poses(old, self._theta)
        anew = first == 0
        if anew:
            self._at, self._repeats = self._theta, self._model.repeated(looks)
        told = self._model.told(looks, self._theta, self._repeats, robust=self.count >= EARLY)
        self._told[first:] = told.each()
        settled = max(first, len(self._looks) - RECENT)
        if anew:
            self._settled = Sums.prior(self._prior)
            self._settled.add(told.part(slice(settled)))
        else:
            for one in self._told[self._settled_looks : settled]:
                self._settled.add(one)
        self._settled_looks = settled
        self._sums = self._settled.copy()
        self._sums.add(told.part(slice(settled - first, None)))

    def _step(self) -> Array:
        """Solve: theta (n, 3) where nothing is fixed."""
        self._factor, failed = dpotrf(self._sums.matrix, lower=1)
        if failed:
            raise LinAlgError("the information on sections is not positive definite")
        theta = dpotrs(self._factor, self._sums.right, lower=1)[0].reshape(-1, 3)
        held = theta
        if self.fixed.any():
            spread = self._spread or self._found_spread()
            held = Solution(theta, spread).held(self.fixed).theta
        self._theta = np.minimum(np.maximum(held, -self._reach), self._reach)
        return theta

    def _found_spread(self) -> Spread:
        lower = dpotri(self._factor, lower=1)[0]  # the other triangle is zero
        covariance = lower + lower.T
        np.einsum("ii->i", covariance)[:] *= 0.5
        return Spread(covariance, self._sums.blocks, self._distance)
