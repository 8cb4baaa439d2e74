"""The one conversion between MuJoCo's camera axes (x right, y up, z backward) and OpenCV's."""

# mujoco's compiled classes come without type stubs.
# pyright: reportAttributeAccessIssue=false

import mujoco
import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from extremal.estimator.camera import Array

_MUJOCO_AXES = np.array([1.0, -1.0, -1.0])  # along OpenCV's of the same name
_HALF_TURN_ABOUT_X = RigidTransform.from_rotation(Rotation.from_matrix(np.diag(_MUJOCO_AXES)))


def swap_camera_axes(T_world_camera: RigidTransform) -> RigidTransform:
    """The same camera with OpenCV's axes if it had MuJoCo's, with MuJoCo's if it had OpenCV's."""
    return T_world_camera * _HALF_TURN_ABOUT_X


def place_eye(model: mujoco.MjModel, data: mujoco.MjData, T_world_camera: Array) -> None:
    """Put the model's only mocap body, with its camera, where a camera with OpenCV's axes is, at a pose (4, 4)."""
    data.mocap_pos[0] = T_world_camera[:3, 3]
    # transforms of scipy would take a fifth of a small image's time
    mujoco.mju_mat2Quat(data.mocap_quat[0], (T_world_camera[:3, :3] * _MUJOCO_AXES).ravel())
    mujoco.mj_kinematics(model, data)
    mujoco.mj_camlight(model, data)
