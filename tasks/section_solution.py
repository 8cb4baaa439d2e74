"""What a least-squares solution says of sections: radii and contact points, with or without references that are held fixed."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from extremal.estimator.adjustment import LOOSE
from extremal.estimator.camera import Array
from extremal.tasks.compiled import compiled
from extremal.tasks.triples import crossed, dot, row

LEAST_VOLUME = 1e-12  # of three unknowns' information, scaled to ones on the diagonal, that tells them apart


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
            covariance: (3 n, 3 n), the upper triangle; the other is written. blocks: (n, 3, 3) of the information for known poses. distance: (n,) [m] of the camera.
        """
        _mirror(covariance)
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
        each = _less(self.covariance, at, gain)
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
        told, theta = self.spread.held(fixed), self.held_theta(fixed)
        radius = theta[:, 2].copy()
        radius[fixed] = told.others @ self.theta.ravel()[told.at]
        return Sections(theta, told.covariance, radius, told.sigma, told.valid)

    def held_theta(self, fixed: NDArray[np.bool_]) -> Array:
        """theta (n, 3) where the radii of sections `fixed` (n,) are zero."""
        if not fixed.any():
            return self.theta
        told = self.spread.held(fixed)
        return self.theta - (told.gain @ self.theta.ravel()[told.at]).reshape(-1, 3)


@compiled
def _less(covariance: Array, at: NDArray[np.integer], gain: Array) -> Array:
    """Blocks (n, 3, 3) on the diagonal of covariance - gain covariance[at], of unknowns where those at (k,) are known; gain (3 n, k)."""
    n = len(covariance) // 3
    each = np.empty((n, 3, 3))
    for i in range(n):
        for j in range(3):
            for k in range(3):
                each[i, j, k] = covariance[3 * i + j, 3 * i + k]
                for m in range(len(at)):
                    each[i, j, k] -= gain[3 * i + j, m] * covariance[at[m], 3 * i + k]
    return each


@compiled
def _mirror(matrix: Array) -> None:
    """Copy the upper triangle of a matrix into the lower one."""
    for i in range(len(matrix)):
        for j in range(i):
            matrix[i, j] = matrix[j, i]


def diagonal_blocks(matrix: Array) -> Array:
    """A view (n, 3, 3) of the blocks on the diagonal of a matrix (3 n, 3 n)."""
    n = len(matrix) // 3
    return np.einsum("iaib->iab", matrix.reshape(n, 3, n, 3))


@compiled
def _resolved(blocks: Array) -> NDArray[np.bool_]:
    """Whether information (n, 3, 3) determines all three unknowns better than the prior does."""
    found = np.zeros(len(blocks), np.bool_)
    for i in range(len(blocks)):
        block = blocks[i]
        scale = block[0, 0] * block[1, 1] * block[2, 2]
        volume = dot(row(block, 0), crossed(row(block, 1), row(block, 2)))
        found[i] = scale > 0 and volume > LEAST_VOLUME * scale
    return found
