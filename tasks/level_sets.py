"""Smooth surfaces as level sets F(p) = 0 of their object frame, F < 0 inside, in few operations on few points.

What contacts need of `Surface._level` and `Surface._frame` is less than these tell: F, its gradient g and the product H d of
its Hessian with one direction, of any scale.
"""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from extremal.estimator.camera import Array
from extremal.scenes import Ellipsoid, Lathe, Sphere, Superquadric, Surface


class LevelSet(Protocol):
    """A smooth surface, in its object frame."""

    def inside(self, p: Array) -> NDArray[np.bool_]:
        """Whether points (..., 3) lie within the object."""
        ...

    def differential(self, p: Array, d: Array) -> tuple[Array, Array, Array]:
        """F (n,), g (n, 3) and H d (n, 3) at points p (n, 3), for directions d (n, 3)."""
        ...


def level_set(surface: Surface) -> LevelSet:
    """That of a surface."""
    if isinstance(surface, Lathe):
        return LatheLevel(surface)
    if isinstance(surface, Sphere | Ellipsoid):
        return _QuadricLevel(surface)
    return _SuperquadricLevel(surface) if isinstance(surface, Superquadric) else _AnyLevel(surface)


class LatheLevel:
    """F = rho - r(z) on the side; r is held at the ends' heights."""

    def __init__(self, lathe: Lathe) -> None:
        spline = lathe.profile.spline
        self._height, self._start, self._c = lathe.profile.height, spline.x, spline.c
        self._inner = spline.x[1:-1]

    def profile(self, z: Array) -> tuple[Array, Array, Array]:
        """r, r' and r'' (...) at heights z (...)."""
        z = np.minimum(np.maximum(z, 0.0), self._height)
        i = self._inner.searchsorted(z)
        x = z - self._start[i]
        a, b, c, d = self._c[:, i]
        ax = a * x
        return ((ax + b) * x + c) * x + d, (3 * ax + 2 * b) * x + c, 6 * ax + 2 * b

    def inside(self, p: Array) -> NDArray[np.bool_]:
        z, side = p[..., 2], p[..., :2]
        r = self.profile(z)[0]
        return (np.vecdot(side, side) < r * r) & (z > 0) & (z < self._height)

    def differential(self, p: Array, d: Array) -> tuple[Array, Array, Array]:
        side, along = p[:, :2], d[:, :2]
        rho = np.maximum(np.sqrt(np.vecdot(side, side)), 1e-12)
        r, r1, r2 = self.profile(p[:, 2])
        g, turned = np.empty(p.shape), np.empty(p.shape)
        out = side / rho[:, None]
        g[:, :2], g[:, 2] = out, -r1
        turned[:, :2] = (along - np.vecdot(out, along)[:, None] * out) / rho[:, None]
        turned[:, 2] = -r2 * d[:, 2]
        return rho - r, g, turned


class _QuadricLevel:
    """F = (|A^-1 p|^2 - 1) / 2."""

    def __init__(self, surface: Sphere | Ellipsoid) -> None:
        self._weight = surface._axes**-2.0

    def inside(self, p: Array) -> NDArray[np.bool_]:
        return np.vecdot(p, p * self._weight) < 1

    def differential(self, p: Array, d: Array) -> tuple[Array, Array, Array]:
        g = p * self._weight
        return 0.5 * (np.vecdot(p, g) - 1), g, d * self._weight


class _SuperquadricLevel:
    """F = G - 1 of the gauge G (`Superquadric`). With f = (x^k + y^k)^(1/k) and a = x / f, the derivative of its gradient
    a^(k-1) along d is (k - 1) / f (a^(k-2) d - a^(k-1) df); G is that twice."""

    def __init__(self, surface: Superquadric) -> None:
        self._axes, self._k, self._m = surface._axes, 2 / surface.e2, 2 / surface.e1
        self._less = np.array([self._k, self._k, self._m]) - 2

    def inside(self, p: Array) -> NDArray[np.bool_]:
        u = np.abs(p) / self._axes
        s = np.sum(u[..., :2] ** self._k, axis=-1)
        return s ** (self._m / self._k) + u[..., 2] ** self._m < 1

    def differential(self, p: Array, d: Array) -> tuple[Array, Array, Array]:
        k, m = self._k, self._m
        sign = np.where(p < 0, -1.0, 1.0) / self._axes
        u, d = np.maximum(p * sign, 1e-13), d * sign
        power = u**self._less
        first = power * u  # u^(k-1), v^(k-1), w^(m-1)
        s = np.vecdot(first[:, :2], u[:, :2])
        h = s ** (1 / k)
        to_h, to_h2 = (h / s)[:, None], (h * h / s)[:, None]
        hu = first[:, :2] * to_h  # gradient of h
        dh = np.vecdot(hu, d[:, :2])
        dhu = ((k - 1) / h)[:, None] * (power[:, :2] * to_h2 * d[:, :2] - hu * dh[:, None])
        outer = h ** (m - 2)
        total = outer * h * h + first[:, 2] * u[:, 2]
        G = total ** (1 / m)
        to_G, scale = G / total, (m - 1) / G
        Gh, Gw = outer * h * to_G, first[:, 2] * to_G
        dG = Gh * dh + Gw * d[:, 2]
        dGh = scale * (outer * G * to_G * dh - Gh * dG)
        g, turned = np.empty(p.shape), np.empty(p.shape)
        g[:, :2], g[:, 2] = Gh[:, None] * hu, Gw
        turned[:, :2] = dGh[:, None] * hu + Gh[:, None] * dhu
        turned[:, 2] = scale * (power[:, 2] * G * to_G * d[:, 2] - Gw * dG)
        return G - 1, g * sign, turned * sign


class _AnyLevel:
    """By the surface's own answers."""

    def __init__(self, surface: Surface) -> None:
        self._surface = surface

    def inside(self, p: Array) -> NDArray[np.bool_]:
        return self._surface._level(p) < 0

    def differential(self, p: Array, d: Array) -> tuple[Array, Array, Array]:
        n, S = self._surface._frame(p)
        return self._surface._level(p), n, (S @ d[..., None])[..., 0]
