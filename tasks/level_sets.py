"""Smooth surfaces as level sets F(p) = 0 of their object frame, F < 0 inside, for compiled loops over points.

What contacts need of `Surface._level` and `Surface._frame` is less than these tell: F, its gradient g and the product H d of
its Hessian with one direction, of any scale.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from extremal.estimator.camera import Array
from extremal.scenes import Box, Ellipsoid, Lathe, Sphere, Superquadric, Surface
from extremal.tasks.compiled import compiled
from extremal.tasks.triples import Vector, dot, plus, row, turned, turned_back

QUADRIC, SUPERQUADRIC, LATHE, BOX, OTHER = range(5)
LEAST_RHO = 1e-12  # [m] from a lathe's axis
LEAST_SHARE = 1e-13  # of a superquadric's semi-axis, within which its inner norm has no derivatives


class Solids(NamedTuple):
    """K objects.

    Attributes:
        kind: (K,) one of the kinds above; of OTHER objects only pose and bounds are told.
        shape: (K, 5): semi-axes of quadrics; semi-axes, 2 / e2 and 2 / e1 of superquadrics; height of lathes; half the size of boxes.
        first: (K + 1,) where in `knots` and `pieces` the profile of an object begins.
        knots: (P,) heights [m] at which pieces of profiles begin; pieces: (P, 4) of cubics, the highest power first.
        rotation: (K, 3, 3), middle: (K, 3) [m] of T_world_object; ball: (K, 4) centre in the object frame and radius [m] of a sphere around.
    """

    kind: NDArray[np.integer]
    shape: Array
    first: NDArray[np.integer]
    knots: Array
    pieces: Array
    rotation: Array
    middle: Array
    ball: Array

    @staticmethod
    def of(surfaces: Sequence[Surface]) -> "Solids":
        """Those of a scene."""
        kinds, shapes = zip(*(_kind_and_shape(s) for s in surfaces), strict=True) if surfaces else ((), ())
        splines = [s.profile.spline if isinstance(s, Lathe) else None for s in surfaces]
        knots = [np.zeros(0) if s is None else s.x[:-1] for s in splines]
        pieces = [np.zeros((0, 4)) if s is None else s.c.T for s in splines]
        return Solids(
            np.array(kinds, int),
            np.array([np.pad(shape, (0, 5 - len(shape))) for shape in shapes]).reshape(-1, 5),
            np.cumsum([0, *map(len, knots)]),
            np.concatenate([np.zeros(0), *knots]),
            np.concatenate([np.zeros((0, 4)), *pieces]),
            np.array([s._rotation for s in surfaces]).reshape(-1, 3, 3),
            np.array([s.T_world_object.translation for s in surfaces]).reshape(-1, 3),
            np.array([np.append(*s._bounds) for s in surfaces]).reshape(-1, 4),
        )


def _kind_and_shape(surface: Surface) -> tuple[int, Sequence[float] | Array]:
    if isinstance(surface, Lathe):
        return LATHE, [surface.profile.height]
    if isinstance(surface, Sphere | Ellipsoid):
        return QUADRIC, surface._axes
    if isinstance(surface, Superquadric):
        return SUPERQUADRIC, [*surface._axes, 2 / surface.e2, 2 / surface.e1]
    return (BOX, surface._half) if isinstance(surface, Box) else (OTHER, [])


@compiled
def local(solids: Solids, k: int, p: Vector) -> Vector:
    """A point of the world in the frame of object k."""
    return turned_back(solids.rotation[k], plus(p, -1.0, row(solids.middle, k)))


@compiled
def world(solids: Solids, k: int, p: Vector) -> Vector:
    """A point of the frame of object k in the world."""
    return plus(turned(solids.rotation[k], p), 1.0, row(solids.middle, k))


@compiled
def profile(solids: Solids, k: int, z: float) -> Vector:
    """r, r' and r'' of lathe k at a height, held at the ends' heights."""
    z = min(max(z, 0.0), solids.shape[k, 0])
    low, high = solids.first[k], solids.first[k + 1]
    while high - low > 1:
        middle = (low + high) // 2
        if solids.knots[middle] < z:
            low = middle
        else:
            high = middle
    a, b, c, d = solids.pieces[low, 0], solids.pieces[low, 1], solids.pieces[low, 2], solids.pieces[low, 3]
    x = z - solids.knots[low]
    return ((a * x + b) * x + c) * x + d, (3 * a * x + 2 * b) * x + c, 6 * a * x + 2 * b


@compiled
def inside(solids: Solids, k: int, p: Vector) -> bool:
    """Whether a point lies within smooth object k, in its frame."""
    kind, shape = solids.kind[k], solids.shape[k]
    if kind == LATHE:
        r = profile(solids, k, p[2])[0]
        return p[0] * p[0] + p[1] * p[1] < r * r and 0 < p[2] < shape[0]
    u, v, w = abs(p[0]) / shape[0], abs(p[1]) / shape[1], abs(p[2]) / shape[2]
    if kind == QUADRIC:
        return u * u + v * v + w * w < 1
    s = u ** shape[3] + v ** shape[3]
    return s ** (shape[4] / shape[3]) + w ** shape[4] < 1


@compiled
def differential(solids: Solids, k: int, p: Vector, d: Vector) -> tuple[float, Vector, Vector]:
    """F, g and H d of smooth object k at a point, for a direction d, in its frame."""
    if solids.kind[k] == LATHE:
        return _of_lathe(solids, k, p, d)
    if solids.kind[k] == QUADRIC:
        return _of_quadric(solids.shape[k], p, d)
    return _of_superquadric(solids.shape[k], p, d)


@compiled
def _of_lathe(solids: Solids, k: int, p: Vector, d: Vector) -> tuple[float, Vector, Vector]:
    """F = rho - r(z) on the side."""
    rho = max(math.sqrt(p[0] * p[0] + p[1] * p[1]), LEAST_RHO)
    r, r1, r2 = profile(solids, k, p[2])
    x, y = p[0] / rho, p[1] / rho
    along = x * d[0] + y * d[1]
    return rho - r, (x, y, -r1), ((d[0] - along * x) / rho, (d[1] - along * y) / rho, -r2 * d[2])


@compiled
def _of_quadric(axes: Array, p: Vector, d: Vector) -> tuple[float, Vector, Vector]:
    """F = (|A^-1 p|^2 - 1) / 2."""
    a, b, c = 1 / (axes[0] * axes[0]), 1 / (axes[1] * axes[1]), 1 / (axes[2] * axes[2])
    g = (a * p[0], b * p[1], c * p[2])
    return 0.5 * (dot(p, g) - 1), g, (a * d[0], b * d[1], c * d[2])


@compiled
def _of_superquadric(shape: Array, p: Vector, d: Vector) -> tuple[float, Vector, Vector]:
    """F = G - 1 of the gauge G (`Superquadric`). With f = (x^k + y^k)^(1/k) and a = x / f, the derivative of its gradient
    a^(k-1) along d is (k - 1) / f (a^(k-2) d - a^(k-1) df); G is that twice: h of x, y, and G of h, z."""
    k, m = shape[3], shape[4]
    sx, sy, sz = _signed(p[0], shape[0]), _signed(p[1], shape[1]), _signed(p[2], shape[2])
    u, v, w = max(p[0] * sx, LEAST_SHARE), max(p[1] * sy, LEAST_SHARE), max(p[2] * sz, LEAST_SHARE)
    du, dv, dw = d[0] * sx, d[1] * sy, d[2] * sz
    uk, vk, wm = u ** (k - 2), v ** (k - 2), w ** (m - 2)
    s = uk * u * u + vk * v * v
    h = s ** (1 / k)
    hu, hv = uk * u * h / s, vk * v * h / s
    dh = hu * du + hv * dv
    dhu = (k - 1) / h * (uk * h * h / s * du - hu * dh)
    dhv = (k - 1) / h * (vk * h * h / s * dv - hv * dh)
    hm = h ** (m - 2)
    total = hm * h * h + wm * w * w
    G = total ** (1 / m)
    to_G, scale = G / total, (m - 1) / G
    Gh, Gw = hm * h * to_G, wm * w * to_G
    dG = Gh * dh + Gw * dw
    dGh = scale * (hm * G * to_G * dh - Gh * dG)
    dGw = scale * (wm * G * to_G * dw - Gw * dG)
    return G - 1, (Gh * hu * sx, Gh * hv * sy, Gw * sz), (
        (dGh * hu + Gh * dhu) * sx, (dGh * hv + Gh * dhv) * sy, dGw * sz
    )  # fmt: skip


@compiled
def _signed(x: float, axis: float) -> float:
    return -1 / axis if x < 0 else 1 / axis
