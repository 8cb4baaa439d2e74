"""Cubic B-splines through the contours of one image, all in a single knot vector.

Contour k owns the parameter interval breaks[k] .. breaks[k + 1] (arc length in pixels); knots of full multiplicity
at the breaks decouple the contours, so that fitting and evaluating them all is one banded problem.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline, make_lsq_spline
from scipy.linalg import solveh_banded

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


def knots(breaks: Array, spacing: Array, most: np.ndarray) -> Array:
    """Knot vector with `spacing` (C,) [px] between knots, at most `most` (C,) intervals a contour."""
    pieces = [np.repeat(breaks[0], DEGREE + 1)]
    for start, end, h, limit in zip(breaks[:-1], breaks[1:], spacing, most, strict=True):
        intervals = int(max(1, min(round((end - start) / h), limit)))
        pieces += [np.linspace(start, end, intervals + 1)[1:-1], np.repeat(end, DEGREE + 1)]
    return np.concatenate(pieces)


def fit(u: Array, positions: Array, weights: Array | None, t: Array, breaks: Array) -> Splines:
    """Least-squares splines through positions (n, 2) at u (n,), weights (n,) = 1 / sigma."""
    return Splines(make_lsq_spline(u, positions, t, k=DEGREE, w=weights), breaks)


def leverage_variance(u: Array, weights: Array, t: Array, at: Array) -> Array:
    """Variance (m,) at parameters `at` of the spline fitted with weights 1 / sigma (n,) at u (n,)."""
    design = BSpline.design_matrix(u, t, DEGREE).multiply(weights[:, None]).tocsr()
    normal = (design.T @ design).todia()
    banded = np.zeros((DEGREE + 1, normal.shape[0]))
    for k in range(DEGREE + 1):
        diagonal = normal.diagonal(k)
        banded[DEGREE - k, k:] = diagonal
    wanted = BSpline.design_matrix(at, t, DEGREE).tocsr()
    solved = solveh_banded(banded, wanted.T.toarray())
    return np.asarray(wanted.multiply(solved.T).sum(axis=1)).ravel()
