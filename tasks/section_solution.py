"""What a least-squares solution says of sections: radii and contact points, with or without references that are held fixed."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from extremal.estimator.adjustment import LOOSE
from extremal.estimator.camera import Array
from extremal.tasks.compiled import compiled
from extremal.tasks.triples import crossed, dot, put, row

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
        root: (3 n, 3 n) upper triangle W of the covariance W W' of their unknowns, one section after the other.
        free: covariance of each and sigma of its radius where nothing is fixed.
    """

    def __init__(self, root: Array, blocks: Array, distance: Array) -> None:
        """
        Args:
            root: (3 n, 3 n); below its diagonal zeros are written. blocks: (n, 3, 3) of the information for known poses.
            distance: (n,) [m] of the camera.
        """
        self.root, self._blocks = root, blocks
        self._farthest = LOOSE * distance
        self._held: dict[bytes, _Held] = {}
        self._known, each, sigma, valid = _of_free(root, blocks, self._farthest)
        self.free = _Told(each, sigma, valid)

    @cached_property
    def covariance(self) -> Array:
        """(3 n, 3 n)."""
        return self.root @ self.root.T

    def held(self, fixed: NDArray[np.bool_]) -> "_Held":
        """The same where the radii of sections `fixed` (n,), at least one, are zero."""
        key = fixed.tobytes()
        if key not in self._held:
            self._held = {key: self._hold(fixed)}
        return self._held[key]

    def _hold(self, fixed: NDArray[np.bool_]) -> "_Held":
        at = 3 * np.flatnonzero(fixed) + 2
        across = self.root @ self.root[at].T
        Q = np.linalg.inv(across[at])
        return _Held(*_of_held(self.free.covariance, across, self._known, self._farthest, fixed, Q))

    def shared(self) -> tuple[Array, Array]:
        """Variance (n,) of each free radius for known poses, and (n, n) shared: radii i and j have the covariance
        shared_i . shared_j besides."""
        own, rest = _parted(self.root, self._blocks, self._known)
        values, vectors = np.linalg.eigh(rest)
        return own, vectors * np.sqrt(np.maximum(values, 0.0))


class _Told(NamedTuple):
    """covariance (n, 3, 3), sigma of R (n,), valid (n,)."""

    covariance: Array
    sigma: Array
    valid: NDArray[np.bool_]


class _Held(NamedTuple):
    """As `_Told`; besides the gain (3 n, k) by which the radii that are fixed tell of all unknowns, and what they say of each other (k, k)."""

    covariance: Array
    sigma: Array
    valid: NDArray[np.bool_]
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
        radius = _radii_held(theta, fixed, told.others, self.theta)
        return Sections(theta, told.covariance, radius, told.sigma, told.valid)

    def held_theta(self, fixed: NDArray[np.bool_]) -> Array:
        """theta (n, 3) where the radii of sections `fixed` (n,) are zero."""
        key = fixed.tobytes()
        if 1 not in key:
            return self.theta
        if key not in self._thetas:
            self._thetas[key] = _held_theta(self.theta, fixed, self.spread.held(fixed).gain)
        return self._thetas[key]

    @cached_property
    def _thetas(self) -> dict[bytes, Array]:
        return {}


@compiled
def _held_theta(theta: Array, fixed: NDArray[np.bool_], gain: Array) -> Array:
    """theta (n, 3) less what gain (3 n, k) makes of its radii that are fixed (n,)."""
    radii = theta[:, 2][fixed]
    out = theta.copy()
    for i in range(len(theta)):
        for j in range(3):
            for m in range(len(radii)):
                out[i, j] -= gain[3 * i + j, m] * radii[m]
    return out


@compiled
def _radii_held(held: Array, fixed: NDArray[np.bool_], others: Array, theta: Array) -> Array:
    """Radii (n,) of theta `held` (n, 3); of those that are fixed (n,), what the others (k, k) of theta (n, 3) make of them."""
    radii, out, m = theta[:, 2][fixed], np.empty(len(held)), 0
    for i in range(len(held)):
        out[i] = held[i, 2]
        if fixed[i]:
            out[i] = 0.0
            for k in range(len(radii)):
                out[i] += others[m, k] * radii[k]
            m += 1
    return out


@compiled
def _of_free(
    root: Array, blocks: Array, farthest: Array
) -> tuple[NDArray[np.bool_], Array, Array, NDArray[np.bool_]]:
    """Which sections (n,) are known, and what is told where nothing is fixed, of a root (3 n, 3 n): see `_Told`."""
    n, size = len(blocks), len(root)
    known, each, variance = _resolved(blocks), np.empty((n, 3, 3)), np.empty(n)
    for i in range(n):
        xx = xy = xz = yy = yz = zz = 0.0
        for j in range(3):
            root[3 * i + j, : 3 * i + j] = 0.0
        for k in range(3 * i, size):
            x, y, z = root[3 * i, k], root[3 * i + 1, k], root[3 * i + 2, k]
            xx, xy, xz, yy, yz, zz = xx + x * x, xy + x * y, xz + x * z, yy + y * y, yz + y * z, zz + z * z
        put(each[i], 0, (xx, xy, xz))
        put(each[i], 1, (xy, yy, yz))
        put(each[i], 2, (xz, yz, zz))
        variance[i] = zz
    sigma, valid = _judged(each, variance, known, farthest)
    return known, each, sigma, valid


@compiled
def _of_held(
    free: Array,
    across: Array,
    known: NDArray[np.bool_],
    farthest: Array,
    fixed: NDArray[np.bool_],
    Q: Array,
) -> tuple[Array, Array, NDArray[np.bool_], Array, Array]:
    """What is told where radii are fixed (n,), of covariances `free` (n, 3, 3) where they are not: see `_Held`.

    across: (3 n, k) covariances of all unknowns with these radii; Q: (k, k) inverse of the radii's own.
    """
    gain = across @ Q
    each, others = _less(free, across, gain), Q.copy()
    variance, m = np.empty(len(known)), 0
    for i in range(len(known)):
        variance[i] = max(each[i, 2, 2], 0.0)
        if fixed[i]:
            variance[i] = 1 / Q[m, m]
            others[m] /= Q[m, m]
            m += 1
    sigma, valid = _judged(each, variance, known, farthest)
    return each, sigma, valid, gain, others


@compiled
def _judged(
    each: Array, variance: Array, known: NDArray[np.bool_], farthest: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """Sigma (n,) of radii with a variance, infinite where not valid (n,): `known`, and places no worse than `farthest` [m]."""
    sigma, valid = np.full(len(known), np.inf), np.zeros(len(known), np.bool_)
    for i in range(len(known)):
        place = math.sqrt(max(each[i, 0, 0] + each[i, 1, 1], 0.0))
        if known[i] and place < farthest[i]:
            valid[i], sigma[i] = True, math.sqrt(variance[i])
    return sigma, valid


@compiled
def _parted(root: Array, blocks: Array, known: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Variance (n,) of radii for known poses, of information `blocks` (n, 3, 3), infinite unless `known` (n,); and the rest (n, n) of
    their covariance."""
    radii = root[2::3].copy()
    own, rest = np.full(len(known), np.inf), radii @ radii.T
    for i in range(len(known)):
        if known[i]:
            # what is left of R's information, once the other two unknowns are eliminated
            b = blocks[i]
            slope = b[0, 1] / b[0, 0]
            left = (b[1, 2] - slope * b[0, 2]) ** 2 / (b[1, 1] - slope * b[0, 1])
            own[i] = 1 / (b[2, 2] - b[0, 2] * b[0, 2] / b[0, 0] - left)
            rest[i, i] -= own[i]
    return own, rest


@compiled
def _less(free: Array, across: Array, gain: Array) -> Array:
    """Covariances (n, 3, 3) less what k other unknowns, when they are known, tell of them: gain (3 n, k) times across (3 n, k)."""
    each = free.copy()
    for i in range(len(free)):
        for j in range(3):
            for k in range(3):
                for m in range(gain.shape[1]):
                    each[i, j, k] -= gain[3 * i + j, m] * across[3 * i + k, m]
    return each


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
