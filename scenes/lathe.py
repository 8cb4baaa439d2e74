"""Solids of revolution."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.optimize import brentq

from extremal.estimator.errors import SceneError
from extremal.scenes.curves import Array, Kind, Piece, SurfaceCurve, arc_samples
from extremal.scenes.grids import MEASURED, Facets
from extremal.scenes.lathe_mesh import lathe_pieces
from extremal.scenes.markings import LathePatch, check_markings
from extremal.scenes.profile import Profile
from extremal.scenes.surface import Surface


@dataclass(frozen=True, eq=False)
class Lathe(Surface):
    """Solid of revolution about the object's z axis: a smooth side r(z) and two flat caps.

    With r', r'' the derivatives of the profile and g = sqrt(1 + r'^2), the curvature is -r'' / g^3 along
    meridians and 1 / (r g) around (do Carmo, sec. 3-3, example 4).

    Attributes:
        profile_z: heights [m] in the object frame, increasing from 0 (the base).
        profile_r: radii [m] there; a C2 cubic spline passes through them.
        markings: patches of other colours on the side, without overlaps.

    Raises:
        SceneError: for a profile or markings that are not acceptable.
    """

    profile_z: Sequence[float] | Array
    profile_r: Sequence[float] | Array
    markings: tuple[LathePatch, ...] = ()

    def _check(self) -> None:
        try:
            height = self.profile.height
        except SceneError as error:
            raise SceneError(f"{self.name}: {error}") from None
        except (TypeError, ValueError):
            raise SceneError(f"{self.name}: profile_z and profile_r must be lists of numbers [m]") from None
        check_markings(self.name, self.markings)
        for patch in self.markings:
            if patch.top > height:
                raise SceneError(
                    f"{self.name}: marking {patch.name!r} ends at {patch.top} m, above the top at {height} m"
                )

    @cached_property
    def profile(self) -> Profile:
        """The spline r(z)."""
        return Profile(np.array(self.profile_z, float), np.array(self.profile_r, float))

    @property
    def _bounds(self) -> tuple[Array, float]:
        half = self.profile.height / 2
        return np.array([0, 0, half]), float(np.hypot(half, self.profile.largest)) * (1 + 1e-9)

    def _frame(self, p: Array) -> tuple[Array, Array]:
        rho, z = np.hypot(p[..., 0], p[..., 1]), p[..., 2]
        r, r1, r2 = self.profile.derivatives(z)
        g = np.sqrt(1 + r1 * r1)
        axis = np.where(rho[..., None] > 0, p[..., :2] / np.where(rho > 0, rho, 1)[..., None], (1.0, 0.0))
        cos, sin, zero = axis[..., 0], axis[..., 1], np.zeros_like(g)
        n = np.stack([cos, sin, -r1], axis=-1) / g[..., None]
        meridian = np.stack([r1 * cos, r1 * sin, zero + 1], axis=-1) / g[..., None]
        around = np.stack([-sin, cos, zero], axis=-1)
        S = (-r2 / g**3)[..., None, None] * meridian[..., :, None] * meridian[..., None, :]
        S = S + (1 / (r * g))[..., None, None] * around[..., :, None] * around[..., None, :]
        to_cap = np.minimum(np.abs(z), np.abs(z - self.profile.height))
        on_cap = to_cap + 1e-9 < (r - rho) / g
        up = np.where(z > self.profile.height / 2, 1.0, -1.0)
        n = np.where(on_cap[..., None], np.stack([zero, zero, up], axis=-1), n)
        return n, np.where(on_cap[..., None, None], 0.0, S)

    def _level(self, p: Array) -> Array:
        r, r1, _ = self.profile.derivatives(p[..., 2])
        return (np.hypot(p[..., 0], p[..., 1]) - r) / np.sqrt(1 + r1 * r1)

    def _signed_distance(self, p: Array) -> Array:
        rho, z = np.hypot(p[:, 0], p[:, 1]), p[:, 2]
        profile, top = self.profile, self.profile.height
        nearest = profile.nearest(rho, z)
        distance = np.hypot(rho - profile.spline(nearest), z - nearest)
        for level in (0.0, top):
            beyond = np.maximum(rho - profile.spline(level), 0)
            distance = np.minimum(distance, np.hypot(beyond, z - level))
        inside = (z > 0) & (z < top) & (rho < profile.spline(np.clip(z, 0, top)))
        return np.where(inside, -distance, distance)

    def _intersect(self, origins: Array, directions: Array) -> Array:
        t = self.profile.intersect(origins, directions)
        for level in (0.0, self.profile.height):
            with np.errstate(divide="ignore", invalid="ignore"):
                cap = (level - origins[:, 2]) / directions[:, 2]
                hit = origins[:, :2] + cap[:, None] * directions[:, :2]
                on_cap = (cap > 0) & (np.sum(hit * hit, axis=1) <= self.profile.spline(level) ** 2)
            t = np.where(on_cap, np.minimum(t, cap), t)
        return t

    def _contour(self, centre: Array) -> list[Array]:
        """cos(theta - theta_c) = (r - r' (z - z_c)) / rho_c =: q, where |q| <= 1."""
        rho = max(float(np.hypot(centre[0], centre[1])), 1e-9)
        theta_c = float(np.arctan2(centre[1], centre[0]))

        def q(z: Array, r: Array, r1: Array) -> Array:
            return (r - r1 * (z - centre[2])) / rho

        curves = []
        for lo, hi, opens_low, opens_high in self._intervals(q):
            z = self._heights(lo, hi, opens_low, opens_high)
            r, r1 = self.profile.slopes(z)
            angle = np.arccos(np.clip(q(z, r, r1), -1, 1))
            right, left = (_ring(r, theta_c + side * angle, z) for side in (-1, 1))
            curves += _joined(right, left, opens_low, opens_high)
        return curves

    def _heights(self, lo: float, hi: float, low_end: bool, high_end: bool) -> Array:
        """Samples of lo <= z <= hi, whose ends are not ends of the profile (`*_end` false) where |q| = 1."""
        count = arc_samples((hi - lo) + 4 * self.profile.largest, 4e-4)
        # Near |q| = 1 the azimuth goes with the square root of z: cosine spacing there makes the points regular.
        u = np.linspace(0, 1, count)
        if low_end and high_end:
            s = u
        elif low_end:
            s = np.sin(np.pi / 2 * u)
        elif high_end:
            s = 1 - np.cos(np.pi / 2 * u)
        else:
            s = (1 - np.cos(np.pi * u)) / 2
        return lo + (hi - lo) * s

    @cached_property
    def _scanned(self) -> tuple[Array, Array, Array]:
        """Even heights from end to end, r and r' there."""
        z = np.linspace(0, self.profile.height, 2001)
        return z, *self.profile.slopes(z)

    def _intervals(self, q: Callable[[Array, Array, Array], Array]) -> list[tuple[float, float, bool, bool]]:
        """Intervals (lo, hi) of the profile where |q(z, r, r')| <= 1, and whether each end is an end of the profile."""
        z, r, r1 = self._scanned
        values, height, cuts = q(z, r, r1), self.profile.height, [0.0]

        def at(x: float) -> float:
            return float(q(np.array(x), *self.profile.slopes(np.array(x))))

        for bound in (-1.0, 1.0):
            f = values - bound
            cuts += [
                float(brentq(lambda x, b=bound: at(x) - b, z[i], z[i + 1], xtol=1e-15))  # pyright: ignore[reportArgumentType]
                for i in np.nonzero(f[:-1] * f[1:] < 0)[0]
            ]
        cuts = [*sorted(cuts), height]
        return [
            (lo, hi, lo == 0.0, hi == height)
            for lo, hi in pairwise(cuts)
            if hi > lo and abs(at((lo + hi) / 2)) <= 1
        ]

    def _side(self, z: Array, theta: Array) -> Array:
        return _ring(self.profile.spline(z), theta, z)

    def _fixed(self) -> list[SurfaceCurve]:
        top = self.profile.height
        curves = []
        for label, level, up in (("base", 0.0, -1.0), ("rim", top, 1.0)):
            cap = (0.0, 0.0, up)
            curves.append(self._curve("crease", label, level, level, 0, 2 * np.pi, cap))
        for m in self.markings:
            a, b = m.start, m.start + m.width
            for label, level in (("bottom", m.bottom), ("top", m.top)):
                if 0 < level < top:
                    curves.append(self._curve("marking", f"{m.name}.{label}", level, level, a, b))
            if not m.is_band:
                for label, angle in (("start", a), ("end", b)):
                    curves.append(self._curve("marking", f"{m.name}.{label}", m.bottom, m.top, angle, angle))
        return curves

    def _curve(
        self,
        kind: Kind,
        label: str,
        z0: float,
        z1: float,
        a0: float,
        a1: float,
        cap: tuple[float, float, float] | None = None,
    ) -> SurfaceCurve:
        length = 2 * (z1 - z0) + (a1 - a0) * float(self.profile.spline(z0))
        count = arc_samples(length, 2e-4)
        points = self._side(np.linspace(z0, z1, count), np.linspace(a0, a1, count))
        other = None if cap is None else np.tile(cap, (count, 1))
        normals, _ = self._frame(points)
        return SurfaceCurve(
            f"{self.name}/{label}", self.name, kind, points, normals, np.ones(count, bool), other
        )

    def _pieces(self, facets: Facets = MEASURED) -> list[Piece]:
        return lathe_pieces(self.profile, self.appearance.rgba, self.markings, facets)


def _ring(r: Array, theta: Array, z: Array) -> Array:
    """Points (..., 3) at radii, azimuths and heights (...)."""
    return np.stack([r * np.cos(theta), r * np.sin(theta), z], axis=-1)


def _joined(right: Array, left: Array, low_end: bool, high_end: bool) -> list[Array]:
    """Two branches (n, 3), upwards, joined at the ends (`*_end` false) where they meet."""
    if low_end and high_end:
        return [right, left]
    if high_end:
        return [np.concatenate([right[::-1], left[1:]])]
    return [np.concatenate([right, left[-2::-1]])]
