"""The motion of `extremal strip`: a linear one, and two views that the strip is not made of."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from extremal.estimator.camera import Array
from extremal.sim.motion import LinearMotion, fixating

UNSEEN = ("within the arc", "beyond its end")  # the views that follow those of the motion
BEYOND = 0.1  # of the baseline, past its end
AWAY = 0.3  # of the baseline: the view within lies between the two views there, away from the reference


@dataclass(frozen=True)
class WithUnseen:
    """A linear motion, then a view between two of its views and one beyond its end, on the same line.

    Attributes:
        motion: whose views come first.
    """

    motion: LinearMotion

    def centre(self, target: ArrayLike) -> Array:
        """Middle (3,) [m] of the camera's centres for a target (3,)."""
        return self.motion.centre(target)

    def poses(self, target: ArrayLike, rng: np.random.Generator) -> RigidTransform:
        """T_world_camera (V + 2), each fixating the target (3,)."""
        centres = self.motion.poses(target, rng).translation
        first, last = centres[0], centres[-1]
        along = np.linalg.norm(centres - first, axis=1)
        k = int(np.searchsorted(along, (0.5 + AWAY) * along[-1]))
        within, beyond = 0.5 * (centres[k - 1] + centres[k]), last + BEYOND * (last - first)
        return fixating(np.concatenate([centres, [within, beyond]]), target)
