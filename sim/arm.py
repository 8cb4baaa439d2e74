"""A six-joint arm with the UR5e's published kinematics, a camera in its hand and a suction cup at its flange."""

import mujoco
import numpy as np
from scipy.spatial.transform import RigidTransform

from extremal.sim.axes import swap_camera_axes

# Standard Denavit-Hartenberg parameters (Universal Robots, "DH parameters for calculations", UR5e):
# T_i = Rz(q_i) Tz(d_i) Tx(a_i) Rx(alpha_i), metres and radians.
DH_A = (0.0, -0.425, -0.3922, 0.0, 0.0, 0.0)
DH_D = (0.1625, 0.0, 0.0, 0.1333, 0.0997, 0.0996)
DH_ALPHA = (np.pi / 2, 0.0, 0.0, np.pi / 2, -np.pi / 2, 0.0)
# Joint limits of the data sheet: +-360 degrees, the elbow +-180.
JOINT_LIMITS = np.array([[-2, 2], [-2, 2], [-1, 1], [-2, 2], [-2, 2], [-2, 2]]) * np.pi

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
CAMERA = "hand_camera"
CUP_TIP = "cup_tip"
ARM_GROUP = 4  # geom group of everything that belongs to the arm

# The optical centre sits 75 mm beside the cup's axis and 40 mm behind its lip, looking along the flange's z: the lip
# is 56 degrees off the optical axis, and the rest of the arm is behind the camera. A frame of up to 50 degrees
# from axis to corner (the default camera: 27) never shows the arm.
T_FLANGE_CAMERA = RigidTransform.from_translation([0.0, -0.075, 0.06])
CUP_LENGTH = 0.10
CUP_LIP_RADIUS = 0.015

_LINK_RADII = (0.06, 0.054, 0.045, 0.04, 0.04, 0.036)
_GREY = (0.75, 0.77, 0.8, 1.0)
_DARK = (0.15, 0.15, 0.17, 1.0)


def add_arm(spec: mujoco.MjSpec, T_world_base: RigidTransform) -> None:
    """Add the arm to a model: bodies, joints, `CAMERA` and the site `CUP_TIP` (z along the suction direction).

    The joint angles of the model are the angles q_i of the Denavit-Hartenberg formula.

    Args:
        spec: the model to add to; its existing names must not clash with the arm's.
        T_world_base: pose of the arm's base frame.
    """
    limits_in_unit = np.degrees(JOINT_LIMITS) if spec.compiler.degree else JOINT_LIMITS
    body = spec.worldbody.add_body(
        name="arm_base",
        pos=T_world_base.translation,
        quat=T_world_base.rotation.as_quat(scalar_first=True),
    )
    _add_geom(body, mujoco.mjtGeom.mjGEOM_CYLINDER, 0.075, (0, 0, -0.02), (0, 0, 0.02), _DARK)
    position, tilt = np.zeros(3), 0.0
    for name, limits, radius, a, d, alpha in zip(
        JOINTS, limits_in_unit, _LINK_RADII, DH_A, DH_D, DH_ALPHA, strict=True
    ):
        body = body.add_body(name=name, pos=position, quat=[np.cos(tilt / 2), np.sin(tilt / 2), 0, 0])
        body.add_joint(
            name=name,
            type=mujoco.mjtJoint.mjJNT_HINGE,
            axis=[0, 0, 1],
            range=limits,
            limited=mujoco.mjtLimited.mjLIMITED_TRUE,
        )
        position, tilt = np.array([a, 0.0, d]), alpha
        _add_geom(body, mujoco.mjtGeom.mjGEOM_CAPSULE, radius, (0, 0, 0), (0, 0, d), _DARK)
        _add_geom(body, mujoco.mjtGeom.mjGEOM_CAPSULE, radius, (0, 0, d), (a, 0, d), _GREY)
    _add_hand(body.add_body(name="flange", pos=position, quat=[np.cos(tilt / 2), np.sin(tilt / 2), 0, 0]))


def _add_hand(flange: mujoco.MjsBody) -> None:
    """Camera and suction cup in the flange frame."""
    cylinder = mujoco.mjtGeom.mjGEOM_CYLINDER
    T_flange_eye = swap_camera_axes(T_FLANGE_CAMERA)
    centre = T_flange_eye.translation
    flange.add_camera(name=CAMERA, pos=centre, quat=T_flange_eye.rotation.as_quat(scalar_first=True))
    _add_geom(flange, cylinder, 0.02, centre - (0, 0, 0.05), centre - (0, 0, 0.002), _DARK)
    _add_geom(flange, cylinder, 0.011, (0, 0, 0), (0, 0, CUP_LENGTH - 0.015), _GREY)
    _add_geom(flange, cylinder, CUP_LIP_RADIUS, (0, 0, CUP_LENGTH - 0.015), (0, 0, CUP_LENGTH), _DARK)
    flange.add_site(name=CUP_TIP, pos=[0, 0, CUP_LENGTH], group=ARM_GROUP)


def _add_geom(
    body: mujoco.MjsBody,
    kind: mujoco.mjtGeom,
    radius: float,
    start: tuple[float, ...] | np.ndarray,
    end: tuple[float, ...] | np.ndarray,
    rgba: tuple[float, float, float, float],
) -> None:
    """A capsule or cylinder between two points; none where they coincide."""
    start, end = np.asarray(start, float), np.asarray(end, float)
    if np.linalg.norm(end - start) < 1e-6:
        return
    body.add_geom(
        type=kind,
        size=[radius, 0, 0],
        fromto=np.concatenate([start, end]),
        rgba=rgba,
        group=ARM_GROUP,
        contype=0,
        conaffinity=0,
    )
