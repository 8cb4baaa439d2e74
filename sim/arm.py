"""A six-joint arm with the UR5e's published kinematics, a camera in its hand and a suction cup at its flange."""

import mujoco
import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from extremal.sim.axes import swap_camera_axes
from extremal.sim.chain import DH_A, DH_ALPHA, DH_D, NOMINAL, ArmGeometry

# Joint limits of the data sheet: +-360 degrees, the elbow +-180.
JOINT_LIMITS = np.array([[-2, 2], [-2, 2], [-1, 1], [-2, 2], [-2, 2], [-2, 2]]) * np.pi

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
CAMERA = "hand_camera"
CUP_TIP = "cup_tip"
ARM_GROUP = 4  # geom group of everything that belongs to the arm

CUP_LENGTH = 0.10
CUP_LIP_RADIUS = 0.015

# Mass [kg], centre of mass [m] and moments of inertia about it [kg m^2] of each link, in the frame at its far end: Universal
# Robots' table beside the Denavit-Hartenberg parameters, without its products of inertia.
_LINK_MASSES = (3.761, 8.058, 2.846, 1.37, 1.3, 0.365)
_LINK_CENTRES = (
    (0.0, -0.02561, 0.00193),
    (0.2125, 0.0, 0.11336),
    (0.15, 0.0, 0.0265),
    (0.0, -0.0018, 0.01634),
    (0.0, 0.0018, 0.01634),
    (0.0, 0.0, -0.001159),
)
_LINK_INERTIAS = (
    (0.0070, 0.0065, 0.0066),
    (0.0151, 0.3339, 0.3325),
    (0.0040, 0.0788, 0.0785),
    (0.00165, 0.00136, 0.00126),
    (0.00136, 0.00128, 0.00097),
    (0.00019, 0.00019, 0.00026),
)
_LINK_RADII = (0.06, 0.054, 0.045, 0.04, 0.04, 0.036)
_GREY = (0.75, 0.77, 0.8, 1.0)
_DARK = (0.15, 0.15, 0.17, 1.0)


def add_arm(spec: mujoco.MjSpec, T_world_base: RigidTransform, geometry: ArmGeometry = NOMINAL) -> None:
    """Add the arm to a model: bodies, joints, `CAMERA` and the site `CUP_TIP` (z along the suction direction).

    The joint angles of the model are the encoder readings of `ArmGeometry`, on a nominal arm the angles q_i of the
    Denavit-Hartenberg formula.

    Args:
        spec: the model to add to; its existing names must not clash with the arm's.
        T_world_base: pose of the arm's base frame.
        geometry: the individual arm.
    """
    limits_in_unit = np.degrees(JOINT_LIMITS) if spec.compiler.degree else JOINT_LIMITS
    body = _add_body(spec.worldbody, "arm_base", T_world_base)
    _add_geom(body, mujoco.mjtGeom.mjGEOM_CYLINDER, 0.075, (0, 0, -0.02), (0, 0, 0.02), _DARK)
    T_body_next = RigidTransform.identity()
    for i, (name, limits, radius) in enumerate(zip(JOINTS, limits_in_unit, _LINK_RADII, strict=True)):
        body = _add_body(body, name, T_body_next * _turn("z", geometry.joint_offset[i]))
        body.add_joint(
            name=name,
            type=mujoco.mjtJoint.mjJNT_HINGE,
            axis=[0, 0, 1],
            range=limits,
            limited=mujoco.mjtLimited.mjLIMITED_TRUE,
        )
        a, d = DH_A[i] + geometry.link_a[i], DH_D[i] + geometry.link_d[i]
        T_body_next = RigidTransform.from_translation([a, 0, d]) * _turn("x", DH_ALPHA[i])
        _set_inertia(body, i, T_body_next)
        _add_geom(body, mujoco.mjtGeom.mjGEOM_CAPSULE, radius, (0, 0, 0), (0, 0, d), _DARK)
        _add_geom(body, mujoco.mjtGeom.mjGEOM_CAPSULE, radius, (0, 0, d), (a, 0, d), _GREY)
    _add_hand(_add_body(body, "flange", T_body_next), geometry.T_flange_camera)


def _turn(axis: str, angle: float) -> RigidTransform:
    return RigidTransform.from_rotation(Rotation.from_euler(axis, angle))


def _add_body(parent: mujoco.MjsBody, name: str, pose: RigidTransform) -> mujoco.MjsBody:
    return parent.add_body(name=name, pos=pose.translation, quat=pose.rotation.as_quat(scalar_first=True))


def _set_inertia(body: mujoco.MjsBody, link: int, T_body_end: RigidTransform) -> None:
    body.explicitinertial = True
    body.mass = _LINK_MASSES[link]
    body.inertia = _LINK_INERTIAS[link]
    body.ipos = T_body_end.apply(_LINK_CENTRES[link])
    body.iquat = T_body_end.rotation.as_quat(scalar_first=True)


def _add_hand(flange: mujoco.MjsBody, T_flange_camera: RigidTransform) -> None:
    """Camera and suction cup in the flange frame."""
    cylinder = mujoco.mjtGeom.mjGEOM_CYLINDER
    T_flange_eye = swap_camera_axes(T_flange_camera)
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
