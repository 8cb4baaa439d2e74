"""Rigid motions as matrices (4, 4) in compiled code: scipy's transforms cost more to make than what they are used for in a step."""

import math

import numpy as np

from extremal.estimator.camera import Array
from extremal.tasks.compiled import compiled
from extremal.tasks.triples import Vector, crossed, dot, times

SMALL = 1e-3  # [rad] below which series are exact to rounding


@compiled
def put_product(out: Array, A: Array, B: Array) -> None:
    """`out` becomes A B, (4, 4)."""
    for i in range(4):
        for j in range(4):
            out[i, j] = A[i, 0] * B[0, j] + A[i, 1] * B[1, j] + A[i, 2] * B[2, j] + A[i, 3] * B[3, j]


@compiled
def product(A: Array, B: Array) -> Array:
    """A B, (4, 4)."""
    out = np.empty((4, 4))
    put_product(out, A, B)
    return out


@compiled
def is_finite(A: Array) -> bool:
    """Whether all numbers (...) are finite."""
    return bool(np.all(np.isfinite(A)))


@compiled
def place(A: Array) -> Vector:
    """Where a motion (4, 4) takes the origin: of T_world_camera, the camera's centre."""
    return A[0, 3], A[1, 3], A[2, 3]


@compiled
def inverse(A: Array) -> Array:
    """A^-1, (4, 4)."""
    out = np.empty((4, 4))
    for i in range(3):
        for j in range(3):
            out[i, j] = A[j, i]
        out[i, 3] = -(A[0, i] * A[0, 3] + A[1, i] * A[1, 3] + A[2, i] * A[2, 3])
        out[3, i] = 0.0
    out[3, 3] = 1.0
    return out


@compiled
def exponential(move: Vector, turn: Vector) -> Array:
    """exp (4, 4) of a twist (translation [m], rotation vector [rad]), by Rodrigues' formula.

    R = 1 + a W + b W^2,    t = (1 + b W + c W^2) move,    a = sin w / w, b = (1 - cos w) / w^2, c = (1 - a) / w^2
    """
    square = turn[0] ** 2 + turn[1] ** 2 + turn[2] ** 2
    w = math.sqrt(square)
    if w < SMALL:
        a, b, c = 1 - square / 6, 0.5 - square / 24, 1 / 6 - square / 120
    else:
        a = math.sin(w) / w
        b, c = 0.5 * (math.sin(w / 2) / (w / 2)) ** 2, (1 - a) / square
    out = np.empty((4, 4))
    across = crossed(turn, move)
    twice = dot(turn, move)
    for i in range(3):
        for j in range(3):
            out[i, j] = b * turn[i] * turn[j] + (1 - b * square if i == j else 0.0)
        out[i, 3] = move[i] + b * across[i] + c * (twice * turn[i] - square * move[i])
        out[3, i] = 0.0
    out[3, 3] = 1.0
    x, y, z = times(a, turn)
    out[2, 1] += x
    out[1, 2] -= x
    out[0, 2] += y
    out[2, 0] -= y
    out[1, 0] += z
    out[0, 1] -= z
    return out


@compiled
def quaternion(m: Array) -> tuple[float, float, float, float]:
    """x, y, z, w, w >= 0, of the rotation of a motion, by its largest component (Shepperd, J. Guidance and Control 1, 1978)."""
    a, e, i = m[0, 0], m[1, 1], m[2, 2]
    xx, yy, zz, ww = 1 + a - e - i, 1 - a + e - i, 1 - a - e + i, 1 + a + e + i
    xy, xz, yz = m[0, 1] + m[1, 0], m[0, 2] + m[2, 0], m[1, 2] + m[2, 1]
    wx, wy, wz = m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]
    if xx >= max(yy, zz, ww):
        x, y, z, w, largest = xx, xy, xz, wx, xx
    elif yy >= max(zz, ww):
        x, y, z, w, largest = xy, yy, yz, wy, yy
    elif zz >= ww:
        x, y, z, w, largest = xz, yz, zz, wz, zz
    else:
        x, y, z, w, largest = wx, wy, wz, ww, ww
    scale = math.copysign(0.5 / math.sqrt(largest), w)
    return scale * x, scale * y, scale * z, scale * w


@compiled
def rotation_vector(m: Array) -> Vector:
    """Rotation vector [rad] of a motion, up to pi long."""
    x, y, z, w = quaternion(m)
    sine = math.sqrt(x * x + y * y + z * z)
    scale = 2 * math.atan2(sine, w) / sine if sine > 0 else 2.0
    return scale * x, scale * y, scale * z


@compiled
def reduced(step: Vector, longest: float) -> Vector:
    """A step, or as much of it as `longest`."""
    length = math.sqrt(step[0] ** 2 + step[1] ** 2 + step[2] ** 2)
    share = min(1.0, longest / max(length, 1e-12))
    return share * step[0], share * step[1], share * step[2]


@compiled
def orthonormal(m: Array) -> None:
    """The rotation of a motion that is almost one becomes one to rounding: R (3 - R'R) / 2."""
    a, b, c = (m[0, 0], m[1, 0], m[2, 0]), (m[0, 1], m[1, 1], m[2, 1]), (m[0, 2], m[1, 2], m[2, 2])
    ab, ac, bc = 0.5 * dot(a, b), 0.5 * dot(a, c), 0.5 * dot(b, c)
    aa, bb, cc = 1.5 - 0.5 * dot(a, a), 1.5 - 0.5 * dot(b, b), 1.5 - 0.5 * dot(c, c)
    for i in range(3):
        m[i, 0] = aa * a[i] - ab * b[i] - ac * c[i]
        m[i, 1] = bb * b[i] - ab * a[i] - bc * c[i]
        m[i, 2] = cc * c[i] - ac * a[i] - bc * b[i]
