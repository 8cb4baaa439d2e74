"""Recording: the arm carries its camera along a motion before a scene, and delivers views."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from extremal.estimator.camera import Array, Camera, View
from extremal.estimator.errors import InvalidInput
from extremal.estimator.poses import PosePrior, pose_exp
from extremal.sim.arm_errors import ArmErrors
from extremal.sim.chain import NOMINAL, ArmGeometry
from extremal.sim.execution import Drive, execute
from extremal.sim.exposure import sub_exposures
from extremal.sim.frames import render_frames
from extremal.sim.kinematics import ArmKinematics
from extremal.sim.motion import Motion
from extremal.sim.quality import Quality, get_quality
from extremal.sim.rendering import NEAR, scene_model
from extremal.sim.sensor import Sensor

if TYPE_CHECKING:  # rendering processes import this package, and would pay for trimesh
    from extremal.scenes import Scene


@dataclass(frozen=True, eq=False)
class Recording:
    """What a motion before a scene delivered.

    Attributes:
        views: frames as the sensor read them, with the camera and the poses that the robot believes; their covariances are
            of what is independent in every view.
        commanded: T_world_camera (V,) that the motion asked for.
        actual: T_world_camera (V,) where the camera was at mid exposure.
        readings: (V, 6) of the joints' encoders [rad].
        prior: what the robot knows of its poses, errors that all views share included.
        camera: the actual one.
        T_world_base: where the arm stands.
        render_seconds: time spent rendering [s].
    """

    views: tuple[View, ...]
    commanded: tuple[RigidTransform, ...]
    actual: tuple[RigidTransform, ...]
    readings: Array
    prior: PosePrior
    camera: Camera
    T_world_base: RigidTransform
    render_seconds: float


def record(
    scene: "Scene",
    camera: Camera,
    motion: Motion,
    quality: str | Quality = "standard",
    sensor: Sensor | None = None,
    errors: ArmErrors | None = None,
    rng: np.random.Generator | None = None,
    workers: int | None = None,
    progress: Callable[[int, int], None] | None = None,
    *,
    geometry: ArmGeometry | None = None,
    believed: ArmGeometry = NOMINAL,
    believed_camera: Camera | None = None,
    drive: Drive | None = None,
) -> Recording:
    """Carry out a motion before a scene and record it. The same generator state gives the same bytes.

    The motion commands poses; what is believed of the arm turns them into joint positions; the actual arm goes there and
    the camera is somewhere else; encoder readings and what is believed of the arm tell where it seems to be.

    Args:
        camera: the actual one, by which frames are rendered.
        errors: of the arm; None: none.
        rng: draws the camera steps, the arm where `geometry` does not give it, what is new in every view, drift and noise.
        workers, progress: see `render_frames`.
        geometry: the actual arm; None: one drawn from `errors` around the believed one.
        believed: what the robot takes its arm to be.
        believed_camera: what it takes its camera to be; None: what it is.
        drive: moves the arm under physics, with motion blur where it moves during `sensor.exposure_time`; None: joints
            go exactly where they are commanded to, and rest.

    Raises:
        InvalidInput: target outside the field of view; camera inside an object; UnreachablePose.
        ArmNotSettled: the arm does not come to rest.
        RenderingError: offscreen rendering is not available.
    """
    quality, sensor, errors = get_quality(quality), sensor or Sensor(), errors or ArmErrors()
    motion_rng, view_rng, noise_rng, drift_rng, arm_rng = (rng or np.random.default_rng()).spawn(5)
    geometry = geometry or errors.draw(arm_rng, believed)

    commanded = motion.poses(scene.target, motion_rng)
    check_poses(scene, camera, commanded)
    arm = ArmKinematics.behind(motion.centre(scene.target), believed)
    joints, path = arm.joint_positions(commanded), None
    if drive:
        path = execute(joints, geometry, arm.T_world_base, drive, sensor.exposure_time)
        joints = path.joint_positions
    encoder_noise, pose_errors = errors.scatter(len(joints), view_rng)

    def place(joints: Array, view: int | slice = slice(None)) -> RigidTransform:
        return arm.T_world_base * geometry.camera_poses(joints) * pose_exp(pose_errors[view])

    actual = exposed = place(joints)
    if path:
        exposed = [
            sub_exposures(path, i, partial(place, view=i), camera, scene.target) for i in range(len(joints))
        ]
    started = time.perf_counter()
    gains = sensor.gains(len(joints), drift_rng)
    frames = render_frames(scene_model(scene.to_spec()), camera, quality, exposed, workers, progress, gains)
    render_seconds = time.perf_counter() - started

    readings = joints + encoder_noise
    prior = errors.prior(believed, readings, arm.T_world_base)
    images = [sensor.read(f, camera, r) for f, r in zip(frames, noise_rng.spawn(len(frames)), strict=True)]
    views = _views(believed_camera or camera, prior, images)
    return Recording(
        views, _each(commanded), _each(actual), readings, prior, camera, arm.T_world_base, render_seconds
    )


def _views(camera: Camera, prior: PosePrior, images: list[NDArray[np.uint8]]) -> tuple[View, ...]:
    """Images as seen from believed poses, with the covariances of what is independent in every view."""
    covariance = prior.root @ np.swapaxes(prior.root, 1, 2)
    return tuple(
        View(camera, prior.T_world_camera[i], image, covariance[i]) for i, image in enumerate(images)
    )


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
