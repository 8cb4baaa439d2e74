"""Cubic B-splines through the contours of one image, all in a single knot vector.

Contour k owns the parameter interval breaks[k] .. breaks[k + 1] (arc length in pixels); knots of full multiplicity
at the breaks decouple the contours, so that fitting and evaluating them all is one banded problem.
"""

import itertools
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.sparse import csr_array

from extremal.estimator.camera import Array

DEGREE = 3


@dataclass(frozen=True, eq=False)
class Splines:
    """Curves u -> (x, y) [px]; breaks (C + 1,) [px] separate the contours' parameter intervals."""

    curve: BSpline
    breaks: Array

    def contour_of(self, u: Array) -> np.ndarray:
        return np.clip(np.searchsorted(self.breaks, u, side="right") - 1, 0, len(self.breaks) - 2)

    def clamp(self, u: Array, contour: np.ndarray) -> Array:
        """Parameters u moved into the interval of their contour."""
        return np.clip(u, self.breaks[contour], np.nextafter(self.breaks[contour + 1], 0))

    def frame(self, u: Array) -> tuple[Array, Array, Array, Array]:
        """Positions (..., 2), unit tangents, unit left normals (ty, -tx), and curvature (...) [1/px] at u (...).

        Curvature is positive where the contour bends towards its left normal.
        """
        position, first, second = self.curve(u), self.curve(u, 1), self.curve(u, 2)
        speed = np.linalg.norm(first, axis=-1)
        tangent = first / speed[..., None]
        normal = np.stack([tangent[..., 1], -tangent[..., 0]], axis=-1)
        return position, tangent, normal, np.sum(second * normal, axis=-1) / speed**2


def arc_length(positions: Array, chain: np.ndarray) -> tuple[Array, Array]:
    """Parameters (n,) of ordered points (n, 2) and the breaks (C + 1,) between their chains."""
    step = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    step[np.diff(chain) != 0] = 1.0
    u = np.concatenate([[0.5], 0.5 + np.cumsum(step)])
    start = np.flatnonzero(np.concatenate([[True], np.diff(chain) != 0]))
    return u, np.concatenate([u[start] - 0.5, [u[-1] + 0.5]])


def knots(u: Array, contour: np.ndarray, breaks: Array, spacing: Array, most: np.ndarray) -> Array:
    """Knot vector with locally `spacing` (n,) [px] between knots, given at u (n,), at most `most` (C,) intervals each."""
    pieces = [np.repeat(breaks[0], DEGREE + 1)]
    edge = np.searchsorted(contour, np.arange(len(breaks)))
    for k, (start, end) in enumerate(itertools.pairwise(breaks)):
        at = u[edge[k] : edge[k + 1]]
        middle = np.concatenate([[start], 0.5 * (at[:-1] + at[1:]), [end]])
        width = np.diff(middle)
        width = np.minimum(
            width, 1.5 * np.median(width)
        )  # a gap in the data takes no more knots than one datum
        total = np.concatenate([[0.0], np.cumsum(width / spacing[edge[k] : edge[k + 1]])])
        intervals = int(max(1, min(round(total[-1]), most[k])))
        inner = np.interp(np.linspace(0, total[-1], intervals + 1)[1:-1], total, middle)
        pieces += [inner, np.repeat(end, DEGREE + 1)]
    return np.concatenate(pieces)


def fit(
    u: Array, positions: Array, weights: Array, t: Array, breaks: Array, at: Array
) -> tuple[Splines, Array]:
    """Least-squares splines through positions (n, 2) at u (n,), and their variance (m,) at parameters `at` (m,).

    weights (n,) are 1 / sigma across the contour. A trace of smoothness decides where the data leave a coefficient open.
    """
    design = BSpline.design_matrix(u, t, DEGREE)
    weighted = design.multiply(weights[:, None] ** 2).tocsr()
    normal = (weighted.T @ design).tocsr()
    normal = normal + 1e-7 * normal.diagonal().max() * _bending(t, breaks)
    banded = np.stack([np.concatenate([np.zeros(k), normal.diagonal(k)]) for k in range(DEGREE, -1, -1)])
    factor = (cholesky_banded(banded), False)
    curve = BSpline(t, cho_solve_banded(factor, weighted.T @ positions), DEGREE)
    wanted = BSpline.design_matrix(at, t, DEGREE).tocsr()
    solved = cho_solve_banded(factor, wanted.T.toarray())
    return Splines(curve, breaks), np.asarray(wanted.multiply(solved.T).sum(axis=1)).ravel()


def _bending(t: Array, breaks: Array) -> csr_array:
    """Sum of squared second differences of the coefficients of each contour, as a matrix."""
    count = len(t) - DEGREE - 1
    own = np.searchsorted(
        breaks, 0.5 * (t[:count] + t[DEGREE + 1 :])
    )  # the contour on which each one's support lies
    rows = np.arange(count - 2)
    same = own[:-2] == own[2:]
    difference = csr_array(
        (
            np.outer(same, [1.0, -2.0, 1.0]).ravel(),
            (np.repeat(rows, 3), (rows[:, None] + np.arange(3)).ravel()),
        ),
        shape=(count - 2, count),
    )
    return difference.T @ difference
