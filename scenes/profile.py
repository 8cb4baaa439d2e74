"""The profile r(z) of a lathe: a C2 cubic spline, the points nearest to it, and where rays pass through it."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline

from extremal.estimator.errors import SceneError
from extremal.scenes.curves import Array
from extremal.scenes.polynomials import first_roots


@dataclass(frozen=True, eq=False)
class Profile:
    """Radius r(z) > 0 [m] on [0, height], C2 through the given points (not-a-knot).

    Attributes:
        z: (K,) increasing heights [m] from 0, 2 <= K <= 200.
        r: (K,) radii [m].
    """

    z: Array
    r: Array

    def __post_init__(self) -> None:
        z, r = self.z, self.r
        if z.ndim != 1 or z.shape != r.shape or not 2 <= len(z) <= 200:
            raise SceneError(f"profile has {z.shape} heights and {r.shape} radii; accepted: 2 to 200 of both")
        if not (np.all(np.isfinite(z)) and z[0] == 0 and np.all(np.diff(z) >= 1e-5) and z[-1] <= 100):
            raise SceneError(f"profile z is {z.tolist()}; accepted: metres increasing from 0 to at most 100")
        if not (np.all(np.isfinite(r)) and np.all((r >= 1e-4) & (r <= 100))):
            raise SceneError(f"profile r is {r.tolist()}; accepted: radii from 0.0001 to 100 m")
        if not self.smallest >= 1e-5:
            raise SceneError(
                f"the spline through profile r {r.tolist()} reaches {self.smallest:.3g} m; it must stay positive"
            )

    @cached_property
    def spline(self) -> CubicSpline:
        return CubicSpline(self.z, self.r)

    @property
    def height(self) -> float:
        return float(self.z[-1])

    @cached_property
    def _extremes(self) -> Array:
        stationary = self.spline.derivative().roots(extrapolate=False)
        return self.spline(np.concatenate([self.z, stationary[np.isfinite(stationary)]]))

    @property
    def smallest(self) -> float:
        return float(self._extremes.min())

    @property
    def largest(self) -> float:
        return float(self._extremes.max())

    def derivatives(self, z: Array) -> tuple[Array, Array, Array]:
        """r, r' and r'' (...) at heights (...), held at the ends' heights outside."""
        z = np.clip(z, 0, self.height)
        return self.spline(z), self.spline(z, 1), self.spline(z, 2)

    def slopes(self, z: Array) -> tuple[Array, Array]:
        """r and r' (...) at heights (...), held at the ends' heights outside."""
        z = np.clip(z, 0, self.height)
        return self.spline(z), self.spline(z, 1)

    def nearest(self, rho: Array, z: Array) -> Array:
        """Heights (N,) of the profile's points nearest to points (rho, z) of the meridian plane.

        The best of 400 samples, then Newton kept between its neighbours.
        """
        samples = np.linspace(0, self.height, 400)
        r = self.spline(samples)
        best = np.concatenate(
            [
                np.argmin((r - rho[i : i + 4096, None]) ** 2 + (samples - z[i : i + 4096, None]) ** 2, axis=1)
                for i in range(0, len(z), 4096)
            ]
            or [np.zeros(0, int)]
        )
        lo, hi = samples[np.maximum(best - 1, 0)], samples[np.minimum(best + 1, 399)]
        x = samples[best]
        for _ in range(60):
            r, r1, r2 = self.derivatives(x)
            slope = (r - rho) * r1 + x - z
            lo, hi = np.where(slope < 0, x, lo), np.where(slope > 0, x, hi)
            curvature = r1 * r1 + (r - rho) * r2 + 1
            newton = x - slope / np.where(curvature > 0, curvature, np.inf)
            new = np.where((newton >= lo) & (newton <= hi) & (curvature > 0), newton, (lo + hi) / 2)
            if not np.max(np.abs(new - x), initial=0.0) > 1e-15:
                break
            x = new
        return x

    def intersect(self, o: Array, d: Array) -> Array:
        """First t > 0 (N,) at which rays o + t d (N, 3) meet the surface of revolution; inf where none.

        On each piece of the spline rho(t)^2 - r(z(t))^2 is a polynomial of degree 6 in t.
        """
        knots = self.spline.x
        t0, t1 = self._clip(o, d, knots)
        row, piece = np.nonzero(t0 < t1)
        if not len(row):
            return np.full(len(o), np.inf)
        start, length = t0[row, piece], (t1 - t0)[row, piece]
        q, step = o[row] + start[:, None] * d[row], d[row] * length[:, None]
        # r as a polynomial in s, where z = q_z + s step_z and t = start + s length
        c = self.spline.c[::-1, piece]
        a, b = q[:, 2] - knots[piece], step[:, 2]
        zero = np.zeros_like(a)
        r = np.stack([zero] * 4, axis=1)
        power = np.stack([zero + 1, zero, zero, zero], axis=1)
        for coefficient in c:
            r += coefficient[:, None] * power
            power = a[:, None] * power + b[:, None] * np.concatenate([zero[:, None], power[:, :-1]], axis=1)
        f = np.zeros((len(row), 7))
        for i in range(4):
            for j in range(4):
                f[:, i + j] -= r[:, i] * r[:, j]
        f[:, 0] += np.sum(q[:, :2] ** 2, axis=1)
        f[:, 1] += 2 * np.sum(q[:, :2] * step[:, :2], axis=1)
        f[:, 2] += np.sum(step[:, :2] ** 2, axis=1)
        t = np.full(len(o), np.inf)
        np.minimum.at(t, row, start + first_roots(f) * length)
        return t

    def _clip(self, o: Array, d: Array, knots: Array) -> tuple[Array, Array]:
        """Parts t0 < t1 (N, pieces) of rays ahead of their origin, within the bounding cylinder and each piece."""
        with np.errstate(divide="ignore", invalid="ignore"):
            a = np.sum(d[:, :2] ** 2, axis=1)
            b = np.sum(o[:, :2] * d[:, :2], axis=1)
            c = np.sum(o[:, :2] ** 2, axis=1) - (self.largest * (1 + 1e-9)) ** 2
            root = np.sqrt(b * b - a * c)
            enter, leave = (-b - root) / a, (-b + root) / a
            upright = a < 1e-24
            enter = np.where(upright, np.where(c <= 0, 0, np.inf), enter)
            leave = np.where(upright, np.where(c <= 0, np.inf, -np.inf), leave)
            level = (knots - o[:, 2:]) / d[:, 2:]
            flat = d[:, 2:] == 0
            inside = (knots[:-1] <= o[:, 2:]) & (o[:, 2:] < knots[1:])
            z_in = np.where(flat, np.where(inside, -np.inf, np.inf), np.minimum(level[:, :-1], level[:, 1:]))
            z_out = np.where(flat, np.where(inside, np.inf, -np.inf), np.maximum(level[:, :-1], level[:, 1:]))
        t0 = np.fmax(np.fmax(z_in, np.where(np.isnan(enter), np.inf, enter)[:, None]), 0.0)
        t1 = np.fmin(z_out, np.where(np.isnan(leave), -np.inf, leave)[:, None])
        return t0, t1
