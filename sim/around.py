"""Views from all around: the camera goes round an object on a circle, as on a rail, and fixates it.

The arm can't reach behind the object. A turntable would give the same poses relative to the object, with lights that
turn; here the camera moves, and lights and object stay.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from extremal.estimator.camera import Camera, View
from extremal.estimator.errors import InvalidInput
from extremal.sim.frames import render_frames
from extremal.sim.motion import fixating
from extremal.sim.quality import Quality, get_quality
from extremal.sim.recording import check_poses
from extremal.sim.rendering import scene_model
from extremal.sim.sensor import Sensor

if TYPE_CHECKING:  # rendering processes import this package, and would pay for trimesh
    from extremal.scenes import Scene


@dataclass(frozen=True)
class CircularMotion:
    """Camera centres on a horizontal circle, all at the same distance from the target.

    Attributes:
        views: number of views, at least 3.
        distance: from the target [m].
        elevation: of the centres above the target's horizontal plane [rad].
        irregularity: centres are moved by up to this fraction of the regular step, below 0.5.
            Regular steps (0) let pixel-phase errors cancel between views and flatter any result.
    """

    views: int = 36
    distance: float = 0.6
    elevation: float = float(np.radians(12))
    irregularity: float = 0.35

    def __post_init__(self) -> None:
        if not (isinstance(self.views, int | np.integer) and 3 <= self.views <= 10_000):
            raise InvalidInput(f"views is {self.views!r}; accepted: a whole number from 3 to 10000")
        if not (np.isfinite(self.distance) and self.distance > 0):
            raise InvalidInput(f"distance is {self.distance!r}; accepted: a positive number of metres")
        if not (np.isfinite(self.elevation) and abs(self.elevation) < np.radians(80)):
            raise InvalidInput(f"elevation is {self.elevation!r}; accepted: -80 to 80 degrees, in radians")
        if not 0 <= self.irregularity < 0.5:
            raise InvalidInput(f"irregularity is {self.irregularity!r}; accepted: from 0 to below 0.5")

    def poses(self, target: ArrayLike, rng: np.random.Generator) -> RigidTransform:
        """T_world_camera (views) in order around the target (3,), each fixating it."""
        step = 2 * np.pi / self.views
        azimuth = step * (np.arange(self.views) + self.irregularity * rng.uniform(-1, 1, self.views))
        level, height = np.cos(self.elevation), np.full(self.views, np.sin(self.elevation))
        directions = np.stack([-level * np.cos(azimuth), -level * np.sin(azimuth), height], axis=1)
        return fixating(np.asarray(target, float) + self.distance * directions, target)


def record_around(
    scene: "Scene",
    camera: Camera,
    motion: CircularMotion,
    quality: str | Quality,
    sensor: Sensor,
    rng: np.random.Generator,
    workers: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[View, ...]:
    """Views of a scene from all around its target, with exact poses. The same generator state gives the same bytes.

    Args:
        rng: draws the steps, drift and noise.
        workers, progress: see `render_frames`.

    Raises:
        InvalidInput: target outside the field of view; camera inside an object.
        RenderingError: offscreen rendering is not available.
    """
    motion_rng, drift_rng, noise_rng = rng.spawn(3)
    poses = motion.poses(scene.target, motion_rng)
    check_poses(scene, camera, poses)
    gains = sensor.gains(motion.views, drift_rng)
    frames = render_frames(
        scene_model(scene.to_spec()), camera, get_quality(quality), poses, workers, progress, gains
    )
    read = [sensor.read(f, camera, r) for f, r in zip(frames, noise_rng.spawn(len(frames)), strict=True)]
    return tuple(View(camera, poses[i], image) for i, image in enumerate(read))
