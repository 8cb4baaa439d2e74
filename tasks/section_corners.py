"""Sections with a corner: tracks that went over to the next edge.

Where a box turns one edge away, the next one becomes its outline. A track goes over to it unnoticed: by a fraction of a pixel at first,
as the contact point of a limb would. If that is seen before poses are known, a circle of some centimetres goes through both edges, and
what follows is judged by it. But the section's support has a kink at the direction phi* in which one edge hides the other,

    h(phi) = s cos phi + q sin phi + (1 - cos phi) R + l max(0, sin(phi - phi*)),

l [m] the way between them. Of a section that a circle does not fit, even one whose radius changes (`section_rows`), and a corner fits
much better, only the greater part is of one contour.
"""

import math

import numpy as np
from numpy.typing import NDArray

from extremal.estimator.camera import Array
from extremal.tasks.compiled import compiled
from extremal.tasks.section_rows import NEAREST, equation
from extremal.tasks.section_unknowns import unknowns
from extremal.tasks.triples import dot, plus, row, row_in

LEAST_LOOKS = 8  # of a section that is judged
LEAST_PART = 2  # looks on either side of a corner
MISFIT = 4.0  # chi^2 of a look that no circle explains
BETTER = 0.5  # of it is left by a corner, at most
RIDGE = 1e-10  # of the information, where few looks leave a number open


@compiled
def beyond_corners(
    poses: Array,
    planes: Array,
    sigma: Array,
    theta: Array,
    middle: Array,
    origin: Array,
    frame: Array,
    distance: Array,
) -> NDArray[np.bool_]:
    """Which (V, n) of V looks at n sections are of the lesser part of a section with a corner.

    Args:
        poses: (V, 4, 4), planes: (V, n, 3) in the world, as they are `placed`. sigma: (V, n) [rad], infinite where unseen.
        theta, middle, origin, frame, distance: as of `section_rows`.
    """
    looks, n = sigma.shape
    out = np.zeros((looks, n), np.bool_)
    X, y, phi, reach = np.empty((looks, 4)), np.empty(looks), np.empty(looks), np.empty(looks)
    for i in range(n):
        seen = np.flatnonzero(np.isfinite(sigma[:, i]))
        count = len(seen)
        if count < LEAST_LOOKS:
            continue
        for m in range(count):
            v = seen[m]
            plane, N, T = row_in(planes, v, i), row_in(frame, i, 0), row_in(frame, i, 1)
            lever = plus((poses[v, 0, 3], poses[v, 1, 3], poses[v, 2, 3]), -1.0, row(origin, i))
            x, _, _, miss, weight = equation(
                plane, sigma[v, i], unknowns(theta, i), middle[i], lever, N, T, NEAREST * distance[i], math.inf,
            )  # fmt: skip
            a, b = dot(N, plane), dot(T, plane)
            for j in range(4):
                X[m, j] = weight * x[j]
            y[m], phi[m], reach[m] = weight * miss, math.atan2(b, a), weight * math.sqrt(a * a + b * b)
        left = _left(X[:count], y[:count])
        if left < MISFIT * count:
            continue
        at, best = _corner(X[:count], y[:count], phi[:count], reach[:count])
        if best < BETTER * left:
            above = phi[:count] > at
            lesser = np.sum(above) * 2 <= count
            for m in range(count):
                out[seen[m], i] = above[m] == lesser
    return out


@compiled
def _corner(X: Array, y: Array, phi: Array, reach: Array) -> tuple[float, float]:
    """phi* between the looks that leaves least of y (m,), and how much; X: (m, 4), of which the last column is not used."""
    count, order = len(y), np.argsort(phi)
    at, best, A = 0.0, math.inf, X.copy()
    for k in range(LEAST_PART, count - LEAST_PART + 1):
        middle = float(0.5 * (phi[order[k - 1]] + phi[order[k]]))
        for m in range(count):
            A[m, 3] = reach[m] * max(math.sin(phi[m] - middle), 0.0)
        left = _left(A, y)
        if left < best:
            at, best = middle, left
    return at, best


@compiled
def _left(A: Array, y: Array) -> float:
    """Sum of squares that least squares on columns A (m, 4) leave of y (m,)."""
    information, right = A.T @ A, A.T @ y
    for j in range(4):
        information[j, j] += RIDGE * information[j, j] + 1e-12
    return float(y @ y - right @ np.linalg.solve(information, right))
