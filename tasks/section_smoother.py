"""Sections and camera poses from all looks of a set of tracks at once, anew with every look.

    w (n.(v - o) - (a s + b q + (rho - a) R)) = noise,    T = T_believed exp(root z),  z ~ N(0, I)

is the adjustment of `estimator.adjustment`, of a few dozen tracks: they are so few that the dense system of their unknowns
theta = (s, q, R) is solved in about a millisecond, once the poses are eliminated look by look. `ContourFilter`, which is made
for hundreds of tracks, linearises a look but once: with few tracks and poses that are off by 1 mm and 1 mrad, the path that it
finds is bent across the sections' planes, by several of its standard deviations. Every Gauss-Newton step here starts from
what the last one found, so that a look takes but a few.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from extremal.estimator.adjustment import LOOSE, robust_factor
from extremal.estimator.camera import Array
from extremal.estimator.poses import pose_exp
from extremal.estimator.slant import smoothed_tangent_planes

MOST_LOOKS = 60  # that are kept: of more, the one goes whose neighbours are nearest to each other
EARLY, EARLY_STEPS, STEPS = (
    12,
    3,
    2,
)  # looks until which more steps are taken than later; before, no look is an outlier
ACROSS_PRIOR, DEPTH_PRIOR, RADIUS_PRIOR = (
    0.1,
    0.06,
    0.06,
)  # sigma of s [m], of q as a fraction of the distance, of R [m]
LARGEST_RADIUS = 0.3  # [m] at which looks are linearised
ROUNDING = 1e-7  # of its information that a section is given besides, so that rounding leaves it positive


@dataclass(frozen=True, eq=False)
class Sections:
    """n sections: theta (n, 3) = (s, q, R) [m] with covariance (n, 3, 3), and of R alone: radius, sigma (n,), of a reference
    what the others make of it; valid (n,)."""

    theta: Array
    covariance: Array
    radius: Array
    sigma: Array
    valid: NDArray[np.bool_]


class SectionSmoother:
    """Least squares on all looks.

    Attributes:
        fixed: (n,) sections that are believed to be fixed: where looks are linearised.
    """

    def __init__(
        self, origin: Array, frame: Array, distance: Array, systematic: float, turn: float, noisy_slant: bool
    ) -> None:
        """
        Args:
            origin: (n, 3) [m] near the contact points. frame: (n, 3, 3) rows N_0, T_0, N_0 x T_0 in the world.
            distance: (n,) [m] of the origins from the camera.
            systematic: [rad] standard deviation of errors of edges that repeat in looks from nearly the same direction, until
                it has turned by `turn` [rad]: as many looks as the arc holds average them, not more.
            noisy_slant: whether the direction of a contour is measured with errors of its own, to be smoothed (`slant`).
        """
        self._noisy_slant = noisy_slant
        n = len(origin)
        self._origin, self._frame, self._distance = origin, frame, distance
        self._systematic, self._turn = systematic, turn
        self.fixed = np.zeros(n, bool)
        self._theta = np.zeros((n, 3))
        self._believed, self._root, self._z = np.zeros((0, 4, 4)), np.zeros((0, 6, 0)), np.zeros((0, 0))
        self._normals, self._sigma = np.zeros((0, n, 3)), np.zeros((0, n))
        self.count = 0

    def update(self, believed: Array, root: Array, normals: Array, sigma: Array) -> None:
        """Take in a look.

        Args:
            believed: (4, 4) pose. root: (6, K) square root of its covariance, K the same in all looks.
            normals: (n, 3) unit normals of the tangent planes in the camera frame, on the side of N_0.
            sigma: (n,) [rad] of the planes' angles about the camera centre; infinite where unseen.
        """
        if self.count == 0:
            self._root, self._z = np.zeros((0, *root.shape)), np.zeros((0, root.shape[1]))
        self._believed = np.concatenate([self._believed, believed[None]])
        self._root = np.concatenate([self._root, root[None]])
        self._z = np.concatenate([self._z, np.zeros((1, root.shape[1]))])
        self._normals = np.concatenate([self._normals, normals[None]])
        self._sigma = np.concatenate([self._sigma, sigma[None]])
        self.count += 1
        if len(self._z) > MOST_LOOKS:
            self._leave_one_out()

    def _leave_one_out(self) -> None:
        centres = self._believed[:, :3, 3]
        gap = np.linalg.norm(centres[2:] - centres[:-2], axis=1)
        keep = np.arange(len(centres)) != 1 + int(np.argmin(gap))
        for name in ("_believed", "_root", "_z", "_normals", "_sigma"):
            setattr(self, name, getattr(self, name)[keep])

    def solve(self) -> "Solution":
        """Step from the last solution, and what is known of all sections."""
        solution = self._step()
        for _ in range((EARLY_STEPS if self.count < EARLY else STEPS) - 1):
            solution = self._step()
        return solution

    def _step(self) -> "Solution":
        X, O, y = self._rows()
        n = len(self._theta)
        blocks = np.einsum("vni,vnj->nij", X, X)
        known = _resolved(blocks)
        B = (np.swapaxes(X, 0, 1)[..., None] * np.swapaxes(O, 0, 1)[:, :, None]).transpose(0, 2, 1, 3)
        inner = np.linalg.inv(np.eye(O.shape[2]) + np.swapaxes(O, 1, 2) @ O)
        G = (B.reshape(3 * n, *B.shape[2:]).transpose(1, 0, 2) @ np.linalg.cholesky(inner)).transpose(1, 0, 2)
        G = G.reshape(3 * n, -1)
        pull = np.einsum("vnk,vn->vk", O, y)
        right = np.einsum("vni,vn->ni", X, y) - np.einsum(
            "nivk,vk->ni", B, np.einsum("vkl,vl->vk", inner, pull)
        )
        S = -G @ G.T
        at = 3 * np.arange(n)[:, None] + np.arange(3)
        S[at[:, :, None], at[:, None]] += blocks + (self._prior()[:, :, None] + ROUNDING * blocks) * np.eye(3)
        P = cho_solve(cho_factor(S), np.eye(3 * n)) if n else S
        solution = Solution((P @ right.ravel()).reshape(n, 3), P, blocks, known, self._distance)
        # where little is known, a step may lead out of what the linear model means
        reach = np.stack([LOOSE * self._distance] * 2 + [np.full(n, LARGEST_RADIUS)], axis=1)
        self._theta = np.clip(solution.held(self.fixed).theta, -reach, reach)
        left = pull - np.einsum("nivk,ni->vk", B, self._theta)
        self._z = np.einsum("vkl,vl->vk", inner, left)
        return solution

    def _prior(self) -> Array:
        """Information (n, 3) on s, q, R: they are those of objects that stand on tables, near where they were first seen."""
        one = np.ones_like(self._distance)
        return (
            np.stack([ACROSS_PRIOR * one, DEPTH_PRIOR * self._distance, RADIUS_PRIOR * one], axis=1) ** -2.0
        )

    def _rows(self) -> tuple[Array, Array, Array]:
        """Rows y = X theta + O z + noise, in standard deviations: X (V, n, 3), O (V, n, K), y (V, n)."""
        poses = self._believed @ _matrices(np.einsum("vik,vk->vi", self._root, self._z))
        rotation, centre = poses[:, :3, :3], poses[:, :3, 3]
        s, q, R = self._theta.T
        normals = self._normals @ np.swapaxes(rotation, 1, 2)
        if self._noisy_slant:
            normals = self._smoothed(normals, centre)
        a, b = np.einsum("vni,nji->jvn", normals, self._frame[:, :2])
        rho = np.maximum(np.sqrt(a * a + b * b), 1e-9)
        lever = centre[:, None] - self._origin
        contact = np.stack([s - R + R * a / rho, q + R * b / rho], axis=-1)
        arm = lever - np.einsum("vnj,nji->vni", contact, self._frame[:, :2])
        X = np.stack([a, b, rho - a], axis=-1)
        target = np.einsum("vni,vni->vn", normals, lever)
        misses = target - np.einsum("vni,ni->vn", X, self._theta)
        distance = np.sqrt(np.einsum("vni,vni->vn", arm, arm))
        weight = 1 / (np.hypot(self._sigma, self._repeated(a / rho, b / rho)) * distance)
        weight = weight * robust_factor(weight * misses) if self.count >= EARLY else weight
        arm, seen = arm @ rotation, normals @ rotation
        turn = seen[..., [1, 2, 0]] * arm[..., [2, 0, 1]] - seen[..., [2, 0, 1]] * arm[..., [1, 2, 0]]
        own = np.concatenate([seen, turn], axis=-1) @ self._root
        moved = np.einsum("vnk,vk->vn", own, self._z)
        return X * weight[..., None], -own * weight[..., None], (target - moved) * weight

    def _smoothed(self, normals: Array, centre: Array) -> Array:
        """World normals (V, n, 3) through the same lines in the sections' planes, with slants smoothed over the looks."""
        at = self._origin + np.einsum("nj,nji->ni", self._theta[:, :2], self._frame[:, :2])
        rays = at - centre[:, None]
        # through the measured planes: a normal is perpendicular to its ray
        rays = rays - np.einsum("vni,vni->vn", rays, normals)[..., None] * normals
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        seen = np.isfinite(self._sigma).T
        smooth = smoothed_tangent_planes(
            np.swapaxes(normals, 0, 1), np.swapaxes(rays, 0, 1), self._frame[:, 2], seen, 0
        )
        smooth = np.swapaxes(smooth, 0, 1)
        return smooth * np.where(np.einsum("vni,vni->vn", smooth, normals) < 0, -1.0, 1.0)[..., None]

    def _repeated(self, cosine: Array, sine: Array) -> Array:
        """What is added to sigma (n,) [rad] in quadrature, for errors that repeat."""
        phi = np.where(np.isfinite(self._sigma), np.arctan2(sine, cosine), np.nan)
        seen = np.isfinite(self._sigma).sum(axis=0)
        arc = np.where(seen > 0, np.fmax.reduce(phi, axis=0) - np.fmin.reduce(phi, axis=0), 0.0)
        return self._systematic * np.sqrt(np.maximum(seen / (1 + arc / self._turn), 1.0))


@dataclass(frozen=True, eq=False)
class Solution:
    """theta (n, 3) with covariance (3 n, 3 n), and blocks (n, 3, 3) of its information for known poses."""

    theta: Array
    covariance: Array
    blocks: Array
    known: NDArray[np.bool_]
    distance: Array

    def free(self) -> Sections:
        """Nothing is fixed."""
        return self._sections(self.theta, self.covariance, self.theta[:, 2], self._variance(self.covariance))

    def held(self, fixed: NDArray[np.bool_]) -> Sections:
        """The radii of sections `fixed` (n,) are zero."""
        if not fixed.any():
            return self.free()
        at = 3 * np.flatnonzero(fixed) + 2
        R, Q = self.theta.ravel()[at], np.linalg.inv(self.covariance[np.ix_(at, at)])
        gain = self.covariance[:, at] @ Q
        theta = (self.theta.ravel() - gain @ R).reshape(self.theta.shape)
        covariance = self.covariance - gain @ self.covariance[at]
        radius, variance = theta[:, 2].copy(), self._variance(covariance)
        radius[fixed], variance[fixed] = (Q @ R) / np.diagonal(Q), 1 / np.diagonal(Q)
        return self._sections(theta, covariance, radius, variance)

    def shared(self) -> tuple[Array, Array]:
        """Variance (n,) of each free radius for known poses, and (n, n) shared: radii i and j have the covariance
        shared_i . shared_j besides."""
        own = np.full(len(self.theta), np.inf)
        own[self.known] = np.linalg.inv(self.blocks[self.known])[:, 2, 2]
        rest = self.covariance[2::3, 2::3] - np.diag(np.where(self.known, own, 0.0))
        values, vectors = np.linalg.eigh(rest)
        return own, vectors * np.sqrt(np.maximum(values, 0.0))

    @staticmethod
    def _variance(covariance: Array) -> Array:
        return np.maximum(np.diagonal(covariance)[2::3], 0.0)

    def _sections(self, theta: Array, covariance: Array, radius: Array, variance: Array) -> Sections:
        n = len(theta)
        at = 3 * np.arange(n)[:, None] + np.arange(3)
        each = covariance[at[:, :, None], at[:, None]]
        valid = self.known & (np.sqrt(np.maximum(each[:, 0, 0] + each[:, 1, 1], 0.0)) < LOOSE * self.distance)
        return Sections(theta, each, radius, np.where(valid, np.sqrt(variance), np.inf), valid)


def _resolved(blocks: Array) -> NDArray[np.bool_]:
    """Whether information (n, 3, 3) determines all three unknowns better than the prior does."""
    scale = np.sqrt(np.einsum("nii->ni", blocks))
    unit = blocks / np.maximum(scale[:, :, None] * scale[:, None], 1e-300)
    return (scale.min(axis=1, initial=np.inf) > 0) & (np.linalg.det(unit) > 1e-12)


def _matrices(twists: Array) -> Array:
    return pose_exp(twists).as_matrix() if len(twists) else np.zeros((0, 4, 4))
