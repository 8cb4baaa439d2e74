"""Common errors of poses that move all cameras as one rigid body: they move the scene along, and no image tells of them.

A wrong mounting or joint moves every camera by its own A_i c. What they have in common is a motion G c of the world,

    T_i exp(A_i c) = exp(G c) T_i exp(A_i' c),     A_i' = A_i - Ad(T_i^-1) G     (to first order in c for A', exact for rigid motions)

G by least squares, so that A_i' is small: millimetres become tenths. An adjustment near the believed poses needs A_i' alone. It
is better without G c: the planes in which shape is described stand still in the world, and cameras that all wander off
by several millimetres cut the object elsewhere than these.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from extremal.estimator.camera import Array, View
from extremal.estimator.estimates import Estimate
from extremal.estimator.poses import PosePrior, pose_exp
from extremal.estimator.projection import adjoint, cross_matrix

LEVER = 1.0  # [m] by which a turn counts as a way, in what is least: about as far as things are


@dataclass(frozen=True, eq=False)
class Gauge:
    """A prior without the rigid motion of all its cameras.

    Attributes:
        still: the prior with A' for A.
        motion: (6, C) world twist (translation [m], rotation vector [rad]) per unit of each common error: G.
    """

    still: PosePrior
    motion: Array

    @staticmethod
    def of(prior: PosePrior) -> "Gauge":
        by_world = adjoint(prior.T_world_camera.inv())
        weight = np.repeat([1.0, LEVER], 3)[:, None]
        rows, count = 6 * len(by_world), prior.common.shape[2]
        columns = (weight * prior.common).reshape(rows, count)
        motion = np.linalg.lstsq((weight * by_world).reshape(rows, 6), columns, rcond=None)[0]
        return Gauge(replace(prior, common=prior.common - by_world @ motion), motion)

    def world(self, u: Array, root: Array) -> tuple[RigidTransform, Array]:
        """exp(G c) and the root (6, U) of the covariance of its twist, from whitened camera unknowns u and the root (U, U) of
        their covariance root' root."""
        first = u.size - bool(self.still.focal_sigma) - self.motion.shape[1]
        chosen = slice(first, first + self.motion.shape[1])
        return pose_exp(self.motion @ u[chosen]), self.motion @ root[:, chosen].T


def moved_views(views: list[View], world: RigidTransform) -> list[View]:
    """Views of a world that was moved."""
    return [replace(view, T_world_camera=world * view.T_world_camera) for view in views]


def moved_estimate(estimate: Estimate, world: RigidTransform, root: Array) -> Estimate:
    """Positions of a world that was moved, which is uncertain by a twist of the covariance root root'."""
    rotation, position = world.rotation.as_matrix(), world.apply(estimate.position)
    known = np.all(np.isfinite(estimate.covariance), axis=(1, 2))
    lever = np.concatenate(
        [np.broadcast_to(np.eye(3), (len(position), 3, 3)), -cross_matrix(position)], axis=2
    )
    spread = lever @ root
    own = np.where(known[:, None, None], estimate.covariance, 0.0)
    covariance = rotation @ own @ rotation.T + spread @ np.swapaxes(spread, 1, 2)
    covariance[~known] = np.inf
    return replace(estimate, position=position, covariance=covariance)
