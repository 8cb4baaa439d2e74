"""A deliberate linear motion: the camera moves along a line and fixates the target."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform, Rotation

from extremal.estimator.camera import Array
from extremal.estimator.errors import InvalidInput


class Motion(Protocol):
    """What one can ask an arm for: camera poses around a target."""

    def centre(self, target: ArrayLike) -> Array:
        """Middle (3,) [m] of the camera's centres for a target (3,); the arm is placed behind it."""
        ...

    def poses(self, target: ArrayLike, rng: np.random.Generator) -> RigidTransform:
        """T_world_camera (V), in the order in which they are taken."""
        ...


@dataclass(frozen=True)
class LinearMotion:
    """Camera centres on a segment along world y, centred at target + distance (-cos e, 0, sin e).

    Attributes:
        views: number of views, at least 3; the first and the last are the segment's ends.
        baseline: length of the segment [m].
        distance: from its centre to the target [m].
        elevation: e, the angle of the segment's centre above the target's horizontal plane [rad].
        irregularity: interior centres are moved by up to this fraction of the regular step, below 0.5.
            Regular steps (0) let pixel-phase errors cancel between views and flatter any result.
    """

    views: int = 15
    baseline: float = 0.4
    distance: float = 0.6
    elevation: float = float(np.radians(12))
    irregularity: float = 0.35

    def __post_init__(self) -> None:
        if not (isinstance(self.views, int | np.integer) and 3 <= self.views <= 10_000):
            raise InvalidInput(
                f"views is {self.views!r}; accepted: a whole number from 3 to 10000 (fewer than three don't determine curvature)"
            )
        for name, value in (("baseline", self.baseline), ("distance", self.distance)):
            if not (np.isfinite(value) and value > 0):
                raise InvalidInput(f"{name} is {value!r}; accepted: a positive number of metres")
        if not (np.isfinite(self.elevation) and abs(self.elevation) < np.radians(80)):
            raise InvalidInput(f"elevation is {self.elevation!r}; accepted: -80 to 80 degrees, in radians")
        if not 0 <= self.irregularity < 0.5:
            raise InvalidInput(f"irregularity is {self.irregularity!r}; accepted: from 0 to below 0.5")

    def centre(self, target: ArrayLike) -> Array:
        """Middle (3,) [m] of the segment for a target (3,)."""
        e = self.elevation
        return np.asarray(target, float) + self.distance * np.array([-np.cos(e), 0.0, np.sin(e)])

    def poses(self, target: ArrayLike, rng: np.random.Generator) -> RigidTransform:
        """T_world_camera (views), each fixating the target (3,)."""
        step = self.baseline / (self.views - 1)
        y = np.linspace(-self.baseline / 2, self.baseline / 2, self.views)
        y[1:-1] += step * self.irregularity * rng.uniform(-1, 1, self.views - 2)
        centres = self.centre(target) + y[:, None] * np.array([0.0, 1.0, 0.0])
        return fixating(centres, target)


def fixating(centres: ArrayLike, target: ArrayLike) -> RigidTransform:
    """T_world_camera (V) of cameras at centres (V, 3) that look at a target (3,), their x axis horizontal.

    Raises:
        InvalidInput: a number is not finite, a centre is the target, or lies straight above or below it.
    """
    centres, target = np.asarray(centres, float), np.asarray(target, float)
    forward = target - centres
    right = np.cross(forward, [0.0, 0.0, 1.0])
    horizontal = np.linalg.norm(right, axis=1, keepdims=True)
    if not np.all((horizontal > 1e-6) & (horizontal < np.inf)):
        raise InvalidInput(
            f"cameras at {centres.tolist()} can't look at {target.tolist()} upright; accepted: finite centres beside the target"
        )
    forward = forward / np.linalg.norm(forward, axis=1, keepdims=True)
    right = right / horizontal
    axes = np.stack([right, np.cross(forward, right), forward], axis=-1)
    return RigidTransform.from_components(centres, Rotation.from_matrix(axes))
