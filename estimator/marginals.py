"""What an adjustment makes of its features: their parameters, with the cameras' uncertainty in all covariances."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from extremal.estimator.camera import Array
from extremal.estimator.elimination import Linearised
from extremal.estimator.support import FIXED, Features, Sections


@dataclass(frozen=True, eq=False)
class Shapes:
    """What an adjustment makes of n features of one kind.

    Attributes:
        theta: (n, k) parameters (`support`); covariance: (n, k, k), the cameras' uncertainty included.
        radius, sigma_radius: (n,) [m] signed radius of curvature of a section. For one that was held fixed it is what its
            own planes say when all others are held as they are: the estimate that tests whether it is fixed.
        own_variance: (n,) [m^2] of the radius for known cameras; shared: (n, U) what unit errors of the cameras add:
            the radii of free sections i and j have the covariance shared_i . shared_j.
        residuals: (n, L, V) in standard deviations; 0 where not seen.
        valid: (n,) whether the planes determine the feature, in front of all cameras; else sigma and covariance are infinite.
    """

    theta: Array
    covariance: Array
    radius: Array
    sigma_radius: Array
    own_variance: Array
    shared: Array
    residuals: Array
    valid: np.ndarray


def marginals(
    features: Features,
    blocks: Sequence[Linearised],
    theta: Array,
    residuals: Array,
    root: Array,
    weight: Array,
) -> Shapes:
    """Shapes of all features, valid where these are determined and in front of all cameras.

    Args:
        blocks: the features linearised at the solution, sections with a radius even where they are held fixed.
        theta, residuals: of the features as they are held.
        root: (U, U) of the cameras' covariance root' root.
        weight: (n,) with which each feature's planes had part in it.
    """
    n, width = theta.shape
    out = Shapes(
        theta,
        np.full((n, width, width), np.inf),
        np.zeros(n),
        np.full(n, np.inf),
        np.full(n, np.inf),
        np.zeros((n, len(root))),
        residuals,
        np.zeros(n, bool),
    )
    for block in blocks:
        _fill(out, features, block, root, weight[block.rows])
    return out


def _fill(out: Shapes, features: Features, block: Linearised, root: Array, weight: Array) -> None:
    """Marginals of one block. root' root = S^-1. For a section held fixed, S is the cameras' information with its radius
    held at zero; freeing that takes weight b b' from it (b: the row of B of the radius), for which `left` stands."""
    rows, width = block.rows, min(out.theta.shape[1], block.theta.shape[1])
    B = block.B @ root.T
    spread = np.einsum("nij,nju->niu", block.gram_root, B)
    own = block.gram_root @ np.swapaxes(block.gram_root, 1, 2)
    covariance = own + spread @ np.swapaxes(spread, 1, 2)
    if isinstance(features, Sections):
        fixed, turn = features.order[rows] == FIXED, np.sum(B[:, 2] ** 2, axis=1)
        left = np.where(fixed, np.maximum(1 - turn * weight, 1e-12), 1.0)
        out.radius[rows] = block.theta[:, 2] / left
        # of an order above 3, R shares its factor with the terms behind it
        free = covariance[:, 2, 2]
        out.sigma_radius[rows] = np.sqrt(np.where(fixed, own[:, 2, 2] * (1 + turn / left), free))
        out.own_variance[rows], out.shared[rows] = own[:, 2, 2], spread[:, 2]
        # without the column of the radius, the factors of the first two are nested in these
        part = block.gram_root[:, :FIXED, :FIXED]
        moved = np.einsum("nij,nju->niu", part, B[:, :FIXED])
        two = part @ np.swapaxes(part, 1, 2) + moved @ np.swapaxes(moved, 1, 2)
        covariance[fixed] = 0.0
        covariance[fixed, :FIXED, :FIXED] = two[fixed]
    out.covariance[rows] = 0.0
    out.covariance[rows, :width, :width] = covariance[:, :width, :width]
    out.valid[rows] = block.resolved & block.ahead
