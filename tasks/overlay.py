"""Pictures for people: the hand's view with labelled features, beside the scene from outside."""

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from extremal.estimator.camera import Array, Camera
from extremal.tasks.eye import Eye
from extremal.tasks.features import Features

COLOURS = {
    "extremal": (31, 119, 180),
    "fixed": (255, 127, 14),
    "path": (44, 160, 44),
    "goal": (214, 39, 40),
    "camera": (148, 103, 189),
}


def picture(
    eye: Eye,
    camera: Camera,
    actual: RigidTransform,
    features: Features,
    onlooker: RigidTransform,
    marks: list[tuple[Array, str]],
) -> NDArray[np.uint8]:
    """Both views side by side (height, 2 width, 3).

    Args:
        camera: in whose pixels the features are.
        onlooker: T_world_camera of the view from outside.
        marks: points (n, 3) that are drawn there, and the names of their colours.
    """
    return np.hstack([_hand_view(eye, camera, actual, features), _outside(eye, onlooker, marks)])


def _hand_view(eye: Eye, camera: Camera, actual: RigidTransform, features: Features) -> NDArray[np.uint8]:
    image = eye.image(actual).copy()
    scale = eye.camera.width / camera.width
    for i in np.flatnonzero(features.visible):
        colour = COLOURS["extremal" if features.extremal[i] else "fixed"]
        x, y = np.rint(features.pixels[i] * scale).astype(int)
        cv2.circle(image, (int(x), int(y)), 3, colour, -1, cv2.LINE_AA)
    known = features.visible & features.extremal & np.isfinite(features.best_sigma)
    lines = [f"{len(features)} features, {int(features.visible.sum())} in view"]
    if known.any():
        best = np.flatnonzero(known)[np.argmin(features.best_sigma[known])]
        lines.append(f"R {1e3 * features.best_radius[best]:.1f} +- {1e3 * features.best_sigma[best]:.1f} mm")
    for k, text in enumerate(lines):
        cv2.putText(
            image, text, (8, 20 + 20 * k), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (20, 20, 20), 1, cv2.LINE_AA
        )
    return image


def _outside(eye: Eye, onlooker: RigidTransform, marks: list[tuple[Array, str]]) -> NDArray[np.uint8]:
    image = eye.image(onlooker).copy()
    for points, name in marks:
        there = onlooker.inv().apply(np.atleast_2d(points))
        ahead = there[:, 2] > 0.01
        for x, y in np.rint(eye.camera.project(there[ahead])).astype(int):
            cv2.circle(image, (int(x), int(y)), 2 if len(points) > 1 else 5, COLOURS[name], -1, cv2.LINE_AA)
    return image
