"""A deliberate motion to calibrate by: the camera looks at a board from many sides, near and far, turned about its axis."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.stats import qmc

from extremal.estimator.camera import Array
from extremal.estimator.errors import InvalidInput
from extremal.sim.motion import fixating


@dataclass(frozen=True)
class BoardMotion:
    """Views spread evenly (a Halton sequence with a random shift) over directions, rolls, distances and fixated points.

    Hand-eye calibration needs rotations about several axes (Tsai and Lenz 1989), the focal length boards that are
    slanted, distortion corners near the image's border.

    Attributes:
        views: number of views, at least 3.
        distance: mean distance to the target [m]; views vary by `depth` of it to both sides.
        elevation: of the mean direction above the target's horizontal plane [rad].
        spread: largest azimuth and elevation from the mean direction [rad].
        roll: largest turn about the optical axis [rad].
        depth: as a fraction of the distance.
        aside: largest distance of the fixated point from the target, along y and z, as a fraction of the distance.
    """

    views: int = 30
    distance: float = 0.45
    elevation: float = 0.2
    spread: float = float(np.radians(35))
    roll: float = float(np.radians(60))
    depth: float = 0.2
    aside: float = 0.1

    def __post_init__(self) -> None:
        if not (isinstance(self.views, int | np.integer) and 3 <= self.views <= 1000):
            raise InvalidInput(f"views is {self.views!r}; accepted: a whole number from 3 to 1000")
        if not (np.isfinite(self.distance) and self.distance > 0):
            raise InvalidInput(f"distance is {self.distance!r}; accepted: a positive number of metres")
        if not (np.isfinite(self.elevation) and abs(self.elevation) + self.spread < np.radians(80)):
            raise InvalidInput(
                f"elevation {self.elevation!r} and spread {self.spread!r} leave +-80 degrees; accepted: less, in radians"
            )
        for name, value, most in (
            ("spread", self.spread, np.radians(80)),
            ("roll", self.roll, np.pi),
            ("depth", self.depth, 0.5),
            ("aside", self.aside, 0.5),
        ):
            if not 0 <= value <= most:
                raise InvalidInput(f"{name} is {value!r}; accepted: from 0 to {most:.3g}")

    def centre(self, target: ArrayLike) -> Array:
        """Mean camera centre (3,) [m] for a target (3,)."""
        return (
            np.asarray(target, float) + self.distance * _direction(np.zeros(1), np.full(1, self.elevation))[0]
        )

    def poses(self, target: ArrayLike, rng: np.random.Generator) -> RigidTransform:
        """T_world_camera (views)."""
        target = np.asarray(target, float)
        azimuth, elevation, roll, depth, *aside = qmc.Halton(6, rng=rng).random(self.views).T * 2 - 1
        direction = _direction(self.spread * azimuth, self.elevation + self.spread * elevation)
        centres = target + self.distance * (1 + self.depth * depth)[:, None] * direction
        fixated = target + self.aside * self.distance * np.stack([np.zeros(self.views), *aside], axis=1)
        looking = RigidTransform.concatenate(
            [fixating(c[None], f)[0] for c, f in zip(centres, fixated, strict=True)]
        )
        return looking * RigidTransform.from_rotation(
            Rotation.from_rotvec(self.roll * roll[:, None] * [0, 0, 1])
        )


def _direction(azimuth: Array, elevation: Array) -> Array:
    """Unit vectors (V, 3) from the target; along -x where both angles [rad] are zero."""
    level = np.cos(elevation)
    return np.stack([-level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)], axis=1)
