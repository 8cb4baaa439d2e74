"""Spheres and ellipsoids."""

from abc import abstractmethod
from dataclasses import dataclass

import numpy as np

from extremal.scenes.curves import Array, Piece, SurfaceCurve, arc_samples, check_length
from extremal.scenes.grids import MEASURED, Facets
from extremal.scenes.radial_mesh import radial_piece
from extremal.scenes.surface import Surface, tangent_basis


@dataclass(frozen=True, kw_only=True, eq=False)
class _Quadric(Surface):
    """x' A^-2 x = 1 with A = diag(semi-axes): the image of the unit sphere under A."""

    @property
    @abstractmethod
    def _axes(self) -> Array:
        """Semi-axes (3,) [m]."""

    def _check(self) -> None:
        for name, value in zip("abc", self._axes, strict=True):
            check_length(f"{self.name}: semi-axis {name}", value)

    @property
    def _bounds(self) -> tuple[Array, float]:
        return np.zeros(3), float(self._axes.max()) * (1 + 1e-9)

    def _frame(self, p: Array) -> tuple[Array, Array]:
        gradient = p / self._axes**2
        length = np.linalg.norm(gradient, axis=-1)[..., None]
        n = gradient / length
        tangent = np.eye(3) - n[..., :, None] * n[..., None, :]
        return n, tangent @ ((1 / self._axes**2)[:, None] * tangent) / length[..., None]

    def _level(self, p: Array) -> Array:
        q = np.linalg.norm(p / self._axes, axis=-1)
        return (q - 1) * q / np.linalg.norm(p / self._axes**2, axis=-1)

    def _signed_distance(self, p: Array) -> Array:
        """Nearest point x = a^2 p / (a^2 + t) with |x / a| = 1 (Eberly, "Distance to an ellipsoid").

        With g(t) = sum (a p / (a^2 + t))^2 - 1 decreasing and convex for t > -min(a)^2, bisection on the
        bracket of that root never leaves it; coordinates of zero on the shortest axis need the limit t = -a^2.
        """
        a, y = self._axes, np.abs(p)
        shortest = np.argmin(a)
        lo = -(a[shortest] ** 2) + a[shortest] * y[:, shortest]
        hi = -(a[shortest] ** 2) + np.linalg.norm(a * y, axis=1)
        for _ in range(200):
            t = (lo + hi) / 2
            with np.errstate(divide="ignore", invalid="ignore"):
                g = np.nansum((a * y / (a * a + t[:, None])) ** 2, axis=1) - 1
            lo, hi = np.where(g > 0, t, lo), np.where(g > 0, hi, t)
        t = (lo + hi) / 2
        weight = a * a + t[:, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            x = np.where(weight > 1e-14 * a * a, a * a * y / weight, 0.0)
        # On the medial axis the remaining coordinates follow from |x / a| = 1.
        shorts = np.isclose(a, a[shortest], rtol=1e-12)
        rest = 1 - np.sum(np.where(shorts, 0, x / a) ** 2, axis=1)
        own = np.linalg.norm(np.where(shorts, x, 0), axis=1)
        needed = a[shortest] * np.sqrt(np.maximum(rest, 0))
        scale = np.where(own > 0, needed / np.where(own > 0, own, 1), 1.0)
        x = np.where(shorts, x * scale[:, None], x)
        x[:, shortest] = np.where(own > 0, x[:, shortest], needed)
        distance = np.linalg.norm(x - y, axis=1)
        return np.where(np.sum((p / a) ** 2, axis=1) < 1, -distance, distance)

    def _intersect(self, origins: Array, directions: Array) -> Array:
        o, d = origins / self._axes, directions / self._axes
        square = np.sum(d * d, axis=1)
        nearest = -np.sum(o * d, axis=1) / square
        foot = o + nearest[:, None] * d
        with np.errstate(invalid="ignore"):
            half = np.sqrt((1 - np.sum(foot * foot, axis=1)) / square)
        t = np.where(nearest - half > 0, nearest - half, nearest + half)
        return np.where(t > 0, t, np.inf)  # NaN (no hit) compares false

    def _contour(self, centre: Array) -> list[Array]:
        """On the unit sphere: the circle q.c = 1, where c is the camera's centre under A^-1."""
        c = centre / self._axes
        square = float(c @ c)
        if square <= 1:
            return []
        u, v = tangent_basis(c / np.sqrt(square))
        count = arc_samples(2 * np.pi * float(self._axes.max()), 4e-4)
        phi = np.linspace(0, 2 * np.pi, max(count, 400))[:, None]
        circle = c / square + np.sqrt(1 - 1 / square) * (np.cos(phi) * u + np.sin(phi) * v)
        return [circle * self._axes]

    def _fixed(self) -> list[SurfaceCurve]:
        return []

    def _pieces(self, facets: Facets = MEASURED) -> list[Piece]:
        return [
            radial_piece(
                lambda d: d * self._axes / np.linalg.norm(d, axis=-1, keepdims=True),
                lambda p: self._frame(p)[0],
                self.appearance.rgba,
                facets,
            )
        ]


@dataclass(frozen=True, eq=False)
class Sphere(_Quadric):
    """Sphere about the object frame's origin.

    Attributes:
        radius: [m].
    """

    radius: float

    @property
    def _axes(self) -> Array:
        return np.full(3, self.radius, float)

    def _signed_distance(self, p: Array) -> Array:
        return np.linalg.norm(p, axis=1) - self.radius


@dataclass(frozen=True, eq=False)
class Ellipsoid(_Quadric):
    """Ellipsoid about the object frame's origin.

    Attributes:
        a, b, c: semi-axes [m] along the object's x, y and z.
    """

    a: float
    b: float
    c: float

    @property
    def _axes(self) -> Array:
        return np.array([self.a, self.b, self.c], float)
