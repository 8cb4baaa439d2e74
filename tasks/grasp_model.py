"""The MuJoCo model of a grasp: the arm, the object that stands on the table, what is in the way, the weld of the seal."""

# mujoco's compiled classes come without type stubs.
# pyright: reportAttributeAccessIssue=false

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from extremal.estimator.errors import SceneError
from extremal.scenes import Box, Lathe, Surface
from extremal.scenes.convex import add_collision
from extremal.scenes.inertia import shell_inertia, wall_points
from extremal.scenes.mjcf import Spec
from extremal.sim import ArmGeometry
from extremal.sim.arm import JOINTS, add_arm
from extremal.sim.execution import add_actuators
from extremal.tasks.grasp_motion import STEP

TARGET, TABLE, OBSTACLES, SEAL = "grasp_target", "grasp_table", "grasp_obstacles", "grasp_seal"
FLANGE = "flange"

# Who meets whom: a geom's kind, and the kinds that it meets.
THINGS, HAND, LIP, SHOULDER = 1, 2, 4, 8
# The hand and the forearm meet everything but themselves; what carries them stands beside the table, maybe lower than
# its top, and meets only things; the soft lip gives way to the object that it is pressed against.
KINDS = {"shoulder_pan": SHOULDER, "shoulder_lift": SHOULDER}
MEETS = {
    TABLE: THINGS | HAND | LIP,
    OBSTACLES: THINGS | HAND | LIP | SHOULDER,
    TARGET: THINGS | HAND | SHOULDER,
}

# The lip's compliance: what weighs 0.3 kg swings in as on a critically damped spring of 750 N/m. At rest a
# target hangs lower by 0.02 mm at the lip and 0.1 mm at its middle (0.4 kg, R = 80 mm).
WELD_SOLREF, WELD_SOLIMP = (0.02, 1.0), (0.99, 0.999, 0.001, 0.5, 2.0)
PEG_RADIUS, PEG_PLACE = 0.003, 0.6  # [m], and how far out under the target, in its half widths


def grasp_model(
    target: Surface,
    obstacles: Sequence[Surface],
    T_world_base: RigidTransform,
    actual: ArmGeometry,
    area_density: float,
    friction: float,
) -> mujoco.MjModel:
    """Compile the model. The joints' six positions come first, then the target's pose.

    The table is the world's plane z = 0, on which the target stands free: a lathe or a box on its base, whatever may roll on
    three pegs under it. Obstacles are fixed, as a touch is a failure already.

    Args:
        target: what is to be grasped; a hollow object with a thin wall.
        obstacles: all else that stands there.
        actual: the arm as it is.
        area_density: of the target's wall [kg/m^2].
        friction: sliding friction between all that touches.

    Raises:
        SceneError: an object has no collision shape, or two have the same name.
    """
    _check_names([surface.name for surface in (target, *obstacles)])
    spec = _arm_alone(T_world_base, actual)
    sliding = [friction, 0.005, 0.0001]
    fixed = {"contype": THINGS, "conaffinity": MEETS[OBSTACLES], "friction": sliding}
    table, plane = {**fixed, "conaffinity": MEETS[TABLE]}, mujoco.mjtGeom.mjGEOM_PLANE
    spec.worldbody.add_geom(name=TABLE, type=plane, size=[2, 2, 0.1], **table)
    for i, surface in enumerate(obstacles):
        add_collision(spec, _add_body(spec, f"{OBSTACLES}/{i}", surface.T_world_object), surface, **fixed)
    free = {**fixed, "conaffinity": MEETS[TARGET]}
    add_collision(spec, _add_free(spec, target, area_density), target, **free)
    if not isinstance(target, Lathe | Box):
        _add_pegs(spec, target, table)
    _add_weld(spec)
    try:
        return spec.compile()
    except ValueError as error:
        raise SceneError(f"MuJoCo can't compile the grasp of {target.name!r}: {error}") from error


def _check_names(names: list[str]) -> None:
    if len(set(names)) < len(names):
        raise SceneError(f"objects of the grasp are called {names}; names must differ")


def _arm_alone(T_world_base: RigidTransform, actual: ArmGeometry) -> Spec:
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.option.timestep = STEP
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    add_arm(spec, T_world_base, actual)
    add_actuators(spec)
    _let_arm_collide(spec)
    return spec


def _let_arm_collide(spec: Spec) -> None:
    for name in (*JOINTS, FLANGE):
        for geom in spec.body(name).geoms:
            geom.contype, geom.conaffinity = KINDS.get(name, HAND), 0
    # The last geom of the hand is the lip (`sim.arm`); the stem in front of which it sits is rigid.
    spec.body(FLANGE).geoms[-1].contype = LIP


def _add_body(spec: Spec, name: str, pose: RigidTransform) -> Any:
    quat = pose.rotation.as_quat(scalar_first=True)
    return spec.worldbody.add_body(name=name, pos=pose.translation, quat=quat)


def _add_free(spec: Spec, surface: Surface, area_density: float) -> Any:
    """The target as a free body with the mass and inertia of its wall."""
    inertia = shell_inertia(surface, area_density)
    body = _add_body(spec, TARGET, surface.T_world_object)
    body.add_freejoint()
    body.explicitinertial = True
    body.mass, body.ipos = inertia.mass, inertia.centre
    m = inertia.moments
    body.fullinertia = [m[0, 0], m[1, 1], m[2, 2], m[0, 1], m[0, 2], m[1, 2]]
    return body


def _add_pegs(spec: Spec, surface: Surface, attributes: dict[str, Any]) -> None:
    """Three round pegs of the table, called after it, that touch the true surface from below."""
    points = surface.T_world_object.apply(wall_points(surface)[0])
    low, high = points.min(axis=0), points.max(axis=0)
    angle = np.radians([30, 150, 270])
    aside = PEG_PLACE * np.stack([np.cos(angle), np.sin(angle), np.zeros(3)], axis=-1)
    below = (low + high) / 2 * (1, 1, 0) + aside * (high - low) / 2 + (0, 0, low[2] - PEG_RADIUS)
    up = np.tile([0.0, 0.0, 1.0], (3, 1))
    height = surface.intersect(below, up)
    if not np.all(np.isfinite(height)):
        raise SceneError(
            f"{surface.name}: the table's pegs don't meet it from below; accepted: a solid above them"
        )
    touch = below + height[:, None] * up
    for i, centre in enumerate(touch + PEG_RADIUS * surface.normals(touch)):
        name, sphere = f"{TABLE}/peg{i}", mujoco.mjtGeom.mjGEOM_SPHERE
        spec.worldbody.add_geom(name=name, type=sphere, size=[PEG_RADIUS, 0, 0], pos=centre, **attributes)


def _add_weld(spec: Spec) -> None:
    weld = spec.add_equality(name=SEAL, type=mujoco.mjtEq.mjEQ_WELD, objtype=mujoco.mjtObj.mjOBJ_BODY)
    weld.name1, weld.name2, weld.active = FLANGE, TARGET, False
    weld.solref, weld.solimp = WELD_SOLREF, WELD_SOLIMP


def set_weld(
    model: mujoco.MjModel, data: mujoco.MjData, T_flange_target: RigidTransform, p_flange: ArrayLike
) -> None:
    """Let the weld hold the target where it is in the flange's frame, its force acting at a point (3,) of the flange."""
    weld = model.equality(SEAL).id
    quat = T_flange_target.rotation.as_quat(scalar_first=True)
    # In a compiled model: the point in the second body's frame, the same in the first one's, the relative rotation.
    model.eq_data[weld, :10] = np.concatenate([T_flange_target.inv().apply(p_flange), p_flange, quat])
    data.eq_active[weld] = 1


def geom_owners(model: mujoco.MjModel, target: Surface, obstacles: Sequence[Surface]) -> list[str]:
    """For each geom what it belongs to: the target, an obstacle, the table, or the arm."""
    bodies = {
        TARGET: target.name,
        **{f"{OBSTACLES}/{i}": s.name for i, s in enumerate(obstacles)},
        "world": TABLE,
    }
    return [bodies.get(model.body(int(body)).name, "arm") for body in model.geom_bodyid]
