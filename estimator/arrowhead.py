"""Normal equations of many small unknowns that meet only through few common ones, and how to keep the few from growing.

    [D   H] [theta]   [b]        D: n blocks (3, 3), one a contour point
    [H'  C] [  c  ] = [d]        c: m common unknowns: errors of cameras

An arrowhead matrix: theta is eliminated block by block, which leaves (C - H' D^-1 H) c = d - H' D^-1 b. Every view adds
the unknowns of its camera to c. Neighbouring cameras act upon all points in much the same way, though: few combinations of
whitened camera errors carry nearly all of H (`compressed`), whatever the number of views.
"""

from dataclasses import dataclass

import numpy as np

from extremal.estimator.camera import Array
from extremal.estimator.errors import DegenerateGeometry


@dataclass(frozen=True, eq=False)
class Rows:
    """W views, linear in all unknowns: residuals y - X theta + common c + own z, in standard deviations, one a point (n).

    X: (W, n, 3), y: (W, n), common: (W, n, C) acts upon the first C of c, own: (W, n, K) upon z of each view;
    off: (W, n) what moves y if a section's plane moves along its normal.
    """

    X: Array
    y: Array
    off: Array
    common: Array
    own: Array

    def __getitem__(self, at: slice) -> "Rows":
        return Rows(self.X[at], self.y[at], self.off[at], self.common[at], self.own[at])


@dataclass(frozen=True, eq=False)
class Arrowhead:
    """blocks D (n, 3, 3), border H (n, 3, m), core C (m, m), vector b (n, 3), load d (m,); aside (n, 3): X' off of all views."""

    blocks: Array
    border: Array
    core: Array
    vector: Array
    aside: Array
    load: Array

    def plus(self, views: "Rows") -> "Arrowhead":
        """With the rows of views, whose own unknowns z ~ N(0, I) join c at its end."""
        (W, n, C), K, m = views.common.shape, views.own.shape[2], len(self.load)
        X, size = views.X, m + W * K
        border = np.zeros((n, 3, size))
        border[:, :, :m] = self.border
        border[:, :, :C] -= np.einsum("wni,wnc->nic", X, views.common)
        border[:, :, m:].reshape(n, 3, W, K)[:] = -(X[..., None] * views.own[:, :, None]).transpose(
            1, 2, 0, 3
        )
        core, load = np.eye(size), np.zeros(size)
        core[:m, :m], load[:m] = self.core, self.load
        both = np.concatenate([views.common, views.own], axis=2)
        square = np.swapaxes(both, 1, 2) @ both
        pull = np.einsum("wn,wnk->wk", views.y, both)
        core[:C, :C] += square[:, :C, :C].sum(axis=0)
        load[:C] -= pull[:, :C].sum(axis=0)
        for w in range(W):
            at = slice(m + w * K, m + (w + 1) * K)
            core[at, at] += square[w, C:, C:]
            core[at, :C], core[:C, at] = square[w, C:, :C], square[w, :C, C:]
            load[at] = -pull[w, C:]
        blocks = np.einsum("wni,wnj->nij", X, X)
        vector, aside = (np.einsum("wn,wni->ni", v, X) for v in (views.y, views.off))
        return Arrowhead(self.blocks + blocks, border, core, self.vector + vector, self.aside + aside, load)

    def compressed(self, keep: int, rank: int, prior: Array, theta: Array, common: Array) -> "Arrowhead":
        """With at most `rank` combinations in place of the unknowns behind the first `keep` of c.

        Those unknowns are whitened (core I) and turned to the principal axes of H' (D + prior)^-1 H. The least of them are
        held at their present values, those that follow from theta (n, 3) and the first of c, common (keep,). They are
        orthogonal to the others: along what is known least of the points nothing is added to what is known.
        """
        head, tail = slice(keep), slice(keep, None)
        root = np.linalg.inv(np.linalg.cholesky(self.core[tail, tail])).T
        border = self.border[:, :, tail] @ root
        flat = border.reshape(self.vector.size, len(root))
        spread = (inverse_of(self.blocks + prior) @ border).reshape(flat.shape)
        turn = np.linalg.eigh(flat.T @ spread)[1][:, ::-1]
        most, least = turn[:, :rank], turn[:, rank:]
        cross, load = self.core[head, tail] @ root, self.load[tail] @ root
        held = least @ (least.T @ (load - theta.ravel() @ flat - common @ cross))
        across = cross @ most
        return Arrowhead(
            self.blocks,
            np.concatenate([self.border[:, :, head], (flat @ most).reshape(*theta.shape, -1)], axis=2),
            np.block([[self.core[head, head], across], [across.T, np.eye(across.shape[1])]]),
            self.vector - (flat @ held).reshape(theta.shape),
            self.aside,
            np.concatenate([self.load[head] - cross @ held, (load - held) @ most]),
        )

    def holding(self, at: np.ndarray, values: Array) -> "Arrowhead":
        """With c[at] no longer unknown but held at values."""
        left = np.setdiff1d(np.arange(len(self.load)), at)
        return Arrowhead(
            self.blocks,
            self.border[:, :, left],
            self.core[np.ix_(left, left)],
            self.vector - self.border[:, :, at] @ values,
            self.aside,
            self.load[left] - self.core[np.ix_(left, at)] @ values,
        )

    def solve(self, fixed: np.ndarray) -> "Solution":
        """Points `fixed` (n,) have their third unknown, the radius, held at zero.

        Raises DegenerateGeometry where what points and views share is not determined.
        """
        blocks = self.blocks
        if fixed.any():
            blocks = blocks.copy()
            blocks[fixed, 2], blocks[fixed, :, 2] = 0.0, 0.0
            blocks[fixed, 2, 2] = 1.0
        inverse = inverse_of(blocks)
        inverse[fixed, 2, 2] = 0.0
        spread = inverse @ self.border
        flat = self.border.reshape(self.vector.size, len(self.load))
        schur = self.core - flat.T @ spread.reshape(flat.shape)
        try:
            covariance = np.linalg.inv(schur)
        except np.linalg.LinAlgError:
            covariance = np.full_like(schur, np.nan)
        alone = np.einsum("nij,nj->ni", inverse, self.vector)
        common = covariance @ (self.load - flat.T @ alone.ravel())
        theta = alone - spread @ common
        if not all(np.all(np.isfinite(a)) for a in (theta, common, covariance)):
            raise DegenerateGeometry(
                "the views don't determine where cameras and sections lie; accepted: views with a baseline that see sections"
            )
        return Solution(theta, common, inverse, spread, schur, covariance)

    def freed(self, solution: "Solution") -> tuple[Array, Array]:
        """Third unknown (n,) of every point and its variance, from all that speaks of it but that it was held at zero."""
        blocks, two = self.blocks, np.linalg.inv(self.blocks[:, :2, :2])
        axis = np.concatenate(
            [-np.einsum("nij,nj->ni", two, blocks[:, :2, 2]), np.ones((len(two), 1))], axis=1
        )
        own = np.einsum("ni,nij,nj->n", axis, blocks, axis)  # information for known c
        turn = np.einsum("nik,ni->nk", self.border, axis)
        shared = np.sum((turn @ solution.covariance) * turn, axis=1)
        force = self.vector[:, 2] - np.einsum("nj,nj->n", blocks[:, 2], solution.theta)
        left = np.maximum(own - shared, 1e-12 * own)
        return (force - self.border[:, 2] @ solution.common) / left, 1 / left


@dataclass(frozen=True, eq=False)
class Solution:
    """theta (n, 3) and common (m,) = c with covariance (m, m). theta varies like inverse (n, 3, 3) = D^-1 for known c, and
    by -spread (n, 3, m) = -D^-1 H per unit of c; schur (m, m) is the inverse of its covariance."""

    theta: Array
    common: Array
    inverse: Array
    spread: Array
    schur: Array
    covariance: Array

    def eliminated(self, at: int) -> "Solution":
        """Without c[at], the multiplier of a constraint on the points: its part in their variances is kept, but not in
        the covariances between them, where it is as small as 1 / n."""
        left = np.setdiff1d(np.arange(len(self.common)), at)
        pivot, column = self.schur[at, at], self.spread[:, :, at]
        return Solution(
            self.theta,
            self.common[left],
            self.inverse + column[:, :, None] * column[:, None] / pivot,
            self.spread[:, :, left] - column[..., None] * self.schur[at, left] / pivot,
            self.schur[np.ix_(left, left)],
            self.covariance[np.ix_(left, left)],
        )


def inverse_of(blocks: Array) -> Array:
    """Inverses of symmetric blocks (n, 3, 3), by cofactors: several times as fast as LAPACK on each."""
    (a, b, c), (_, d, e), (_, _, f) = np.moveaxis(blocks, 0, 2)
    A, B, C = d * f - e * e, c * e - b * f, b * e - c * d
    D, E, F = a * f - c * c, b * c - a * e, a * d - b * b
    adjugate = np.moveaxis(np.array([[A, B, C], [B, D, E], [C, E, F]]), 2, 0)
    return adjugate / (a * A + b * B + c * C)[:, None, None]
