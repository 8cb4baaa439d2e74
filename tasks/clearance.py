"""How near a sphere comes to the objects of a scene."""

import numpy as np

from extremal.estimator.camera import Array
from extremal.scenes import Ellipsoid, Lathe, Scene, Sphere, Superquadric, Surface
from extremal.tasks.level_sets import LatheLevel, level_set

CHECKED = 0.004  # [m] between points of a step at which distance is measured
ITERATIONS, CONVERGED = 20, 1e-9  # [m]
SAMPLES = 400  # of a meridian


def between(start: Array, end: Array) -> Array:
    """Points (n, 3) of a step, CHECKED apart, its end the last."""
    way = end - start
    count = 1 + int(np.sqrt(way @ way) / CHECKED)
    return start + (np.arange(1, count + 1) / count)[:, None] * way


class Clearance:
    """The smallest distance of a moving sphere from any object.

    A distance changes by no more than the sphere moves, and a convex object stays behind the tangent plane at its nearest
    point: objects are measured only where these bounds leave room for less than the smallest distance so far.

    Attributes:
        smallest: [m] from the sphere's surface, so far.
    """

    def __init__(self, scene: Scene, radius: float, smallest: float = np.inf) -> None:
        """`smallest`: distances [m] above it are of no interest."""
        self._objects = [
            _Convex(s)
            if isinstance(s, Ellipsoid | Superquadric | Sphere)
            else _Turned(s)
            if isinstance(s, Lathe)
            else _Measured(s)
            for s in scene.objects
        ]
        self._radius, self.smallest = radius, smallest

    def take_in(self, points: Array) -> None:
        """The centre comes through points (n, 3) [m], in this order."""
        for measured in self._objects:
            if measured.bound(points) - self._radius < self.smallest:
                self.smallest = min(self.smallest, measured.distance(points) - self._radius)


class _Measured:
    """An object, and where its distance was measured last."""

    def __init__(self, surface: Surface) -> None:
        self._surface = surface
        centre, radius = surface.bounding_sphere
        self._at, self._least = centre, -radius
        self._centred = True  # on the bounding sphere: the nearer, the less; later the way since counts

    def bound(self, points: Array) -> float:
        """A lower bound [m] of the distances of points (n, 3)."""
        away = points - self._at
        squares = np.vecdot(away, away)
        if self._centred:
            return float(np.sqrt(squares.min())) + self._least
        return self._least - float(np.sqrt(squares.max()))

    def distance(self, points: Array) -> float:
        """The smallest distance [m] of points (n, 3)."""
        found = self._exact(points)
        self._at, self._least, self._centred = points[-1], float(found[-1]), False
        return float(found.min())

    def _exact(self, points: Array) -> Array:
        return self._surface.signed_distance(points)


class _Turned(_Measured):
    """A lathe outside which the points are: the nearest of samples of its meridian, then Newton, and the caps."""

    def __init__(self, lathe: Lathe) -> None:
        super().__init__(lathe)
        self._profile = LatheLevel(lathe).profile
        self._z = np.linspace(0, lathe.profile.height, SAMPLES)
        self._r = self._profile(self._z)[0]

    def _exact(self, points: Array) -> Array:
        p = self._surface._local(points)
        rho, z = np.sqrt(np.vecdot(p[:, :2], p[:, :2])), p[:, 2]
        best = np.argmin((self._r - rho[:, None]) ** 2 + (self._z - z[:, None]) ** 2, axis=1)
        low, high = self._z[np.maximum(best - 1, 0)], self._z[np.minimum(best + 1, SAMPLES - 1)]
        x = self._z[best]
        for _ in range(ITERATIONS):
            r, r1, r2 = self._profile(x)
            slope, curvature = (r - rho) * r1 + x - z, r1 * r1 + (r - rho) * r2 + 1
            new = np.minimum(np.maximum(x - slope / np.maximum(curvature, 0.1), low), high)
            step, x = np.abs(new - x).max(), new
            if step < CONVERGED:
                break
        r = self._profile(x)[0]
        nearest = (r - rho) ** 2 + (x - z) ** 2
        for i in (0, -1):
            nearest = np.minimum(nearest, np.maximum(rho - self._r[i], 0.0) ** 2 + (z - self._z[i]) ** 2)
        inside = (rho < r) & (z > 0) & (z < self._z[-1])
        return np.sqrt(nearest) if not inside.any() else super()._exact(points)


class _Convex(_Measured):
    """A smooth convex object outside which the points are: x is nearest to y where y - x is along the outward normal at x."""

    def __init__(self, surface: Surface) -> None:
        super().__init__(surface)
        self._level = level_set(surface)
        self._foot: Array | None = (
            None  # (3,) nearest to the last point, in the object frame; (3,) normal there
        )
        self._normal = np.zeros(3)

    def bound(self, points: Array) -> float:
        if self._foot is None:
            return super().bound(points)
        y = self._surface._local(points)
        return max(super().bound(points), float(np.min((y - self._foot) @ self._normal)))

    def _exact(self, points: Array) -> Array:
        y = self._surface._local(points)
        start = self._radial(y[-1]) if self._foot is None else self._foot
        x, n, found = self._nearest(y, np.broadcast_to(start, y.shape))
        distance = np.vecdot(y - x, n)
        self._foot, self._normal = x[-1], n[-1]
        if found and np.all(distance > 0):
            return distance
        self._foot = None
        return super()._exact(points)

    def _radial(self, y: Array) -> Array:
        """Where the line from the middle to y (3,) leaves the object."""
        low, high = 0.0, 1.0
        for _ in range(40):
            middle = (low + high) / 2
            low, high = (middle, high) if self._level.inside(middle * y) else (low, middle)
        return low * y

    def _nearest(self, y: Array, x: Array) -> tuple[Array, Array, bool]:
        """Points x (n, 3) of the surface and normals there, and whether they are nearest to y (n, 3), by Newton in the tangent
        planes: with distance d and curvature S there, (1 + d S) dx is what y - x is off the normal."""
        n = x
        for _ in range(ITERATIONS):
            F, g, _ = self._level.differential(x, x)
            steep = np.sqrt(np.vecdot(g, g))[:, None]
            n = g / steep
            u, v = _tangents(n)
            _, _, along = self._level.differential(np.concatenate([x, x]), np.concatenate([u, v]))
            Su, Sv = along[: len(x)] / steep, along[len(x) :] / steep
            r = y - x
            d = np.vecdot(r, n)
            a, b, c = 1 + d * np.vecdot(u, Su), d * np.vecdot(u, Sv), 1 + d * np.vecdot(v, Sv)
            p, q = np.vecdot(r, u), np.vecdot(r, v)
            det = a * c - b * b
            step = (
                ((c * p - b * q) / det)[:, None] * u
                + ((a * q - b * p) / det)[:, None] * v
                - F[:, None] / steep * n
            )
            x = x + step
            if np.abs(step).max() < CONVERGED:
                return x, n, True
        return x, n, False


def _tangents(n: Array) -> tuple[Array, Array]:
    """Two unit vectors (m, 3) that complete unit normals n (m, 3) to frames (Duff et al., JCGT 6(1), 2017)."""
    x, y, z = n.T
    sign = np.where(z < 0, -1.0, 1.0)
    a = -1 / (sign + z)
    b = x * y * a
    return (
        np.stack([1 + sign * x * x * a, sign * b, -sign * x], axis=1),
        np.stack([b, sign + y * y * a, -y], axis=1),
    )
