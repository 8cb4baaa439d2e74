"""Looks at sections, and the linear equations that they make.

    w (n.(v - o) - (a s + b q + (rho - a) R)) = noise,    T = T_believed exp(root z),  z ~ N(0, I)

as in `estimator.adjustment`: rows y = X theta + O z + noise of theta = (s, q, R), in standard deviations. With z eliminated,
a look is information on theta: X'X of each section alone, less G G' that the look's pose takes from all of them together.
"""

from dataclasses import dataclass, fields

import numpy as np

from extremal.estimator.adjustment import robust_factor
from extremal.estimator.camera import Array
from extremal.estimator.slant import smoothed_tangent_planes
from extremal.tasks.section_solution import diagonal_blocks

ROUNDING = 1e-7  # of its information that a section is given besides, so that rounding leaves it positive
TERMS = 8  # of the exponential of a pose error: to rounding at 0.05 rad
NEAREST = 0.25  # of their first distance that contact points are from the camera, for the weight of a look


@dataclass(frozen=True, eq=False)
class Looks:
    """V looks at n sections.

    Attributes:
        believed: (V, 4, 4) poses. root: (V, 6, K) square roots of their covariances. z: (V, K) where they are linearised.
        normals: (V, n, 3) unit normals of tangent planes in the camera frame. sigma: (V, n) [rad], infinite where unseen.
    """

    believed: Array
    root: Array
    z: Array
    normals: Array
    sigma: Array

    def __len__(self) -> int:
        return len(self.z)

    @staticmethod
    def one(believed: Array, root: Array, normals: Array, sigma: Array) -> "Looks":
        """A single look, as believed."""
        return Looks(believed[None], root[None], np.zeros((1, root.shape[1])), normals[None], sigma[None])

    @staticmethod
    def together(looks: "list[Looks]") -> "Looks":
        """All of them."""
        return Looks(*(np.concatenate([getattr(one, f.name) for one in looks]) for f in fields(Looks)))


@dataclass(frozen=True, eq=False)
class Told:
    """What V looks say of theta, by an orthonormal basis Q of what their poses can explain: O = Q chol(I + O'O)'.

    Attributes:
        blocks: (V, n, 3, 3) information X'X for known poses. loss: (V, 3 n, K) G = X'Q.
        right: (V, 3 n) of the normal equations, X'(y - Q Q'y). pull: (V, K) Q'y.
        root: (V, K, K) of the covariance root' root of z, theta given.
    """

    blocks: Array
    loss: Array
    right: Array
    pull: Array
    root: Array

    @staticmethod
    def by(X: Array, O: Array, y: Array) -> "Told":
        """Of rows X (V, n, 3), O (V, n, K), y (V, n)."""
        views, n, unknowns = O.shape
        root = np.linalg.inv(np.linalg.cholesky(np.eye(unknowns) + O.swapaxes(1, 2) @ O))
        Q = O @ root.swapaxes(1, 2)
        pull = (y[:, None] @ Q)[:, 0]
        left = y - (Q @ pull[..., None])[..., 0]
        loss = (X[..., None] * Q[:, :, None]).reshape(views, 3 * n, unknowns)
        right = (X * left[..., None]).reshape(views, 3 * n)
        return Told(X[..., None] * X[:, :, None], loss, right, pull, root)

    def part(self, looks: slice) -> "Told":
        """Of some of the looks."""
        return Told(
            self.blocks[looks], self.loss[looks], self.right[looks], self.pull[looks], self.root[looks]
        )

    def each(self) -> "list[Told]":
        """Look by look."""
        return [self.part(slice(i, i + 1)) for i in range(len(self.pull))]


def fitting_poses(told: list[Told], theta: Array) -> Array:
    """z (V, K) of the poses that fit theta (n, 3) best."""
    loss, pull, root = (np.concatenate([getattr(t, name) for t in told]) for name in ("loss", "pull", "root"))
    left = pull - theta.ravel() @ loss
    return (left[:, None] @ root)[:, 0]


@dataclass(eq=False)
class Sums:
    """Normal equations of n sections: matrix (3 n, 3 n), right (3 n,), and blocks (n, 3, 3) of the information for known poses."""

    matrix: Array
    right: Array
    blocks: Array

    @staticmethod
    def prior(information: Array) -> "Sums":
        """Of no look: information (n, 3) on s, q, R."""
        n = len(information)
        return Sums(np.diag(information.ravel()), np.zeros(3 * n), np.zeros((n, 3, 3)))

    def copy(self) -> "Sums":
        return Sums(self.matrix.copy(), self.right.copy(), self.blocks.copy())

    def add(self, told: Told, sign: float = 1.0) -> None:
        """Add what looks say, or take it away."""
        views, size, unknowns = told.loss.shape
        loss = told.loss.swapaxes(0, 1).reshape(size, views * unknowns)
        blocks = sign * told.blocks.sum(axis=0)
        self.matrix -= sign * (loss @ loss.T)
        self.right += sign * told.right.sum(axis=0)
        self.blocks += blocks
        diagonal = diagonal_blocks(self.matrix)
        diagonal += blocks * _ROUNDED


_ROUNDED = 1 + ROUNDING * np.eye(3)


@dataclass(frozen=True, eq=False)
class SectionModel:
    """n sections as `SectionSmoother` describes them: origin (n, 3), frame (n, 3, 3), distance (n,), systematic, turn, noisy_slant."""

    origin: Array
    frame: Array
    distance: Array
    systematic: float
    turn: float
    noisy_slant: bool

    def told(self, looks: Looks, theta: Array, repeats: Array, robust: bool) -> Told:
        """What looks say, linearised at their z and theta (n, 3).

        Args:
            repeats: (n,) [rad] of `repeated`. robust: whether far rows count less.
        """
        plane = self.frame[:, :2]
        poses = looks.believed
        if np.any(looks.z):
            poses = poses @ _exponential((looks.root @ looks.z[..., None])[..., 0])
        rotation, centre = poses[:, :3, :3], poses[:, :3, 3]
        normals, lever = looks.normals @ rotation.swapaxes(1, 2), centre[:, None] - self.origin
        seen = looks.normals
        if self.noisy_slant:
            normals = self._smoothed(normals, centre, looks.sigma, theta)
            seen = normals @ rotation
        X = np.empty(normals.shape)
        ab = (plane @ normals[..., None])[..., 0]
        rho = np.maximum(np.sqrt(np.vecdot(ab, ab)), 1e-9)
        X[..., :2], X[..., 2] = ab, rho - ab[..., 0]
        R = theta[:, 2:]
        contact = theta[:, :2] - R * (1.0, 0.0) + R * (ab / rho[..., None])
        arm = lever - (contact[..., None, :] @ plane)[..., 0, :]
        target = np.vecdot(normals, lever)
        # a contact point that is believed to be in the camera, by a step too long, would weigh without bound
        away = np.maximum(np.sqrt(np.vecdot(arm, arm)), NEAREST * self.distance)
        misses = target - np.vecdot(X, theta)
        weight = 1 / (np.hypot(looks.sigma, repeats) * away)
        if robust:
            weight = weight * robust_factor(weight * misses)
        # Angles are measured, misses / away: with distances held, a smaller world would always fit better.
        slope = normals - (misses / away**2)[..., None] * arm
        ab_slope = (plane @ slope[..., None])[..., 0]
        X[..., :2] = ab_slope
        X[..., 2] = np.vecdot(ab_slope, ab / rho[..., None]) - ab_slope[..., 0]
        own = np.concatenate([slope @ rotation, cross(seen, arm @ rotation)], axis=-1) @ looks.root
        left = misses + np.vecdot(X, theta) - (own @ looks.z[..., None])[..., 0]
        each = weight[..., None]
        return Told.by(X * each, own * -each, left * weight)

    def _smoothed(self, normals: Array, centre: Array, sigma: Array, theta: Array) -> Array:
        """World normals (V, n, 3) through the same lines in the sections' planes, with slants smoothed over the looks."""
        at = self.origin + np.einsum("nj,nji->ni", theta[:, :2], self.frame[:, :2])
        rays = at - centre[:, None]
        # through the measured planes: a normal is perpendicular to its ray
        rays = rays - np.einsum("vni,vni->vn", rays, normals)[..., None] * normals
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        seen = np.isfinite(sigma).T
        smooth = smoothed_tangent_planes(
            np.swapaxes(normals, 0, 1), np.swapaxes(rays, 0, 1), self.frame[:, 2], seen, 0
        )
        smooth = np.swapaxes(smooth, 0, 1)
        return smooth * np.where(np.einsum("vni,vni->vn", smooth, normals) < 0, -1.0, 1.0)[..., None]

    def repeated(self, looks: Looks) -> Array:
        """What is added to sigma (n,) [rad] in quadrature, for errors that repeat."""
        normals = looks.normals @ looks.believed[:, :3, :3].swapaxes(1, 2)
        ab = (self.frame[:, :2] @ normals[..., None])[..., 0]
        seen = np.isfinite(looks.sigma)
        phi = np.where(seen, np.arctan2(ab[..., 1], ab[..., 0]), np.nan)
        count = seen.sum(axis=0)
        arc = np.where(count > 0, np.fmax.reduce(phi, axis=0) - np.fmin.reduce(phi, axis=0), 0.0)
        return self.systematic * np.sqrt(np.maximum(count / (1 + arc / self.turn), 1.0))


def cross(a: Array, b: Array) -> Array:
    """a x b (..., 3), several times as fast as numpy's for few rows."""
    return a[..., _NEXT] * b[..., _LAST] - a[..., _LAST] * b[..., _NEXT]


def _exponential(twists: Array) -> Array:
    """exp (V, 4, 4) of small twists (V, 6), as `estimator.poses.pose_exp`, by its series."""
    generator = np.zeros((len(twists), 4, 4))
    generator[:, :3, 3] = twists[:, :3]
    x, y, z = twists[:, 3:].T
    generator[:, 2, 1], generator[:, 0, 2], generator[:, 1, 0] = x, y, z
    generator[:, 1, 2], generator[:, 2, 0], generator[:, 0, 1] = -x, -y, -z
    series = _UNIT
    for i in range(TERMS, 0, -1):
        series = _UNIT + generator @ series / i
    return series


_UNIT = np.eye(4)
_NEXT, _LAST = np.array([1, 2, 0]), np.array([2, 0, 1])
