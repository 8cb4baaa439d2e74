"""The slant of contours against the sections' planes, smoothed over the looks: `estimator.slant` for the tracks of a step."""

import math

import numpy as np
from numpy.typing import NDArray

from extremal.estimator.camera import Array
from extremal.estimator.slant import RIDGE
from extremal.tasks.compiled import compiled
from extremal.tasks.triples import Vector, crossed, dot, plus, put, row, row_in, times, unit

ROUNDS = 3
LEAST_STEEP = 1e-6  # of a tangent plane across the section's plane


@compiled
def smoothed(
    poses: Array, planes: Array, sigma: Array, theta: Array, origin: Array, frame: Array, far: float
) -> Array:
    """Tangent planes (V, n, 3) in the world through the same lines in the sections' planes, of smoothed slant.

    The slant n.m / n.N of a section is fitted by c_0 cos phi + c_1 sin phi + c_2 (1 - cos phi) to all looks in which it was
    seen, each weighed by (n.N)^2; those farther than `far` mean deviations off lose weight.

    Args:
        poses: (V, 4, 4). planes: (V, n, 3) as measured. sigma: (V, n), infinite where unseen. theta: (n, 3).
        origin: (n, 3). frame: (n, 3, 3).
    """
    looks, n = sigma.shape
    out = np.empty(planes.shape)
    across, up, columns = np.empty((looks, 3)), np.empty((looks, 3)), np.empty((looks, 3))
    square, slant, seen = np.empty(looks), np.empty(looks), np.empty(looks, np.bool_)
    for i in range(n):
        m = row_in(frame, i, 2)
        point = plus(row(origin, i), theta[i, 0], row_in(frame, i, 0))
        point = plus(point, theta[i, 1], row_in(frame, i, 1))
        for v in range(looks):
            normal = row_in(planes, v, i)
            ray = plus(point, -1.0, (poses[v, 0, 3], poses[v, 1, 3], poses[v, 2, 3]))
            # through the measured planes: a normal is perpendicular to its ray
            ray = unit(plus(ray, -dot(ray, normal), normal))
            N = unit(crossed(ray, m))
            put(across, v, N)
            # m, but perpendicular to the ray, also where a camera is a little off the plane
            higher = crossed(N, ray)
            put(up, v, higher)
            first = row(across, 0)
            cosine, sine, at = dot(N, first), dot(crossed(first, N), m), dot(normal, N)
            put(columns, v, (cosine, sine, 1 - cosine))
            steep = at if abs(at) > LEAST_STEEP else LEAST_STEEP
            slant[v], square[v], seen[v] = (
                dot(normal, higher) / steep,
                steep * steep,
                not math.isinf(sigma[v, i]),
            )
        c = _fitted(columns, slant, square, seen, far)
        for v in range(looks):
            smooth = unit(plus(row(across, v), dot(row(columns, v), c), row(up, v)))
            put(out[v], i, smooth if dot(smooth, row_in(planes, v, i)) >= 0 else times(-1.0, smooth))
    return out


@compiled
def _fitted(columns: Array, slant: Array, square: Array, seen: NDArray[np.bool_], far: float) -> Vector:
    """Coefficients of columns (V, 3) that fit slants (V,), robustly, in the looks in which they were `seen` (V,); square: (V,) of the
    steepness of tangent planes across the section's plane."""
    off, scale, c, none = np.zeros(len(slant)), math.inf, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for _ in range(ROUNDS):
        x, y, z, right = none, none, none, none
        for v in range(len(slant)):
            if seen[v]:
                weight = square[v]
                if off[v] > far * scale:
                    weight *= far * scale / off[v]
                weight *= weight
                column = row(columns, v)
                right = plus(right, weight * slant[v], column)
                x = plus(x, weight * column[0], column)
                y = plus(y, weight * column[1], column)
                z = plus(z, weight * column[2], column)
        c = _solved(x, y, z, right)
        total, count = 0.0, 0
        for v in range(len(slant)):
            if seen[v]:
                # the direction's own error d turns the slant by d / (n . N)^2
                off[v] = abs(dot(row(columns, v), c) - slant[v]) * square[v]
                total += off[v]
                count += 1
        scale = max(total / max(count, 1), 1e-9)
    return c


@compiled
def _solved(x: Vector, y: Vector, z: Vector, right: Vector) -> Vector:
    """Solution of symmetric equations with rows x, y, z by Cholesky, with a ridge where few looks leave a number open."""
    least = 1e-12 * max(x[0], y[1], z[2], 1e-12)
    a = math.sqrt(x[0] + RIDGE * max(x[0], least))
    b, c = x[1] / a, x[2] / a
    d = math.sqrt(y[1] + RIDGE * max(y[1], least) - b * b)
    e = (y[2] - b * c) / d
    f = math.sqrt(z[2] + RIDGE * max(z[2], least) - c * c - e * e)
    p = right[0] / a
    q = (right[1] - b * p) / d
    r = (right[2] - c * p - e * q) / (f * f)
    q = (q - e * r) / d
    return (p - b * q - c * r) / a, q, r
