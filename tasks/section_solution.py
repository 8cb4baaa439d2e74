"""What a least-squares solution says of sections: radii and contact points, with or without references that are held fixed."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from extremal.estimator.adjustment import LOOSE
from extremal.estimator.camera import Array


@dataclass(frozen=True, eq=False)
class Sections:
    """n sections: theta (n, 3) = (s, q, R) [m] with covariance (n, 3, 3), and of R alone: radius, sigma (n,), of a reference
    what the others make of it; valid (n,)."""

    theta: Array
    covariance: Array
    radius: Array
    sigma: Array
    valid: NDArray[np.bool_]


class Spread:
    """How uncertain n sections are.

    Attributes:
        covariance: (3 n, 3 n) of their unknowns, one section after the other.
        free: that of each and sigma of its radius where nothing is fixed.
    """

    def __init__(self, covariance: Array, blocks: Array, distance: Array) -> None:
        """
        Args:
            covariance: (3 n, 3 n). blocks: (n, 3, 3) of the information for known poses. distance: (n,) [m] of the camera.
        """
        self.covariance, self._blocks, self._distance = covariance, blocks, distance
        self._known = _resolved(blocks)
        self._fixed, self._held = np.zeros(0, bool), None
        variance = np.maximum(np.diagonal(covariance)[2::3], 0.0)
        self.free = _Told(*self._judged(diagonal_blocks(covariance).copy(), variance))

    def held(self, fixed: NDArray[np.bool_]) -> "_Held":
        """The same where the radii of sections `fixed` (n,), at least one, are zero."""
        if self._held is None or not np.array_equal(fixed, self._fixed):
            self._fixed, self._held = fixed.copy(), self._hold(fixed)
        return self._held

    def _hold(self, fixed: NDArray[np.bool_]) -> "_Held":
        at = 3 * np.flatnonzero(fixed) + 2
        Q = np.linalg.inv(self.covariance[np.ix_(at, at)])
        gain = self.covariance[:, at] @ Q
        n = len(fixed)
        less = gain.reshape(n, 3, -1) @ self.covariance[:, at].reshape(n, 3, -1).swapaxes(1, 2)
        each = diagonal_blocks(self.covariance) - less
        information = np.diagonal(Q)
        variance = np.maximum(each[:, 2, 2], 0.0)
        variance[fixed] = 1 / information
        return _Held(*self._judged(each, variance), at, gain, Q / information[:, None])

    def _judged(self, each: Array, variance: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
        place = np.sqrt(np.maximum(each[:, 0, 0] + each[:, 1, 1], 0.0))
        valid = self._known & (place < LOOSE * self._distance)
        return each, np.where(valid, np.sqrt(variance), np.inf), valid

    def shared(self) -> tuple[Array, Array]:
        """Variance (n,) of each free radius for known poses, and (n, n) shared: radii i and j have the covariance
        shared_i . shared_j besides."""
        known = self._known
        own = np.full(len(known), np.inf)
        own[known] = np.linalg.inv(self._blocks[known])[:, 2, 2]
        rest = self.covariance[2::3, 2::3] - np.diag(np.where(known, own, 0.0))
        values, vectors = np.linalg.eigh(rest)
        return own, vectors * np.sqrt(np.maximum(values, 0.0))


@dataclass(frozen=True, eq=False)
class _Told:
    """covariance (n, 3, 3), sigma of R (n,), valid (n,)."""

    covariance: Array
    sigma: Array
    valid: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class _Held(_Told):
    """Besides: the places `at` (k,) of the radii that are fixed, the gain (3 n, k) by which they tell of all unknowns, and what
    they say of each other (k, k)."""

    at: NDArray[np.integer]
    gain: Array
    others: Array


@dataclass(frozen=True, eq=False)
class Solution:
    """theta (n, 3) where nothing is fixed, and its spread."""

    theta: Array
    spread: Spread

    @cached_property
    def free(self) -> Sections:
        """Nothing is fixed."""
        told = self.spread.free
        return Sections(self.theta, told.covariance, self.theta[:, 2], told.sigma, told.valid)

    def held(self, fixed: NDArray[np.bool_]) -> Sections:
        """The radii of sections `fixed` (n,) are zero."""
        if not fixed.any():
            return self.free
        told = self.spread.held(fixed)
        R = self.theta.ravel()[told.at]
        theta = self.theta - (told.gain @ R).reshape(-1, 3)
        radius = theta[:, 2].copy()
        radius[fixed] = told.others @ R
        return Sections(theta, told.covariance, radius, told.sigma, told.valid)


def diagonal_blocks(matrix: Array) -> Array:
    """A view (n, 3, 3) of the blocks on the diagonal of a matrix (3 n, 3 n)."""
    n = len(matrix) // 3
    return np.einsum("iaib->iab", matrix.reshape(n, 3, n, 3))


def _resolved(blocks: Array) -> NDArray[np.bool_]:
    """Whether information (n, 3, 3) determines all three unknowns better than the prior does."""
    scale = np.sqrt(np.einsum("nii->ni", blocks))
    unit = blocks / np.maximum(scale[:, :, None] * scale[:, None], 1e-300)
    return (scale.min(axis=1, initial=np.inf) > 0) & (np.linalg.det(unit) > 1e-12)
