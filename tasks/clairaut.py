"""Shortest paths around a solid of revolution by Clairaut's relation.

In the object frame a path has cylindrical coordinates (rho, theta, z); it touches the lathe's offset by the
clearance along a geodesic and is straight before and after. The offset's profile has the normals of the
lathe's own: with n = (cos b, sin b) in the meridian plane and sigma the arc length along the offset profile,
d rho / d sigma = -sin b and d z / d sigma = cos b. With phi the angle from the parallel to the geodesic,
Clairaut's relation rho cos(phi) = const (do Carmo, sec. 4-4) gives equations without the singularity that
the usual quadrature has where the geodesic turns back from a waist:

    d phi / d theta = -sin b,    d sigma / d theta = rho tan(phi),    d s / d theta = rho / cos(phi).

The rays from the start that touch the offset are a family of one parameter u, the height of the contact on
the profile. Each is followed by its geodesic to where the goal comes into its tangent plane; the goal's
distance from the geodesic's tangent there is the miss, and the path is where the miss is zero.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BarycentricInterpolator, CubicHermiteSpline
from scipy.optimize import brentq

from extremal.scenes.curves import Array
from extremal.scenes.lathe import Lathe
from extremal.scenes.profile import Profile

STEPS = 24  # of Runge and Kutta's fourth-order rule along a geodesic: 1e-9 to 1e-6 of its length
ROUGH = 8  # of them to find out where zeros are
SCAN, REFINE = 49, 9  # contacts tried over the whole profile, then (Chebyshev points) around each zero
STEEPEST = 1.45  # [rad] geodesics that climb more steeply are not followed


@dataclass(frozen=True, eq=False)
class OffsetProfile:
    """The profile of a lathe moved out by a clearance, with the quarter circles around its two rims.

    The parameter u is the height on the lathe's own profile in [0, height] and continues as arc length along
    the rims' circles beyond. Where the lathe is concave more tightly than the clearance the curve turns back
    (`stretch` is not positive): it is then not the offset body's boundary.
    """

    profile: Profile
    clearance: float

    @cached_property
    def _end_angles(self) -> tuple[float, float]:
        slope = self.profile.derivatives(np.array([0.0, self.profile.height]))[1]
        low, high = np.arctan(-slope)
        return float(low), float(high)

    @cached_property
    def span(self) -> tuple[float, float]:
        """Smallest and largest u [m]: where the circles around the rims meet the caps."""
        low, high = self._end_angles
        return (
            -self.clearance * (low + np.pi / 2),
            self.profile.height + self.clearance * (np.pi / 2 - high),
        )

    def _derivatives(self, u: Array) -> tuple[Array, Array, Array]:
        """r, r' and r'' (...) at heights within the profile: the spline's pieces without its overhead."""
        spline = self.profile.spline
        piece = np.searchsorted(spline.x[1:-1], u, side="right")
        c3, c2, c1, c0 = spline.c[:, piece]
        x = u - spline.x[piece]
        return ((c3 * x + c2) * x + c1) * x + c0, (3 * c3 * x + 2 * c2) * x + c1, 6 * c3 * x + 2 * c2

    def at(self, u: Array) -> tuple[Array, Array, Array, Array, Array, Array]:
        """rho [m], z [m], sin b, cos b, d sigma / d u and d b / d u [1/m] at parameters u (...)."""
        height = np.minimum(np.maximum(u, 0.0), self.profile.height)
        r, r1, r2 = self._derivatives(height)
        square = 1 + r1 * r1
        cos = 1 / np.sqrt(square)
        sin = -r1 * cos
        turning = -r2 / square
        stretch = 1 / cos + self.clearance * turning
        beyond = u - height
        if np.any(beyond):
            angle = beyond / self.clearance
            sin, cos = (
                sin * np.cos(angle) + cos * np.sin(angle),
                cos * np.cos(angle) - sin * np.sin(angle),
            )
            stretch = np.where(beyond == 0, stretch, 1.0)
            turning = np.where(beyond == 0, turning, 1 / self.clearance)
        return r + self.clearance * cos, height + self.clearance * sin, sin, cos, stretch, turning


@dataclass(frozen=True, eq=False)
class _Geodesics:
    """Geodesics (K) of an offset profile that begin where rays from a point touch it.

    Attributes:
        theta: (n + 1, K) azimuths [rad] at equal steps from the contact to the goal's.
        state: (n + 1, 3, K) of u, phi and the length from the contact.
        slope: (n + 1, 3, K) of d state / d theta.
        distance: (K,) [m] from the start to the contact.
    """

    theta: Array
    state: Array
    slope: Array
    distance: Array

    @property
    def step(self) -> Array:
        return self.theta[1] - self.theta[0]

    def cubic(self, cell: NDArray[np.integer]) -> Array:
        """Hermite's cubics (4, 3, K), highest power first, of the state in steps `cell` (K), on [0, 1]."""
        k = np.arange(len(cell))
        (y0, y1), (d0, d1) = (
            (y[cell, :, k].T, y[cell + 1, :, k].T) for y in (self.state, self.slope * self.step)
        )
        return np.stack([2 * (y0 - y1) + d0 + d1, 3 * (y1 - y0) - 2 * d0 - d1, d0, y0])


def _horner(cubic: Array, x: Array) -> Array:
    return ((cubic[0] * x + cubic[1]) * x + cubic[2]) * x + cubic[3]


@dataclass(frozen=True, eq=False)
class LathePaths:
    """Paths around a lathe between two points given by (rho, z) and the azimuth `turn` between them."""

    offset: OffsetProfile
    start: tuple[float, float]
    goal: tuple[float, float]
    turn: float

    def _contacts(self, u: Array) -> tuple[Array, Array, Array]:
        """Azimuth [rad], phi [rad] and distance [m] of the contacts (K) of rays from the start; NaN if none."""
        rho, z, sin, cos, _, _ = self.offset.at(u)
        rho_a, z_a = self.start
        with np.errstate(invalid="ignore"):
            theta = np.arccos((rho + sin / cos * (z - z_a)) / rho_a)
        ray = np.stack([rho - rho_a * np.cos(theta), rho_a * np.sin(theta), z - z_a])
        distance = np.linalg.norm(ray, axis=0)
        phi = np.arctan2(cos * ray[2] - sin * ray[0], ray[1])
        return theta, phi, distance

    def _slopes(self, state: Array) -> Array:
        """d / d theta (3, ...) of a state (3, ...): u, phi and the length."""
        u, phi, _ = state
        rho, _, sin, _, stretch, _ = self.offset.at(u)
        phi = np.minimum(np.maximum(phi, -STEEPEST), STEEPEST)
        return np.stack([rho * np.tan(phi) / stretch, -sin, rho / np.cos(phi)])

    def _geodesics(self, contacts: Array, steps: int) -> _Geodesics:
        theta, phi, distance = self._contacts(contacts)
        h = (self.turn - theta) / steps
        state = np.stack([contacts, phi, np.zeros_like(phi)])
        low, high = self.offset.span
        states, slopes = [state], []
        for _ in range(steps):
            k1 = self._slopes(state)
            k2 = self._slopes(state + h / 2 * k1)
            k3 = self._slopes(state + h / 2 * k2)
            k4 = self._slopes(state + h * k3)
            state = state + h / 6 * (k1 + 2 * (k2 + k3) + k4)
            # Held at the caps; the paths that meet them are recognised by that and left out.
            state[0] = np.minimum(np.maximum(state[0], low), high)
            states.append(state)
            slopes.append(k1)
        slopes.append(self._slopes(state))
        theta = theta + h * np.arange(steps + 1)[:, None]
        return _Geodesics(theta, np.array(states), np.array(slopes), distance)

    def _horizon(self, theta: Array, u: Array) -> Array:
        """Height (...) [m] of the goal above the tangent planes at points (theta, u)."""
        rho, z, sin, cos, _, _ = self.offset.at(u)
        return cos * (self.goal[0] * np.cos(self.turn - theta) - rho) + sin * (self.goal[1] - z)

    def _arrival(self, theta: Array, u: Array, phi: Array) -> tuple[Array, Array]:
        """Distance [m] to the goal along the geodesics' tangents at (theta, u), and how far they miss it."""
        rho, z, sin, cos, _, _ = self.offset.at(u)
        out, around = self.goal[0] * np.cos(self.turn - theta) - rho, self.goal[0] * np.sin(self.turn - theta)
        along = cos * (self.goal[1] - z) - sin * out
        return (
            np.cos(phi) * around + np.sin(phi) * along,
            np.cos(phi) * along - np.sin(phi) * around,
        )

    def _misses(self, contacts: Array, steps: int) -> Array:
        """How far (K) [m] the path from each contact passes the goal; NaN where it never sees it."""
        g = self._geodesics(contacts, steps)
        with np.errstate(invalid="ignore"):
            horizon = self._horizon(g.theta, g.state[:, 0])
            rises = (horizon[:-1] <= 0) & (horizon[1:] > 0)
        k, cell = np.arange(len(contacts)), np.argmax(rises, axis=0)
        cubic = g.cubic(cell)

        def height(x: Array) -> Array:
            return self._horizon(g.theta[cell, k] + x * g.step, _horner(cubic[:, 0], x))

        lo, hi = np.zeros(len(k)), np.ones(len(k))
        for _ in range(12):
            x = (lo + hi) / 2
            hidden = height(x) <= 0
            lo, hi = np.where(hidden, x, lo), np.where(hidden, hi, x)
        below, above = height(lo), height(hi)
        x = lo + (hi - lo) * below / np.where(above > below, below - above, -1.0)
        u, phi, _ = _horner(cubic, x)
        ahead, miss = self._arrival(g.theta[cell, k] + x * g.step, u, phi)
        return np.where(rises[cell, k] & (ahead >= 0), miss, np.nan)

    def contacts(self) -> list[float]:
        """Parameters u of the contacts from which a path meets the goal."""
        scan = np.linspace(*self.offset.span, SCAN + 2)[1:-1]
        miss = self._misses(scan, ROUGH)
        found = []
        for i in np.nonzero(miss[:-1] * miss[1:] <= 0)[0]:
            middle, half = (scan[i] + scan[i + 1]) / 2, (scan[i + 1] - scan[i]) / 2
            u = middle - half * np.cos(np.pi * np.arange(REFINE) / (REFINE - 1))
            finer = self._misses(u, STEPS)
            for (a, fa), (b, fb) in pairwise(zip(u, finer, strict=True)):
                if fa * fb <= 0:
                    found.append(_zero(u, finer, float(a), float(b)))
        return found

    def path(self, contact: float) -> tuple[Array, float] | None:
        """Points (n, 3) [m] and length [m] of the path that touches first at u = contact.

        The azimuth counts from the start's, towards the goal's. None where the geodesic meets a cap, climbs
        too steeply, or where a taut string would leave the surface (its normal curvature along the geodesic
        is negative).
        """
        g = self._geodesics(np.array([contact]), STEPS)
        theta, u = g.theta[:, 0], g.state[:, 0, 0]
        curve = CubicHermiteSpline(theta, g.state[..., 0], g.slope[..., 0])
        horizon = self._horizon(theta, u)
        rises = np.nonzero((horizon[:-1] <= 0) & (horizon[1:] > 0))[0]
        if not len(rises):
            return None
        cell = slice(rises[0], rises[0] + 2)
        end = float(
            brentq(lambda x: float(self._horizon(x, curve(x)[0])), *theta[cell], xtol=1e-14)  # pyright: ignore[reportArgumentType]
        )
        samples = np.linspace(theta[0], end, max(2, int(np.ceil((end - theta[0]) / np.radians(0.5))) + 1))
        u, phi, run = curve(samples).T
        if not self._taut(u, phi):
            return None
        rho, z, *_ = self.offset.at(u)
        ahead, _ = self._arrival(np.array(end), u[-1], phi[-1])
        on_surface = np.stack([rho * np.cos(samples), rho * np.sin(samples), z], axis=1)
        ends = [
            [[rho * np.cos(angle), rho * np.sin(angle), z]]
            for (rho, z), angle in ((self.start, 0.0), (self.goal, self.turn))
        ]
        length = float(g.distance[0] + run[-1] + ahead)
        return np.concatenate([ends[0], on_surface, ends[1]]), length

    def _taut(self, u: Array, phi: Array) -> bool:
        """Whether a string would lie on the surface, within the span, at all (u, phi) of a geodesic."""
        rho, _, _, cos, stretch, turning = self.offset.at(u)
        normal_curvature = turning / stretch * np.sin(phi) ** 2 + cos / rho * np.cos(phi) ** 2
        low, high = self.offset.span
        inside = (u > low) & (u < high) & (np.abs(phi) < STEEPEST)
        return bool(np.all(inside & (stretch > 0) & (normal_curvature >= 0)))


def _zero(u: Array, miss: Array, a: float, b: float) -> float:
    """Zero of the polynomial through the finite points (u, miss) between two of them, a and b."""
    finite = np.isfinite(miss)
    f = BarycentricInterpolator(u[finite], miss[finite])
    return float(brentq(lambda x: float(f(x)), a, b, xtol=1e-15))  # pyright: ignore[reportArgumentType]


def lathe_paths(lathe: Lathe, start: Array, goal: Array, clearance: float) -> list[tuple[Array, float]]:
    """Locally shortest paths around the side of a lathe: points (n, 3) [m], world frame, and lengths [m].

    Only the shorter way around: on a body of revolution the part of the other way that lies beyond the
    opposite meridian plane, reflected in that plane, is a longer path of the same kind.

    Args:
        lathe: the obstacle.
        start, goal: (3,) world, outside the lathe's offset and not visible from one another past it.
        clearance: [m], positive.
    """
    a, b = (lathe.T_world_object.inv().apply(p) for p in (start, goal))
    azimuth = float(np.arctan2(a[1], a[0]))
    turn = float(np.remainder(np.arctan2(b[1], b[0]) - azimuth + np.pi, 2 * np.pi) - np.pi)
    ends = [(float(np.hypot(p[0], p[1])), float(p[2])) for p in (a, b)]
    paths = LathePaths(OffsetProfile(lathe.profile, clearance), ends[0], ends[1], abs(turn))
    side = -1.0 if turn < 0 else 1.0
    cos, sin = np.cos(azimuth), np.sin(azimuth)
    found = []
    for contact in paths.contacts():
        answer = paths.path(contact)
        if answer is not None:
            points = answer[0] * [1, side, 1]
            turned = points @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]])
            found.append((lathe.T_world_object.apply(turned), answer[1]))
    return found
