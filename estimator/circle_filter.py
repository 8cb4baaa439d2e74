"""Where will a contour cross its epipolar plane next? An information filter on the circle of eq. 3.23."""

import numpy as np

from extremal.estimator.camera import Array
from extremal.estimator.epipolar import EpipolarPlanes
from extremal.estimator.errors import InvalidInput

RADIUS_PRIOR = 0.06  # [m] standard deviation of R before anything is seen
ACROSS = 1e-9  # length of a unit ray in its plane, below which it is perpendicular to it


class CircleFilter:
    """Information filter on (p0, R) in each epipolar plane: eq. 3.23, a row a view.

    What is not finite, or has no direction in its plane, tells nothing; a circle that nothing is known of is predicted at NaN,
    with infinite sigma.
    """

    def __init__(self, planes: EpipolarPlanes, rays: Array, depth: Array, sigma: Array) -> None:
        """
        Args:
            planes: n of them. rays: (n, 3) unit, from the planes' origin to the contact points.
            depth: (n,) [m] along the rays, known to a few per cent. sigma: (n,) [rad] of the rays in the planes.

        Raises InvalidInput for other shapes.
        """
        self.planes = planes
        n = len(planes.normal)
        self._check(rays=(rays, (n, 3)), depth=(depth, (n,)), sigma=(sigma, (n,)))
        self.information = np.zeros((n, 3, 3))
        self.vector = np.zeros((n, 3))
        self.information[:, 2, 2] = RADIUS_PRIOR**-2
        # the sweep: depth to a few per cent
        x, y = planes.coordinates(rays)
        along = np.stack([x, y, np.zeros(n)], axis=1)
        sound = np.isfinite(depth) & (depth > 0) & np.all(np.isfinite(along), axis=1)
        depth = np.where(sound, depth, 1.0)
        along[~sound] = 0.0
        weight = (0.04 * depth) ** -2.0
        self.information += weight[:, None, None] * along[:, :, None] * along[:, None, :]
        self.vector += (weight * depth)[:, None] * along
        self.update(sound, planes.origin, rays, sigma, planes.origin + depth[:, None] * rays)

    @staticmethod
    def _check(**given: tuple[Array, tuple[int, ...]]) -> None:
        for name, (value, shape) in given.items():
            if np.shape(value) != shape:
                raise InvalidInput(f"{name} of circles are {np.shape(value)}; accepted: {shape}")

    def _solve(self) -> None:
        try:
            self.covariance = np.linalg.inv(self.information)
        except np.linalg.LinAlgError:  # of one circle: the others are none the worse
            unknown = ~(np.linalg.slogdet(self.information).sign > 0)
            self.covariance = np.linalg.inv(np.where(unknown[:, None, None], np.eye(3), self.information))
            self.covariance[unknown] = np.nan
        self.state = np.einsum("nij,nj->ni", self.covariance, self.vector)

    def predict(self, centre: Array) -> tuple[Array, Array]:
        """Contact points (n, 3) as seen from a centre (3,), and sigma (n,) [rad] of their direction in the plane."""
        self._check(centre=(centre, (3,)))
        x0, y0 = self.planes.coordinates(np.broadcast_to(centre - self.planes.origin, (len(self.state), 3)))
        dx, dy = self.state[:, 0] - x0, self.state[:, 1] - y0
        distance = np.hypot(dx, dy)
        sine = np.clip(-self.state[:, 2] / np.maximum(distance, 1e-6), -0.9, 0.9)
        cosine = np.sqrt(1 - sine**2)
        with np.errstate(invalid="ignore"):  # a camera at the circle's own place sees it nowhere
            ux, uy = dx / distance, dy / distance
            nx, ny = sine * ux + cosine * uy, sine * uy - cosine * ux  # the normal on the side of the travel
            row = np.stack([nx, ny, np.ones_like(nx)], axis=1)
            spread = np.sqrt(np.einsum("ni,nij,nj->n", row, self.covariance, row))
        x, y = self.state[:, 0] + self.state[:, 2] * nx, self.state[:, 1] + self.state[:, 2] * ny
        points = self.planes.origin + x[:, None] * self.planes.along + y[:, None] * self.planes.across
        spread /= np.maximum(np.hypot(x - x0, y - y0), 1e-6)
        unknown = ~(np.isfinite(spread) & np.all(np.isfinite(points), axis=1))
        points[unknown], spread[unknown] = np.nan, np.inf
        return points, spread

    def innovation(self, centre: Array, points: Array, rays: Array) -> Array:
        """Angle (n,) [rad] in the plane from the predicted to the measured ray; NaN where either is not known."""
        n = len(self.state)
        self._check(centre=(centre, (3,)), points=(points, (n, 3)), rays=(rays, (n, 3)))
        ax, ay = self.planes.coordinates(points - centre)
        bx, by = self.planes.coordinates(rays)
        return np.arctan2(ax * by - ay * bx, ax * bx + ay * by)

    def update(self, ok: np.ndarray, centre: Array, rays: Array, sigma: Array, points: Array) -> None:
        """Take in the tangents of one view where `ok`.

        Args:
            ok: (n,). centre: (3,) [m] of the camera. rays: (n, 3) unit. sigma: (n,) [rad] of the rays in the planes.
            points: (n, 3) [m] where the contact points are expected.

        Raises InvalidInput for other shapes.
        """
        n = len(self.vector)
        self._check(
            ok=(ok, (n,)),
            centre=(centre, (3,)),
            rays=(rays, (n, 3)),
            sigma=(sigma, (n,)),
            points=(points, (n, 3)),
        )
        x, y = self.planes.coordinates(rays)
        length = np.maximum(np.hypot(x, y), ACROSS)
        row = np.stack([y / length, -x / length, np.ones_like(x)], axis=1)
        offset = np.broadcast_to(centre - self.planes.origin, (len(x), 3))
        x0, y0 = self.planes.coordinates(offset)
        support = x0 * row[:, 0] + y0 * row[:, 1]
        distance = np.linalg.norm(points - centre, axis=1)
        tells = ok & (sigma >= 0) & (length > ACROSS) & (distance > 0) & np.isfinite(support * distance)
        # egomotion and the surface's deviation from a circle are not in sigma: a floor keeps the filter humble
        far = np.hypot(np.where(tells, sigma, 1.0), 2e-4) * np.where(tells, distance, 1.0)
        weight = np.where(tells, 1.0 / far**2, 0.0)
        row, support = np.where(tells[:, None], row, 0.0), np.where(tells, support, 0.0)
        self.information += weight[:, None, None] * row[:, :, None] * row[:, None, :]
        self.vector += (weight * support)[:, None] * row
        self._solve()
