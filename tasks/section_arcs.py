"""The arcs of sections that were seen, and what is told of in their middles.

Normals of n sections are N(phi) = N_0 cos phi + T_0 sin phi of their frames (n, 3, 3), rows N_0, T_0, N_0 x T_0.
"""

import math

import numpy as np
from numpy.typing import NDArray

from extremal.estimator.camera import Array
from extremal.tasks.compiled import compiled
from extremal.tasks.section_unknowns import changed
from extremal.tasks.triples import Vector, dot, plus, put, row, times, turned


@compiled
def crossing(
    believed: Array, normals: Array, sigma: Array, frame: Array, least: float, there: Array
) -> NDArray[np.bool_]:
    """Which (n,) of the tangent planes of a look were seen and cross the planes of their sections by an angle of a sine of
    at least `least`.

    Args:
        believed: (4, 4). normals: (n, 3) in the camera frame. sigma: (n,) infinite where unseen.
        there: (n, 3) becomes the normals in the world, zero of the others.
    """
    n = len(sigma)
    found = np.zeros(n, np.bool_)
    for i in range(n):
        normal = turned(believed, row(normals, i))
        up = dot(row(frame[i], 2), normal)
        found[i] = not math.isinf(sigma[i]) and up * up < 1 - least * least
        put(there, i, times(1.0 if found[i] else 0.0, normal))
    return found


@compiled
def widen(believed: Array, normals: Array, sigma: Array, frame: Array, first: Array, last: Array) -> None:
    """Take a look into the least and largest angle phi (n,) [rad] in which sections were seen."""
    for i in range(len(sigma)):
        if not math.isinf(sigma[i]):
            normal = turned(believed, row(normals, i))
            phi = math.atan2(dot(row(frame[i], 1), normal), dot(row(frame[i], 0), normal))
            first[i], last[i] = min(first[i], phi), max(last[i], phi)


@compiled
def arc_middle(first: Array, last: Array) -> Array:
    """Middles (n,) [rad] of arcs from `first` to `last` (n,) [rad]; 0 of none."""
    out = np.zeros(len(first))
    for i in range(len(first)):
        if first[i] <= last[i]:
            out[i] = 0.5 * (first[i] + last[i])
    return out


@compiled
def middles(
    origin: Array,
    frame: Array,
    middle: Array,
    change: Array,
    seen: Array,
    theta: Array,
    spread: Array,
    valid: NDArray[np.bool_],
    ratio: float,
) -> tuple[Array, Array, Array]:
    """Contact points (n, 3) o + s N_0 + q T_0 + R (N(phi) - N_0) + c (f N(phi) + f' N'(phi)) in the middles of arcs, as of
    `section_rows`, their covariances (n, 3, 3), infinite where not valid, and the surface normals (n, 3) there: slanted as in the look
    that comes nearest.

    Args:
        middle: (n,) [rad] phi. change: (n,) [m/rad] c. seen: (looks, n, 3) normals in the world, zero where unseen.
        theta: (n, 3) with covariance spread (n, 3, 3), where sigma is to be `ratio` times as large.
    """
    n = len(origin)
    points, covariance, normals = np.empty((n, 3)), np.empty((n, 3, 3)), np.empty((n, 3))
    J = np.empty((3, 3))
    for i in range(n):
        cosine, sine = math.cos(middle[i]), math.sin(middle[i])
        N, T, up = row(frame[i], 0), row(frame[i], 1), row(frame[i], 2)
        normal, along = plus(times(cosine, N), sine, T), plus(times(-sine, N), cosine, T)
        put(J, 0, N)
        put(J, 1, T)
        put(J, 2, plus(normal, -1.0, N))
        point = plus(plus(plus(row(origin, i), theta[i, 0], N), theta[i, 1], T), theta[i, 2], row(J, 2))
        f, turned_by = changed(middle[i], middle[i])
        put(points, i, plus(plus(point, change[i] * f, normal), change[i] * turned_by, along))
        for k in range(3):
            for m in range(3):
                covariance[i, k, m] = ratio * ratio * _form(J, spread[i], k, m) if valid[i] else math.inf
        put(normals, i, _slanted(seen[:, i], normal, up))
    return points, covariance, normals


@compiled
def _form(J: Array, spread: Array, k: int, m: int) -> float:
    """(J' spread J) [k, m]."""
    total = 0.0
    for a in range(3):
        for b in range(3):
            total += J[a, k] * spread[a, b] * J[b, m]
    return total


@compiled
def _slanted(seen: Array, middle: Vector, up: Vector) -> Vector:
    """The unit vector `middle`, slanted along `up` as the nearest to it of normals seen (looks, 3)."""
    nearest, best = 0, -math.inf
    for v in range(len(seen)):
        near = dot(row(seen, v), middle)
        if near > best:
            nearest, best = v, near
    a, b = best, dot(row(seen, nearest), up)
    scale = max(math.hypot(a, b), 1e-12)
    return plus(times(a / scale if a != 0 else 1.0, middle), b / scale, up)
