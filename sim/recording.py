"""Recording: the arm carries its camera along a motion before a scene, and delivers views."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import RigidTransform

from extremal.estimator.camera import Array, Camera, View
from extremal.estimator.errors import InvalidInput
from extremal.estimator.poses import PosePrior
from extremal.sim.frames import render_frames
from extremal.sim.kinematics import ArmKinematics
from extremal.sim.motion import LinearMotion
from extremal.sim.pose_error import PoseErrors
from extremal.sim.quality import Quality, get_quality
from extremal.sim.rendering import NEAR, scene_model
from extremal.sim.sensor import Sensor

if TYPE_CHECKING:  # rendering processes import this package, and would pay for trimesh
    from extremal.scenes import Scene


@dataclass(frozen=True, eq=False)
class Recording:
    """What a motion before a scene delivered.

    Attributes:
        views: frames as the sensor read them, with the poses that the robot believes.
        commanded: T_world_camera (V,) that the motion asked for.
        actual: T_world_camera (V,) from which the frames were taken: FK of the actual joint positions.
        joint_positions: (V, 6) actual joint positions [rad].
        prior: what the robot knows of its poses, errors that all views share included.
        render_seconds: time spent rendering [s].
    """

    views: tuple[View, ...]
    commanded: tuple[RigidTransform, ...]
    actual: tuple[RigidTransform, ...]
    joint_positions: Array
    prior: PosePrior
    render_seconds: float


def record(
    scene: "Scene",
    camera: Camera,
    motion: LinearMotion,
    quality: str | Quality = "standard",
    sensor: Sensor | None = None,
    pose_errors: PoseErrors | None = None,
    rng: np.random.Generator | None = None,
    workers: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Recording:
    """Carry out a motion before a scene and record it. The same generator state gives the same bytes.

    Args:
        rng: draws the camera steps, the pose errors and the noise.
        workers, progress: see `render_frames`.

    Raises:
        InvalidInput: target outside the field of view; camera inside an object; UnreachablePose.
        RenderingError: offscreen rendering is not available.
    """
    quality, sensor = get_quality(quality), sensor or Sensor()
    pose_errors, rng = pose_errors or PoseErrors(), rng or np.random.default_rng()
    motion_rng, pose_rng, noise_rng = rng.spawn(3)

    commanded = motion.poses(scene.target, motion_rng)
    check_poses(scene, camera, commanded)
    arm = ArmKinematics.behind(motion.centre(scene.target))
    joint_positions = arm.joint_positions(commanded)
    actual = arm.camera_poses(joint_positions)
    believed = pose_errors.believed(joint_positions, arm.camera_poses, pose_rng)

    started = time.perf_counter()
    frames = render_frames(scene_model(scene.to_spec()), camera, quality, actual, workers, progress)
    render_seconds = time.perf_counter() - started
    views = tuple(
        View(camera, believed[i], sensor.read(frame, view_rng), pose_errors.view_covariance)
        for i, (frame, view_rng) in enumerate(zip(frames, noise_rng.spawn(len(frames)), strict=True))
    )
    prior = pose_errors.prior(believed, joint_positions, arm.camera_poses)
    return Recording(views, _each(commanded), _each(actual), joint_positions, prior, render_seconds)


def check_poses(scene: "Scene", camera: Camera, T_world_camera: RigidTransform) -> None:
    """InvalidInput where a camera does not see the scene's target or stands inside an object.

    Args:
        T_world_camera: poses (V).
    """
    for i in range(len(T_world_camera)):
        pixel = camera.project(T_world_camera[i].inv().apply(scene.target))
        if not np.all((pixel >= -0.5) & (pixel <= np.array([camera.width, camera.height]) - 0.5)):
            raise InvalidInput(
                f"the target {list(scene.target)} m is outside the field of view of view {i}; accepted: motions and cameras "
                f"that show it (it would stand at pixel {np.round(pixel, 1).tolist()} of {camera.width} x {camera.height})"
            )
    centres = np.atleast_2d(T_world_camera.translation)
    for surface in scene.objects:
        distance = surface.signed_distance(centres)
        if not np.all(distance > NEAR):
            worst = int(np.argmin(distance))
            raise InvalidInput(
                f"view {worst} has its camera at {np.round(centres[worst], 3).tolist()} m, inside {surface.name!r} or nearer "
                f"than {1e3 * NEAR:g} mm; accepted: motions that keep clear of all objects"
            )


def _each(poses: RigidTransform) -> tuple[RigidTransform, ...]:
    return tuple(poses[i] for i in range(len(poses)))
