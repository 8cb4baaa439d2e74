"""What is told of tracked sections: one rule for every sensor.

A circle that is fitted to an arc is the osculating circle near the middle of that arc, where a linear change of the radius
of curvature cancels; at the arc's end, where tracks start, it is off by that change. So the contact point that is told of is
the one half-way between the first and the last direction in which the section was seen.
"""

import math

import numpy as np
from numpy.typing import NDArray

from extremal.estimator.camera import Array
from extremal.estimator.estimates import DRIFT
from extremal.tasks.compiled import compiled
from extremal.tasks.edge_model import EdgeModel
from extremal.tasks.features import Features, Radii, labelled
from extremal.tasks.section_arcs import crossing, middles
from extremal.tasks.section_references import references
from extremal.tasks.section_smoother import SectionSmoother
from extremal.tasks.section_solution import Sections, Solution

LEAST_TILT = (
    0.5  # sine of the angle between contour and epipolar line: what pose errors do to less is not linear
)
STEEPER = 1.2  # than that, where tracks start
FIRST_BOOTSTRAP, BOOTSTRAP_GROWTH = 8, 1.2  # looks, and factor on their number
SETTLED = 16  # looks
FARTHEST = 3.5  # standard deviations by which references may shift all radii
KNOWN = 0.01  # [m] sigma of a radius from which a section that is not told from a fixed one is taken for one
LEAST_REFERENCES = 5  # from which they tell how well sigma describes their errors
MEDIAN_CHI2 = 0.4549  # of one degree of freedom


class SectionTracks:
    """n sections that are followed, whose references are bootstrapped as looks come in.

    Attributes:
        contour: (n,) image contour of each, in order along it.
        visible: (n,) whether it was seen in the last look.
    """

    def __init__(
        self,
        origin: Array,
        frame: Array,
        contour: NDArray[np.integer],
        distance: Array,
        focal: float,
        edges: EdgeModel,
        noisy_slant: bool,
        may_stray: bool = False,
    ) -> None:
        """
        Args:
            origin, frame: (n, 3) [m], (n, 3, 3) as of `SectionSmoother`.
            contour: (n,) image contour of each, in order along it. distance: (n,) [m] of the origins. focal: [px].
            edges: whose biases are taken into account. noisy_slant: as of `SectionSmoother`.
            may_stray: whether tracks may go over to other contours.
        """
        self._smoother = SectionSmoother(
            origin, frame, distance, edges.bias_px / focal, edges.bias_turn, noisy_slant
        )
        self._origin, self._frame, self.contour = origin, np.ascontiguousarray(frame), contour
        self._drift, self._may_stray = DRIFT * distance / focal, may_stray
        self._looks, self._due = 0, float(FIRST_BOOTSTRAP)
        self._next, self._told = 0, Features.empty()
        n = len(origin)
        self._normals = np.zeros((32, n, 3))  # of every look, in the world; zero where unseen
        self._views, self.visible = np.zeros(n, int), np.zeros(n, bool)

    def take_in(self, believed: Array, root: Array, normals: Array, sigma: Array) -> NDArray[np.bool_]:
        """Take in a look, as `SectionSmoother.update` does, and say which (n,) planes are of other contours.

        They are left out, as those that hardly cross the planes of their sections are: see `visible`.
        """
        if self._looks == len(self._normals):
            self._normals = np.concatenate([self._normals, np.zeros_like(self._normals)])
        there = self._normals[self._looks]
        strayed = np.zeros(len(sigma), bool)
        if self._may_stray:
            strayed = self._smoother.strayed(believed, root, normals, sigma, self.contour)
            sigma = np.where(strayed, np.inf, sigma)
            self._normals[: self._looks, self._smoother.anew] = 0.0
            self._views[self._smoother.anew] = 0
        seen = crossing(believed, normals, sigma, self._frame, LEAST_TILT, there)
        self._smoother.update(believed, root, normals, np.where(seen, sigma, np.inf))
        self._views += seen
        self.visible = seen
        self._looks += 1
        return strayed

    @property
    def fixed(self) -> NDArray[np.bool_]:
        """(n,) references, and sections whose radius is known within KNOWN and not told from zero, as of the last features."""
        told = self._told
        if len(told) == 0:
            return np.zeros(len(self._origin), bool)
        return told.reference | ((told.best_sigma < KNOWN) & ~told.extremal)

    def features(self, pixels: Array) -> Features:
        """What is known; pixels (n, 2) where tracks were last seen. Of more than SETTLED looks, every second one brings new estimates."""
        if len(self._origin) == 0:
            return Features.empty()
        if self._looks >= self._next:
            self._next = self._looks + (1 if self._looks < SETTLED else 2)
            self._told = self._estimated(pixels)
        return self._told.changed(pixels=pixels, visible=self.visible, views=self._views.copy())

    def _estimated(self, pixels: Array) -> Features:
        solution = self._smoother.solve()
        free = solution.free
        if self._looks >= self._due:
            self._due = self._looks * BOOTSTRAP_GROWTH
            own, shared = solution.spread.shared()
            own = np.where(free.valid, own, np.inf)
            found = references(free.radius, own, shared, self.contour)
            self._smoother.fixed = found & (_shift(solution, found) < FARTHEST)
        fixed = self._smoother.fixed
        held, ratio = None, 1.0
        if fixed.any():
            held = solution.held(fixed)
            ratio = _birge_ratio(held, fixed)
        best, smoother = held or free, self._smoother
        position, covariance, normal = middles(
            self._origin, self._frame, smoother.middle, smoother.change, self._normals[: self._looks],
            best.theta, best.covariance, best.valid, ratio,
        )  # fmt: skip
        return labelled(
            self._radii(free, 1.0),
            None if held is None else self._radii(held, ratio),
            position,
            covariance,
            normal,
            self._frame[:, 2],
            fixed.copy(),
            self.contour,
            pixels,
            self.visible,
            self._views,
        )

    def _radii(self, found: Sections, ratio: float) -> Radii:
        return Radii(found.radius, np.hypot(ratio * found.sigma, self._drift))


def _shift(solution: Solution, fixed: NDArray[np.bool_]) -> float:
    """By how many standard deviations all radii move together where some are held at zero: most of the others tell."""
    free, held = solution.free, solution.held(fixed)
    rows = held.valid & ~fixed
    if not rows.any():
        return 0.0
    learnt = np.sqrt(np.maximum(free.sigma[rows] ** 2 - held.sigma[rows] ** 2, 1e-12))
    return float(np.median(np.abs(free.radius - held.radius)[rows] / learnt))


def _birge_ratio(found: Sections, fixed: NDArray[np.bool_]) -> float:
    """How much larger than sigma the radii of references are, which should be 0; at least 1 (Birge, Phys. Rev. 40, 207, 1932).

    What a circle leaves of a section, and errors of edges that views share, are not all in sigma.
    """
    median, count = _median_chi2(found.radius, found.sigma, fixed & found.valid)
    return math.sqrt(max(1.0, median / MEDIAN_CHI2)) if count >= LEAST_REFERENCES else 1.0


@compiled
def _median_chi2(radius: Array, sigma: Array, rows: NDArray[np.bool_]) -> tuple[float, int]:
    """Median of (radius / sigma)^2 of rows (n,), and how many they are."""
    chi2 = np.sort((radius[rows] / sigma[rows]) ** 2)
    count = len(chi2)
    return (0.5 * (chi2[(count - 1) // 2] + chi2[count // 2]) if count else math.nan), count
