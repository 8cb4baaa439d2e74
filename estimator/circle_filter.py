"""Where will a contour cross its epipolar plane next? An information filter on the circle of eq. 3.23."""

import numpy as np

from extremal.estimator.camera import Array
from extremal.estimator.epipolar import EpipolarPlanes

RADIUS_PRIOR = 0.06  # [m] standard deviation of R before anything is seen


class CircleFilter:
    """Information filter on (p0, R) in each epipolar plane: eq. 3.23, a row a view."""

    def __init__(self, planes: EpipolarPlanes, rays: Array, depth: Array, sigma: Array) -> None:
        self.planes = planes
        n = len(depth)
        self.information = np.zeros((n, 3, 3))
        self.vector = np.zeros((n, 3))
        self.information[:, 2, 2] = RADIUS_PRIOR**-2
        # the sweep: depth to a few per cent
        x, y = planes.coordinates(rays)
        along = np.stack([x, y, np.zeros(n)], axis=1)
        weight = (0.04 * depth) ** -2.0
        self.information += weight[:, None, None] * along[:, :, None] * along[:, None, :]
        self.vector += (weight * depth)[:, None] * along
        self.update(np.ones(n, bool), planes.origin, rays, sigma, planes.origin + depth[:, None] * rays)

    def _solve(self) -> None:
        self.covariance = np.linalg.inv(self.information)
        self.state = np.einsum("nij,nj->ni", self.covariance, self.vector)

    def predict(self, centre: Array) -> tuple[Array, Array]:
        """Contact points (n, 3) as seen from a centre (3,), and sigma (n,) [rad] of their direction in the plane."""
        x0, y0 = self.planes.coordinates(np.broadcast_to(centre - self.planes.origin, (len(self.state), 3)))
        dx, dy = self.state[:, 0] - x0, self.state[:, 1] - y0
        distance = np.hypot(dx, dy)
        sine = np.clip(-self.state[:, 2] / np.maximum(distance, 1e-6), -0.9, 0.9)
        cosine = np.sqrt(1 - sine**2)
        ux, uy = dx / distance, dy / distance
        nx, ny = sine * ux + cosine * uy, sine * uy - cosine * ux  # the normal on the side of the travel
        row = np.stack([nx, ny, np.ones_like(nx)], axis=1)
        spread = np.sqrt(np.einsum("ni,nij,nj->n", row, self.covariance, row))
        x, y = self.state[:, 0] + self.state[:, 2] * nx, self.state[:, 1] + self.state[:, 2] * ny
        points = self.planes.origin + x[:, None] * self.planes.along + y[:, None] * self.planes.across
        return points, spread / np.maximum(np.hypot(x - x0, y - y0), 1e-6)

    def innovation(self, centre: Array, points: Array, rays: Array) -> Array:
        """Angle (n,) [rad] in the plane from the predicted to the measured ray."""
        ax, ay = self.planes.coordinates(points - centre)
        bx, by = self.planes.coordinates(rays)
        return np.arctan2(ax * by - ay * bx, ax * bx + ay * by)

    def update(self, ok: np.ndarray, centre: Array, rays: Array, sigma: Array, points: Array) -> None:
        """Take in the tangents of one view where `ok`."""
        x, y = self.planes.coordinates(rays)
        length = np.maximum(np.hypot(x, y), 1e-9)
        row = np.stack([y / length, -x / length, np.ones_like(x)], axis=1)
        offset = np.broadcast_to(centre - self.planes.origin, (len(x), 3))
        x0, y0 = self.planes.coordinates(offset)
        support = x0 * row[:, 0] + y0 * row[:, 1]
        distance = np.linalg.norm(points - centre, axis=1)
        # egomotion and the surface's deviation from a circle are not in sigma: a floor keeps the filter humble
        weight = np.where(ok, 1.0 / (np.hypot(np.where(ok, sigma, 1.0), 2e-4) * distance) ** 2, 0.0)
        self.information += weight[:, None, None] * row[:, :, None] * row[:, None, :]
        self.vector += (weight * support)[:, None] * row
        self._solve()
