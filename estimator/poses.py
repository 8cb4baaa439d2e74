"""What a robot knows of its camera's poses before the images are looked at.

    T_actual,i = T_believed,i exp(e_i),      e_i = root_i z_i + common_i c,      z_i, c ~ N(0, I)

with 6-vectors e_i (translation [m], rotation vector [rad]) in the camera frame. `root_i` is a square root of the
covariance of what is independent in every view; the columns of `common_i` move all views together, each by its own
amount: a wrong hand-eye transform, a biased joint, a scale of the robot. The focal length may be wrong, too, by a
factor 1 + focal_sigma c_f. Whitened like this, exact poses are no special case: their columns are zero.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import RigidTransform

from extremal.estimator.camera import Array, View
from extremal.estimator.errors import InvalidInput

NEGLIGIBLE = 1e-14  # of the largest variance of a unit, below which a direction counts as known


@dataclass(frozen=True, eq=False)
class PosePrior:
    """Believed poses of V views and the standard deviations of their errors.

    Attributes:
        T_world_camera: believed poses (V).
        root: (V, 6, K) square roots of the views' covariances [m], [rad]; K = 0 where all poses are exact.
        common: (V, 6, C) change of every pose per unit of each common error.
        focal_sigma: standard deviation of the focal length, as a fraction of it.
    """

    T_world_camera: RigidTransform
    root: Array
    common: Array = field(default_factory=lambda: np.zeros((0, 6, 0)))
    focal_sigma: float = 0.0

    def __post_init__(self) -> None:
        views = len(self.T_world_camera)
        if self.common.size == 0:
            object.__setattr__(self, "common", np.zeros((views, 6, 0)))
        for name, value in (("root", self.root), ("common", self.common)):
            if value.ndim != 3 or value.shape[:2] != (views, 6) or not np.all(np.isfinite(value)):
                raise InvalidInput(
                    f"{name} is {value.shape}; accepted: finite numbers of shape ({views}, 6, any)"
                )
        if not (np.isfinite(self.focal_sigma) and 0 <= self.focal_sigma < 0.5):
            raise InvalidInput(
                f"focal_sigma is {self.focal_sigma!r}; accepted: a fraction from 0 to below 0.5"
            )

    @staticmethod
    def of(views: Sequence[View], common: Array | None = None, focal_sigma: float = 0.0) -> "PosePrior":
        """The prior that the views' own poses and covariances state.

        Raises InvalidInput where a covariance is not symmetric and positive semi-definite.
        """
        poses = RigidTransform.concatenate([v.T_world_camera for v in views])
        covariance = np.array([v.pose_covariance for v in views])
        return PosePrior(
            poses,
            square_root(covariance),
            np.zeros((len(views), 6, 0)) if common is None else common,
            focal_sigma,
        )

    @property
    def exact(self) -> bool:
        """Whether nothing about the cameras is uncertain."""
        return not (np.any(self.root) or np.any(self.common) or self.focal_sigma)

    @property
    def covariance(self) -> Array:
        """(V, 6, 6) covariance of each view's pose, the common errors included."""
        both = np.concatenate([self.root, self.common], axis=2)
        return both @ np.swapaxes(both, 1, 2)

    @property
    def unknowns(self) -> int:
        """Number of numbers in u = (z (V K), c (C), c_f): what `errors` takes; c_f only where the focal length is uncertain."""
        views, _, own = self.root.shape
        return views * own + self.common.shape[2] + bool(self.focal_sigma)

    def errors(self, u: Array) -> Array:
        """Pose errors (V, 6) of whitened unknowns u."""
        views, _, own = self.root.shape
        z, c = u[: views * own].reshape(views, own), u[views * own :][: self.common.shape[2]]
        return np.einsum("vik,vk->vi", self.root, z) + self.common @ c

    def moved(self, errors: Array) -> RigidTransform:
        """Poses (V) = T_believed exp(errors), errors (V, 6)."""
        return self.T_world_camera * pose_exp(errors)


def square_root(covariance: Array) -> Array:
    """Square roots (V, 6, K) of covariances (V, 6, 6), with as many columns as the largest rank.

    Raises InvalidInput for a covariance that is not finite, symmetric and positive semi-definite.
    """
    if not np.all(np.isfinite(covariance)):
        raise InvalidInput("a pose covariance holds a number that is not finite")
    # translations and rotations differ by orders of magnitude: compare each with its own kind
    scale = np.sqrt(
        np.max(np.diagonal(covariance, axis1=1, axis2=2).reshape(-1, 2, 3), axis=(0, 2), initial=0.0)
    )
    scale = np.repeat(np.where(scale > 0, scale, 1.0), 3)
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    symmetric = np.allclose(covariance, np.swapaxes(covariance, 1, 2), rtol=1e-6, atol=1e-30)
    if not symmetric or np.any(values < -1e-9):
        raise InvalidInput(
            f"a pose covariance is not symmetric and positive semi-definite (smallest eigenvalue, scaled: {values.min():.2g})"
        )
    kept = values > NEGLIGIBLE
    rank = int(kept.sum(axis=1).max(initial=0))
    root = vectors * np.sqrt(np.where(kept, values, 0.0))[:, None] * scale[:, None]
    return root[:, :, ::-1][:, :, :rank]


def pose_root(covariance: Array) -> Array:
    """Square root (6, 6) of one covariance (6, 6), or (6, 0) of an exact pose; errors as of `square_root`."""
    root = square_root(covariance[None])[0]
    return six_columns(root) if root.shape[1] else root


def six_columns(root: Array) -> Array:
    """A root (6, K) with columns of zeros up to the sixth, (6, 6)."""
    return np.pad(root, ((0, 0), (0, 6 - root.shape[1])))


def pose_exp(errors: Array) -> RigidTransform:
    """exp of twists (..., 6) = (translation [m], rotation vector [rad])."""
    return RigidTransform.from_exp_coords(np.concatenate([errors[..., 3:], errors[..., :3]], axis=-1))


def pose_log(poses: RigidTransform) -> Array:
    """Twists (..., 6) = (translation [m], rotation vector [rad]) of poses (...): the inverse of `pose_exp`."""
    coordinates = poses.as_exp_coords()
    return np.concatenate([coordinates[..., 3:], coordinates[..., :3]], axis=-1)
