"""Superquadrics of finite curvature."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree  # pyright: ignore[reportAttributeAccessIssue]

from extremal.estimator.errors import SceneError
from extremal.scenes.curves import Array, Piece, SurfaceCurve, arc_samples, check_length
from extremal.scenes.grids import MEASURED, Facets
from extremal.scenes.radial_mesh import radial_piece
from extremal.scenes.surface import Surface, tangent_basis


@dataclass(frozen=True, eq=False)
class Superquadric(Surface):
    """Superellipsoid ((|x/a|^(2/e2) + |y/b|^(2/e2))^(e2/e1) + |z/c|^(2/e1))^(e1/2) = 1 (Barr 1981).

    That left side, the gauge G, is a norm for these exponents: the body is convex, every line meets it at most
    twice, and G(s p) = s G(p).

    Attributes:
        a, b, c: semi-axes [m] along the object's x, y and z.
        e1, e2: exponents of the meridians and of the parallels, from 0.2 to 1: 1 is an ellipsoid, smaller is
            boxier. Above 1 the curvature is infinite along the coordinate planes, so those are refused. Below 1
            one principal curvature vanishes along them: radii are infinite there.
    """

    a: float
    b: float
    c: float
    e1: float
    e2: float

    def _check(self) -> None:
        for name, value in zip("abc", (self.a, self.b, self.c), strict=True):
            check_length(f"{self.name}: semi-axis {name}", value)
        for name, value in (("e1", self.e1), ("e2", self.e2)):
            if not 0.2 <= value <= 1:
                raise SceneError(f"{self.name}: {name} is {value!r}; accepted: an exponent from 0.2 to 1")

    @property
    def _axes(self) -> Array:
        return np.array([self.a, self.b, self.c], float)

    @property
    def _bounds(self) -> tuple[Array, float]:
        return np.zeros(3), float(np.linalg.norm(self._axes)) * (1 + 1e-9)

    def _gauge(self, p: Array) -> tuple[Array, Array, Array]:
        """G (...), its gradient (..., 3) and Hessian (..., 3, 3) at points (..., 3) other than the origin.

        With u = |x/a| and so on, h = (u^k + v^k)^(1/k), k = 2/e2, and G = (h^m + w^m)^(1/m), m = 2/e1: twice
        the same function, so the chain rule is applied to a p-norm of two variables.
        """
        # At 0 the inner norm has no derivatives; 1e-13 away from it they are those of the surface.
        u, v, w = np.maximum(np.moveaxis(np.abs(p) / self._axes, -1, 0), 1e-13)
        h, hu, hv, huu, huv, hvv = _norm2(u, v, 2 / self.e2)
        G, Gh, Gw, Ghh, Ghw, Gww = _norm2(h, w, 2 / self.e1)
        sign = np.where(p < 0, -1.0, 1.0) / self._axes
        gradient = np.stack([Gh * hu, Gh * hv, Gw], axis=-1) * sign
        entries = [
            [Ghh * hu * hu + Gh * huu, Ghh * hu * hv + Gh * huv, Ghw * hu],
            [Ghh * hu * hv + Gh * huv, Ghh * hv * hv + Gh * hvv, Ghw * hv],
            [Ghw * hu, Ghw * hv, Gww],
        ]
        hessian = np.stack([np.stack(row, axis=-1) for row in entries], axis=-2)
        return G, gradient, hessian * sign[..., :, None] * sign[..., None, :]

    def _frame(self, p: Array) -> tuple[Array, Array]:
        _, gradient, hessian = self._gauge(p)
        length = np.linalg.norm(gradient, axis=-1)[..., None]
        n = gradient / length
        tangent = np.eye(3) - n[..., :, None] * n[..., None, :]
        return n, tangent @ hessian @ tangent / length[..., None]

    def _level(self, p: Array) -> Array:
        G, gradient, _ = self._gauge(p)
        return (G - 1) / np.linalg.norm(gradient, axis=-1)

    def _signed_distance(self, p: Array) -> Array:
        """By symmetry in the first octant: the nearest of 14641 samples, then Newton on the conditions
        x - y + l grad G = 0, G(x) = 1 of the nearest point x to y."""
        y = np.abs(p)
        angle = np.linspace(0, np.pi / 2, 121)
        cos, sin = np.cos(angle)[:, None], np.broadcast_to(np.sin(angle)[:, None], (121, 121))
        d = np.stack([cos * np.cos(angle), cos * np.sin(angle), sin], axis=-1).reshape(-1, 3) * self._axes
        samples = d / self._gauge(d)[0][:, None]
        x = samples[cKDTree(samples).query(y)[1]]
        _, g, _ = self._gauge(x)
        multiplier = np.sum((y - x) * g, axis=1) / np.sum(g * g, axis=1)
        best = np.linalg.norm(x - y, axis=1)
        for _ in range(40):
            G, g, H = self._gauge(x)
            residual = np.concatenate([x - y + multiplier[:, None] * g, (G - 1)[:, None]], axis=1)
            rows = np.zeros((len(x), 4, 4))
            rows[:, :3, :3] = np.eye(3) + multiplier[:, None, None] * H
            rows[:, :3, 3] = rows[:, 3, :3] = g
            step = np.linalg.solve(rows, residual[..., None])[..., 0]
            length = np.linalg.norm(step[:, :3], axis=1, keepdims=True)
            step *= np.minimum(1, 0.1 * self._axes.min() / np.maximum(length, 1e-300))
            x, multiplier = x - step[:, :3], multiplier - step[:, 3]
            if not np.max(np.abs(step[:, :3]), initial=0.0) > 1e-14:
                break
        # Where Newton went to another stationary point the sample remains the better answer.
        found = np.linalg.norm(x - y, axis=1)
        on_surface = np.abs(self._gauge(x)[0] - 1) < 1e-9
        distance = np.where(on_surface & (found < best), found, best)
        return np.where(self._gauge(y)[0] < 1, -distance, distance)

    def _intersect(self, origins: Array, directions: Array) -> Array:
        """G is convex along a ray: find its minimum, then the one root before it and the one behind."""

        def slope(t: Array) -> Array:
            return np.sum(self._gauge(origins + t[:, None] * directions)[1] * directions, axis=1)

        def excess(t: Array) -> Array:
            return self._gauge(origins + t[:, None] * directions)[0] - 1

        square = np.sum(directions**2, axis=1)
        middle = -np.sum(origins * directions, axis=1) / square
        reach = 1.01 * self._bounds[1] / np.sqrt(square)
        lowest = _bisect(slope, middle - reach, middle + reach)
        hit = excess(lowest) <= 0
        enter = _bisect(lambda t: -excess(t), middle - reach, lowest)
        leave = _bisect(excess, lowest, middle + reach)
        t = np.where(enter > 0, enter, leave)
        return np.where(hit & (t > 0), t, np.inf)

    def _contour(self, centre: Array) -> list[Array]:
        """In every half-plane bounded by the line from the body's centre to the camera there is one point.

        A plane section is convex, and from outside it has one tangent on either side.
        """
        if self._gauge(centre)[0] <= 1:
            return []
        axis = centre / np.linalg.norm(centre)
        u, v = tangent_basis(axis)
        count = max(arc_samples(2 * np.pi * float(self._axes.max()), 4e-4), 400)
        phi = np.linspace(0, 2 * np.pi, count)[:, None]
        aside = np.cos(phi) * u + np.sin(phi) * v

        def surface(beta: Array) -> Array:
            d = np.cos(beta)[:, None] * axis + np.sin(beta)[:, None] * aside
            return d / self._gauge(d)[0][:, None]

        # grad G . (p - c) = 1 - grad G . c grows from negative (facing the camera) to positive.
        beta = _bisect(
            lambda b: 1 - self._gauge(surface(b))[1] @ centre, np.zeros(count), np.full(count, np.pi)
        )
        points = surface(beta)
        points[-1] = points[0]
        return [points]

    def _fixed(self) -> list[SurfaceCurve]:
        return []

    def _pieces(self, facets: Facets = MEASURED) -> list[Piece]:
        return [
            radial_piece(
                lambda d: d / self._gauge(d)[0][..., None],
                lambda p: self._frame(p)[0],
                self.appearance.rgba,
                facets,
            )
        ]


def _norm2(x: Array, y: Array, k: float) -> tuple[Array, Array, Array, Array, Array, Array]:
    """(x^k + y^k)^(1/k) for x, y >= 0 and k >= 2 with its derivatives: f, fx, fy, fxx, fxy, fyy."""
    f = np.maximum(x, y)
    scale = np.where(f > 0, f, 1.0)
    f = f * ((x / scale) ** k + (y / scale) ** k) ** (1 / k)
    s = np.where(f > 0, f, 1.0)
    a, b = x / s, y / s
    second = (k - 1) / s
    a2, b2 = a ** (k - 2), b ** (k - 2)
    # By homogeneity fxx x = -fxy y, which gives the forms without cancellation.
    return (
        f,
        a ** (k - 1),
        b ** (k - 1),
        second * a2 * b**k,
        -second * a ** (k - 1) * b ** (k - 1),
        second * b2 * a**k,
    )


def _bisect(f: Callable[[Array], Array], lo: Array, hi: Array) -> Array:
    """Where increasing functions f (N,) -> (N,) change sign between `lo` and `hi` (N,), to rounding."""
    for _ in range(60):
        middle = (lo + hi) / 2
        above = f(middle) > 0
        lo, hi = np.where(above, lo, middle), np.where(above, middle, hi)
    return (lo + hi) / 2
