"""The slant of contours against the sections' planes, smoothed over the looks: `estimator.slant` for the tracks of a step."""

import math

import numpy as np

from extremal.estimator.camera import Array
from extremal.estimator.slant import RIDGE
from extremal.tasks.compiled import compiled
from extremal.tasks.rigid import place
from extremal.tasks.section_rows import inverse_root
from extremal.tasks.triples import Vector, crossed, dot, plus, put, row, turned, turned_back, unit

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
    steep, slant, fitted = np.empty(looks), np.empty(looks), np.empty(looks)
    for i in range(n):
        m = row(frame[i], 2)
        point = plus(plus(row(origin, i), theta[i, 0], row(frame[i], 0)), theta[i, 1], row(frame[i], 1))
        for v in range(looks):
            normal = row(planes[v], i)
            ray = plus(point, -1.0, place(poses[v]))
            # through the measured planes: a normal is perpendicular to its ray
            ray = unit(plus(ray, -dot(ray, normal), normal))
            N = unit(crossed(ray, m))
            put(across, v, N)
            # m, but perpendicular to the ray, also where a camera is a little off the plane
            put(up, v, crossed(N, ray))
            cosine, sine = dot(N, row(across, 0)), dot(crossed(row(across, 0), N), m)
            columns[v, 0], columns[v, 1], columns[v, 2] = cosine, sine, 1 - cosine
            at = dot(normal, N)
            steep[v] = at if abs(at) > LEAST_STEEP else LEAST_STEEP
            slant[v] = dot(normal, row(up, v)) / steep[v]
        _fit(columns, slant, steep, sigma[:, i], far, fitted)
        for v in range(looks):
            smooth = unit(plus(row(across, v), fitted[v], row(up, v)))
            put(out[v], i, plus(smooth, -2.0 * (dot(smooth, row(planes[v], i)) < 0), smooth))
    return out


@compiled
def _fit(columns: Array, slant: Array, steep: Array, sigma: Array, far: float, fitted: Array) -> None:
    """Write the slants (V,) that columns (V, 3) fit, robustly, to those of the looks of finite sigma (V,)."""
    scale = math.inf
    fitted[:] = slant
    for _ in range(ROUNDS):
        gram, right = np.zeros((3, 3)), np.zeros(3)
        total, count = 0.0, 0
        for v in range(len(slant)):
            if math.isinf(sigma[v]):
                continue
            square = steep[v] * steep[v]
            # the direction's own error d turns the slant by d / (n . N)^2
            off = abs(fitted[v] - slant[v]) * square
            weight = square * min(1.0, far * scale / max(off, 1e-12))
            for j in range(3):
                part = weight * weight * columns[v, j]
                right[j] += part * slant[v]
                for k in range(3):
                    gram[j, k] += part * columns[v, k]
        c = _solved(gram, right)
        for v in range(len(slant)):
            fitted[v] = dot(row(columns, v), c)
            if not math.isinf(sigma[v]):
                total += abs(fitted[v] - slant[v]) * steep[v] * steep[v]
                count += 1
        scale = max(total / max(count, 1), 1e-9)


@compiled
def _solved(gram: Array, right: Array) -> Vector:
    """x of gram x = right, (3, 3) symmetric, with a ridge where few looks leave a number open; gram is lost."""
    least = 1e-12 * max(np.max(gram), 1e-12)
    for j in range(3):
        gram[j, j] += RIDGE * max(gram[j, j], least)
    inverse = np.empty((3, 3))
    inverse_root(gram, inverse)
    return turned_back(inverse, turned(inverse, (right[0], right[1], right[2])))
