"""The one conversion between MuJoCo's camera axes (x right, y up, z backward) and OpenCV's."""

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

MUJOCO_AXES = np.array([1.0, -1.0, -1.0])  # along OpenCV's of the same name
_HALF_TURN_ABOUT_X = RigidTransform.from_rotation(Rotation.from_matrix(np.diag(MUJOCO_AXES)))


def swap_camera_axes(T_world_camera: RigidTransform) -> RigidTransform:
    """The same camera with OpenCV's axes if it had MuJoCo's, with MuJoCo's if it had OpenCV's."""
    return T_world_camera * _HALF_TURN_ABOUT_X
