"""The normal equations of a bundle adjustment with the features' own shape eliminated (Schur complement).

Given the cameras, each feature's parameters theta are a small linear least-squares problem X theta = y. With X = Q C
(Q orthonormal) and J the derivative of the residual by the camera unknowns u, what a feature says of the cameras is
J' (I - Q Q') J. The first term is sparse, one block a view; the second, B'B with B = Q'J, is dense where tracks are long, but
of no more than theta's rank. Features are taken in blocks that stay in the processor's cache.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.linalg import inv, norm

from extremal.estimator.camera import Array
from extremal.estimator.poses import PosePrior
from extremal.estimator.support import Features

BLOCK = 256  # features linearised at once
UNRESOLVED = (
    1e-10  # squared sine between a column of X and those before it, below which theta is not determined
)

einsum = partial(np.einsum, optimize=True)  # products with small matrices, as batched matrix products


@dataclass(frozen=True, eq=False)
class Cameras:
    """The camera unknowns u = (z (V K), c (C), c_f), and what they make of the prior's poses.

    rotations (V, 3, 3), centres (V, 3): camera to world; focal: factor on the focal length.
    """

    prior: PosePrior
    u: Array
    rotations: Array
    centres: Array
    focal: float

    @staticmethod
    def at(prior: PosePrior, u: Array) -> "Cameras":
        poses = prior.moved(prior.errors(u))
        focal = 1.0 + prior.focal_sigma * float(u[-1]) if prior.focal_sigma else 1.0
        return Cameras(prior, u, poses.rotation.as_matrix(), poses.translation, focal)


@dataclass(frozen=True, eq=False)
class Linearised:
    """Features [rows] (n) at given cameras: residuals and their derivatives, in standard deviations.

    residuals (n, L, V): what theta leaves. theta (n, k): best for these cameras; its covariance is
    gram_root gram_root' (n, k, k), gram_root = C^-1 upper triangular. Q (n, L, V, k). by_view (n, L, V, K), by_common (n, L, V, C): J.
    resolved (n,): whether theta is determined. ahead (n,): whether the contact is in front of every camera that sees it.
    """

    rows: np.ndarray
    residuals: Array
    theta: Array
    gram_root: Array
    Q: Array
    by_view: Array
    by_common: Array
    resolved: np.ndarray
    ahead: np.ndarray

    @property
    def B(self) -> Array:
        """Q'J (n, k, unknowns)."""
        own = np.einsum("nlvk,nlvq->nkvq", self.Q, self.by_view).reshape(*self.theta.shape, -1)
        return np.concatenate([own, np.einsum("nlvk,nlvc->nkc", self.Q, self.by_common)], axis=-1)


@dataclass(frozen=True, eq=False)
class Reduced:
    """Sums over features: information (U, U) on the camera unknowns and its gradient (U,), the prior not included."""

    information: Array
    gradient: Array


def linearise(
    features: Features, rows: np.ndarray, cameras: Cameras, theta: Array, robust: Array
) -> Linearised:
    """Residuals and derivatives of the features [rows].

    Args:
        theta: (n, k or more) as known so far: where the planes touch, hence distances and lever arms.
        robust: (n, L, V) factors on the weights, from 0 to 1. Both of all features.
    """
    prior, part = cameras.prior, features.take(rows)
    normals = part.normals * (cameras.focal, cameras.focal, 1.0)
    normals /= norm(normals, axis=-1, keepdims=True)
    world = einsum("nlvk,vjk->nlvj", normals, cameras.rotations)
    local = einsum("nlvk,njk->nlvj", world, part.frame)
    lever = (cameras.centres - part.origin[:, None])[:, None]
    contact = einsum("nlvj,njk->nlvk", part.contact(local, theta[rows, : part.width]), part.frame)
    arm = einsum("nlvk,vkj->nlvj", lever - contact, cameras.rotations)  # from contact point to centre
    distance = norm(arm, axis=-1)
    seen, ahead = np.isfinite(part.sigma), arm[..., 2] < 0
    weights = np.where(seen & ahead, robust[rows] / (np.where(seen, part.sigma, 1.0) * distance), 0.0)
    known = theta[rows, : part.width]
    misses = np.sum(world * lever, axis=-1) - np.einsum("nlvk,nk->nlv", part.columns(local), known)
    # Derivatives are those of the predicted planes, through the centres as well but tangent to what theta describes: with the
    # measured normals they would share the residuals' noise, which pulls cameras and features together.
    normals = normals - (misses / distance**2)[..., None] * arm
    local = einsum("nlvk,vjk,nij->nlvi", normals, cameras.rotations, part.frame)
    Q, gram_root, resolved = _orthonormal(weights[..., None] * part.columns(local), part.order)
    weights *= resolved[:, None, None]  # where theta is open, planes tell nothing of the cameras
    misses *= weights
    projected = np.einsum("nlvk,nlv->nk", Q, misses)
    J = weights[..., None] * np.concatenate([normals, np.cross(normals, arm)], axis=-1)
    by_common = einsum("nlvi,vic->nlvc", J, prior.common)
    if prior.focal_sigma:  # a longer focal length tilts the planes towards the optical axis
        tilt = weights * prior.focal_sigma * np.sum(normals[..., :2] * arm[..., :2], axis=-1)
        by_common = np.concatenate([by_common, tilt[..., None]], axis=-1)
    return Linearised(
        rows,
        misses - np.einsum("nlvk,nk->nlv", Q, projected),
        known + np.einsum("nij,nj->ni", gram_root, projected),
        gram_root,
        Q,
        einsum("nlvi,viq->nlvq", J, prior.root),
        by_common,
        resolved,
        np.all(ahead | ~seen, axis=(1, 2)),
    )


def _orthonormal(X: Array, order: np.ndarray) -> tuple[Array, Array, np.ndarray]:
    """X = Q C (n, L, V, k) by Cholesky factors of the scaled Gram matrices: Q, C^-1 (n, k, k), whether it is determined.

    Columns beyond a feature's order are zero, and so are they in Q.
    """
    n, k = len(X), X.shape[-1]
    flat = X.reshape(n, -1, k)
    gram = np.swapaxes(flat, 1, 2) @ flat
    diagonal = np.diagonal(gram, axis1=1, axis2=2)
    scale = np.where(diagonal > 0, 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0)), 0.0)
    unused = np.arange(k) >= order[:, None]
    # a trace on the diagonal lets the factorisation pass where columns depend on each other
    trace = np.where(scale > 0, 1e-2 * UNRESOLVED, 1.0)
    factor = np.linalg.cholesky(gram * scale[:, :, None] * scale[:, None] + trace[:, :, None] * np.eye(k))
    pivot = np.diagonal(factor, axis1=1, axis2=2) ** 2
    resolved = np.all((pivot > UNRESOLVED) & (scale > 0) | unused, axis=1)
    root = scale[:, :, None] * np.swapaxes(inv(factor), 1, 2) * resolved[:, None, None]
    return X @ root[:, None], root, resolved


def linearise_all(
    features: Features, cameras: Cameras, theta: Array, robust: Array, pool: ThreadPoolExecutor
) -> tuple[list[Linearised], Reduced]:
    """All features of one kind, in blocks of like order, and what they say together of the cameras."""
    ordered = np.argsort(features.order, kind="stable")
    blocks = [ordered[start : start + BLOCK] for start in range(0, len(ordered), BLOCK)]

    def one(rows: np.ndarray) -> tuple[Linearised, Reduced]:
        block = linearise(features, rows, cameras, theta, robust)
        return block, _reduced(block)

    solved = list(pool.map(one, blocks))
    return [block for block, _ in solved], total([r for _, r in solved], len(cameras.u))


def _reduced(block: Linearised) -> Reduced:
    views, own = block.by_view.shape[2:]
    common = block.by_common.shape[-1]
    B = block.B.reshape(block.theta.size, views * own + common)
    information = -(B.T @ B)
    diagonal = einsum("nlvi,nlvj->vij", block.by_view, block.by_view)
    for i in range(views):
        at = slice(i * own, (i + 1) * own)
        information[at, at] += diagonal[i]
    if common:
        border = einsum("nlvi,nlvc->vic", block.by_view, block.by_common).reshape(-1, common)
        information[:-common, -common:] += border
        information[-common:, :-common] += border.T
        information[-common:, -common:] += np.einsum("nlvc,nlvd->cd", block.by_common, block.by_common)
    gradient = np.concatenate(
        [
            np.einsum("nlvi,nlv->vi", block.by_view, block.residuals).ravel(),
            np.einsum("nlvc,nlv->c", block.by_common, block.residuals),
        ]
    )
    return Reduced(information, gradient)


def total(parts: Sequence[Reduced], unknowns: int) -> Reduced:
    """The sum of what several blocks say."""
    return Reduced(
        sum((p.information for p in parts), np.zeros((unknowns, unknowns))),
        sum((p.gradient for p in parts), np.zeros(unknowns)),
    )
