"""Motion blur: where the camera is while the shutter is open, in steps that the image does not show."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from extremal.estimator.camera import Array, Camera
from extremal.estimator.errors import InvalidInput
from extremal.sim.execution import Execution

MOVES = 0.25  # most that a point of the image moves from one sub-exposure to the next [px]
MOST = 400  # sub-exposures of a frame
SAMPLED = 9  # poses by which the image's motion is measured
DEPTHS = (0.6, 1.0, 3.0)  # of the points that are followed, times the target's


def sub_exposures(
    path: Execution,
    view: int,
    place: Callable[[Array], RigidTransform],
    camera: Camera,
    target: ArrayLike,
) -> RigidTransform:
    """T_world_camera (S) in the middle of S equal parts of the exposure of a view; one where the camera is still.

    Args:
        place: T_world_camera (n) of joint positions (n, 6).
        target: (3,) [m], in view.

    Raises:
        InvalidInput: the image moves by more than 100 px.
    """
    moved = image_motion(place(path.exposure(view, SAMPLED)), camera, target) * SAMPLED / (SAMPLED - 1)
    parts = max(1, int(np.ceil(moved / MOVES)))
    if parts > MOST:
        raise InvalidInput(
            f"the image of view {view} moves by {moved:.0f} px while the shutter is open; accepted: up to "
            f"{MOVES * MOST:.0f} px: move more slowly, settle, or expose for a shorter time than {path.exposure_time:g} s"
        )
    return place(path.exposure(view, parts))


def image_motion(T_world_camera: RigidTransform, camera: Camera, target: ArrayLike) -> float:
    """Length [px] of the longest way of an image point through poses (n): of points all over the image, near and far."""
    middle = T_world_camera[len(T_world_camera) // 2]
    depth = np.linalg.norm(np.asarray(target, float) - middle.translation)
    x, y = np.meshgrid(np.linspace(0, camera.width - 1, 3), np.linspace(0, camera.height - 1, 3))
    rays = camera.rays(np.stack([x.ravel(), y.ravel()], axis=-1))
    points = middle.apply((depth * np.array(DEPTHS)[:, None, None] * rays).reshape(-1, 3))
    inverse = T_world_camera.inv()
    pixels = np.array([camera.project(inverse[i].apply(points)) for i in range(len(T_world_camera))])
    return float(np.max(np.linalg.norm(np.diff(pixels, axis=0), axis=-1).sum(axis=0)))
