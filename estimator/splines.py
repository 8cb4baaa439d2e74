"""Cubic B-splines through the contours of one image, all in a single knot vector.

Contour k owns the parameter interval breaks[k] .. breaks[k + 1] (arc length in pixels); knots of full multiplicity
at the breaks decouple the contours, so that fitting and evaluating them all is one banded problem.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import LinAlgError, cho_solve_banded, cholesky_banded
from scipy.linalg.lapack import dtbtrs  # pyright: ignore[reportAttributeAccessIssue]

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


def knots(
    u: Array, contour: np.ndarray, breaks: Array, spacing: Array, most: np.ndarray, widest: float
) -> Array:
    """Knot vector with locally `spacing` (n,) [px] between knots, given at u (n,), at most `most` (C,) intervals each.

    A gap in the data counts for `widest` [px], so that it takes no more knots than a datum.
    """
    first = np.searchsorted(contour, np.arange(len(breaks)))
    edges = np.concatenate([u[:1], 0.5 * (u[:-1] + u[1:]), breaks[-1:]])
    edges[first] = breaks
    total = np.concatenate([[0.0], np.cumsum(np.minimum(np.diff(edges), widest) / spacing)])
    ends = total[first]
    intervals = np.clip(np.rint(np.diff(ends)).astype(int), 1, np.maximum(most, 1))
    owner = np.repeat(np.arange(len(intervals)), intervals - 1)
    step = np.arange(len(owner)) - np.repeat(np.cumsum(intervals - 1) - (intervals - 1), intervals - 1) + 1
    inner = np.interp(ends[owner] + step / intervals[owner] * np.diff(ends)[owner], total, edges)
    return np.sort(np.concatenate([inner, np.repeat(breaks, DEGREE + 1)]))


@dataclass(frozen=True, eq=False)
class Fit:
    """Splines with the Cholesky factor of their information, upper banded, and the basis functions at the data."""

    splines: Splines
    factor: Array
    values: Array
    column: np.ndarray

    def again(self, positions: Array, weights: Array) -> "Fit":
        """The same fit to other positions (n, 2), with other weights (n,)."""
        return _fitted(
            self.values, self.column, positions, weights, self.splines.curve.t, self.splines.breaks
        )

    def variance(self) -> Array:
        """Variance (n,) of the curve across itself at the data: |L^-1 b|^2 of the basis functions b there."""
        n, count = len(self.column), self.factor.shape[1]
        wanted = np.zeros((count, n))
        wanted[self.column + np.arange(DEGREE + 1)[:, None], np.arange(n)] = self.values.T
        half, failed = dtbtrs(self.factor, wanted, uplo="U", trans="T")
        if failed:
            raise LinAlgError("the information on a spline is singular")
        return np.einsum("ij,ij->j", half, half)


def fit(u: Array, positions: Array, weights: Array, t: Array, breaks: Array) -> Fit:
    """Least-squares splines through positions (n, 2) at u (n,).

    weights (n,) are 1 / sigma across the contour. A trace of smoothness decides where the data leave a coefficient open.
    """
    return _fitted(*_basis(u, t), positions, weights, t, breaks)


def _fitted(
    values: Array, column: np.ndarray, positions: Array, weights: Array, t: Array, breaks: Array
) -> Fit:
    count = len(t) - DEGREE - 1
    weighted = values * weights[:, None] ** 2
    banded = np.zeros((DEGREE + 1, count))
    right = np.zeros((count, 2))
    for i in range(DEGREE + 1):
        for j in range(i, DEGREE + 1):  # LAPACK's upper form: row DEGREE + i - j holds entry (i, j)
            banded[DEGREE + i - j] += np.bincount(column + j, weighted[:, i] * values[:, j], count)
        for k in range(2):
            right[:, k] += np.bincount(column + i, weighted[:, i] * positions[:, k], count)
    banded += 1e-7 * banded[DEGREE].max() * _bending(t, breaks)
    factor = cholesky_banded(banded, check_finite=False)
    curve = BSpline(t, cho_solve_banded((factor, False), right, check_finite=False), DEGREE)
    return Fit(Splines(curve, breaks), factor, values, column)


def _basis(u: Array, t: Array) -> tuple[Array, np.ndarray]:
    """The DEGREE + 1 basis functions (n, DEGREE + 1) that differ from zero at u (n,), and the first's index (n,)."""
    design = BSpline.design_matrix(u, t, DEGREE)
    values: Array = np.asarray(design.data, float).reshape(len(u), DEGREE + 1)
    return values, np.asarray(design.indices, np.intp).reshape(len(u), DEGREE + 1)[:, 0]


def _bending(t: Array, breaks: Array) -> Array:
    """Sum of squared second differences of the coefficients of each contour, in LAPACK's upper banded form."""
    count = len(t) - DEGREE - 1
    middle = 0.5 * (t[:count] + t[DEGREE + 1 :])
    own = np.searchsorted(breaks, middle)  # the contour on which each one's support lies
    same = (own[:-2] == own[2:]).astype(float)
    banded = np.zeros((DEGREE + 1, count))
    stencil = (1.0, -2.0, 1.0)
    for i in range(3):
        for j in range(i, 3):
            banded[DEGREE + i - j, j : j + count - 2] += same * stencil[i] * stencil[j]
    return banded
