"""Motion under physics: the arm is driven through its commanded joint positions, comes to rest, and the shutter opens.

Each joint is held by a spring and a damper, torque = kp (ctrl - q) - kd qdot, as MuJoCo's position actuators are; gravity is
compensated. With ctrl = q_ref + kd/kp qdot_ref the torque is kp (q_ref - q) + kd (qdot_ref - qdot): the damper does not
make the arm lag behind a reference that moves.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import mujoco
import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import RigidTransform

from extremal.estimator.camera import Array
from extremal.estimator.errors import ExtremalError, InvalidInput
from extremal.estimator.reading import shown
from extremal.sim.arm import JOINT_LIMITS, JOINTS, add_arm
from extremal.sim.chain import ArmGeometry
from extremal.sim.warnings import warning_counts, warnings_of

STEP = 1e-3  # of the simulation [s]
# Five times the gains of MuJoCo Menagerie's UR5e, its armature (the motors' inertia seen through the gears), and the
# torques of the data sheet.
KP = np.array([10000.0, 10000.0, 10000.0, 2500.0, 2500.0, 2500.0])  # [N m / rad]
KD = KP / 25  # [N m s / rad]
TORQUES = (150.0, 150.0, 150.0, 28.0, 28.0, 28.0)  # [N m]
ARMATURE = 0.1  # [kg m^2]
FARTHEST = float(np.max(np.abs(JOINT_LIMITS)))  # [rad] a joint gets from zero
RUNAWAY = 100.0  # [rad/s] no sound arm reaches this
STANDING = 1e-3  # between positions that are passed, at least [rad]: else no time would pass


class ArmNotSettled(ExtremalError, RuntimeError):
    """An arm that does not come to rest, or does not follow at all."""


@dataclass(frozen=True)
class Drive:
    """How the arm is driven along a motion.

    Attributes:
        speed: of the fastest joint, at most [rad/s]; the UR5e's joints reach 3.1.
        acceleration: of any joint, at most [rad/s^2].
        settle: longest wait for the arm to come to rest before each shot [s]. 0: none; the arm does not stop, and the
            shutter opens as it passes.
        rest: joint speed below which the arm is at rest [rad/s].
    """

    speed: float = 1.0
    acceleration: float = 2.0
    settle: float = 2.0
    rest: float = 1e-5

    def __post_init__(self) -> None:
        for name, least, most in (
            ("speed", 0.01, np.pi),
            ("acceleration", 0.01, 40.0),
            ("rest", 1e-9, 1.0),
        ):
            value = getattr(self, name)
            if not _is_within(value, least, most):
                raise InvalidInput(
                    f"{name} of the joints is {shown(value)}; accepted: {least:g} to {most:.3g} in radians and seconds"
                )
        if not _is_within(self.settle, 0, 60):
            raise InvalidInput(f"settle is {shown(self.settle)}; accepted: 0 to 60 s (0: shots on the fly)")


@dataclass(frozen=True, eq=False)
class Execution:
    """How the joints moved, and when the shutter was open.

    Attributes:
        path: joint positions (..., 6) [rad], as the encoders read them, at times (...) [s].
        shots: (V,) times of mid exposure [s].
        exposure_time: [s].
    """

    path: CubicSpline
    shots: Array
    exposure_time: float

    @property
    def joint_positions(self) -> Array:
        """(V, 6) at mid exposure [rad]."""
        return self.path(self.shots)

    def exposure(self, view: int, parts: int) -> Array:
        """Joint positions (parts, 6) [rad] in the middle of equal parts of the exposure of a view.

        Raises InvalidInput for a view that there is not, or no parts.
        """
        if not 0 <= view < len(self.shots) or parts < 1:
            raise InvalidInput(
                f"{parts!r} parts of the exposure of view {view!r}; accepted: one or more, views 0 to {len(self.shots) - 1}"
            )
        middles = (np.arange(parts) + 0.5) / parts - 0.5
        return self.path(self.shots[view] + self.exposure_time * middles)


def execute(
    commanded: Array,
    geometry: ArmGeometry,
    T_world_base: RigidTransform,
    drive: Drive | None = None,
    exposure_time: float = 0.0,
) -> Execution:
    """Drive the arm through commanded joint positions. The same input gives the same bytes.

    Args:
        commanded: encoder readings (V, 6) [rad] to be reached, in order; the arm starts at rest at the first ones.
        geometry: the actual arm.
        exposure_time: for which the shutter is open around each position [s].

    Raises:
        ArmNotSettled: the arm is not at rest within `drive.settle`.
        InvalidInput: positions that are no numbers, of another shape or beyond what any joint reaches, a base without one
            finite pose, an exposure that is none.
    """
    drive, commanded = drive or Drive(), _numbers(commanded)
    # also how long a motion may take depends on it
    if commanded.shape[1:] != (6,) or len(commanded) < 2 or not np.all(np.abs(commanded) <= FARTHEST):
        raise InvalidInput(
            f"commanded joint positions are {commanded.shape}, up to {np.max(np.abs(commanded), initial=0.0):.3g} rad; accepted: "
            f"(V, 6), two or more, up to {FARTHEST:.3g} rad"
        )
    if not (T_world_base.single and np.all(np.isfinite(T_world_base.as_matrix()))):
        raise InvalidInput("T_world_base is not one transform of finite numbers")
    if not _is_within(exposure_time, 0, 10):
        raise InvalidInput(f"exposure time is {shown(exposure_time)}; accepted: 0 to 10 s")
    arm = _PhysicalArm(geometry, T_world_base, commanded[0])
    run = _with_stops if drive.settle else _on_the_fly
    shots = run(arm, commanded, drive, exposure_time)
    return Execution(arm.path(), shots, exposure_time)


def _is_within(value: Any, least: float, most: float) -> bool:
    """Whether an argument is a number, of Python or numpy, in this range; True and False are none."""
    is_number = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
    return is_number and bool(least <= value <= most)


def _numbers(commanded: Any) -> Array:
    """Commanded joint positions as numbers. What is none is refused: numpy would read texts and drop imaginary parts."""
    try:
        found = np.asarray(commanded)
    except (TypeError, ValueError):  # rows of different lengths
        found = np.array(None)
    if found.dtype.kind not in "iuf":
        raise InvalidInput(
            f"commanded joint positions are {shown(commanded)}; accepted: finite numbers (V, 6) [rad]"
        )
    return found.astype(float)


def _with_stops(arm: "_PhysicalArm", commanded: Array, drive: Drive, exposure_time: float) -> Array:
    """Move, come to rest, shoot: times of mid exposure (V,) [s]."""
    shots = []
    for start, end in pairwise([commanded[0], *commanded]):
        arm.follow(*_smooth_move(start, end, drive))
        arm.settle(end, drive)
        shots.append(arm.time + exposure_time / 2)
        arm.hold(end, exposure_time)
    return np.array(shots)


def _on_the_fly(arm: "_PhysicalArm", commanded: Array, drive: Drive, exposure_time: float) -> Array:
    """Pass all positions without a stop: times of mid exposure (V,) [s]."""
    passage = _passage(commanded, drive, exposure_time)
    arm.hold(commanded[0], exposure_time / 2)
    start = arm.time
    times = np.arange(0, passage.x[-1], STEP)
    arm.follow(passage(times), passage(times, 1))
    arm.hold(commanded[-1], exposure_time / 2)
    return start + passage.x


def _smooth_move(start: Array, end: Array, drive: Drive) -> tuple[Array, Array]:
    """Positions and velocities (n, 6) at every step of the move of least jerk from rest to rest (Flash and Hogan 1985)."""
    longest = np.max(np.abs(end - start))
    duration = max(1.875 * longest / drive.speed, np.sqrt(5.7735 * longest / drive.acceleration))
    count = int(np.ceil(duration / STEP))
    t = np.arange(count)[:, None] / max(count, 1)
    moved = t**3 * (10 - 15 * t + 6 * t**2)
    rate = 30 * t**2 * (1 - t) ** 2 / (max(count, 1) * STEP)
    return start + moved * (end - start), rate * (end - start)


def _passage(commanded: Array, drive: Drive, exposure_time: float) -> CubicSpline:
    """A spline of time [s] through all positions, as fast as the drive allows and exposures don't overlap."""
    lengths = np.max(np.abs(np.diff(commanded, axis=0)), axis=1)
    times = np.concatenate([[0.0], np.cumsum(np.maximum(lengths, STANDING))])
    spline = CubicSpline(times, commanded, bc_type="clamped")
    dense = np.linspace(0, times[-1], 20 * len(times))
    stretch = max(
        np.max(np.abs(spline(dense, 1))) / drive.speed,
        np.sqrt(np.max(np.abs(spline(dense, 2))) / drive.acceleration),
        exposure_time / np.min(np.diff(times)),
        STEP / times[-1],  # even where nothing moves
    )
    return CubicSpline(stretch * times, commanded, bc_type="clamped")


class _PhysicalArm:
    """The simulated arm; every step adds to its path."""

    def __init__(self, geometry: ArmGeometry, T_world_base: RigidTransform, start: Array) -> None:
        spec = mujoco.MjSpec()
        spec.option.timestep = STEP
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        add_arm(spec, T_world_base, geometry)
        add_actuators(spec)
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        self._warnings = warning_counts(self._data)
        self._data.qpos[:] = start
        self._positions = [np.array(start, float)]

    @property
    def time(self) -> float:
        """[s]"""
        return STEP * (len(self._positions) - 1)

    def follow(self, positions: Array, velocities: Array) -> None:
        """Take a step from each of the references (n, 6) [rad], [rad/s]."""
        data = self._data
        for control in positions + KD / KP * velocities:
            data.ctrl[:] = control
            mujoco.mj_step(self._model, data)
            # MuJoCo resets a state that is not finite: then only its warning tells.
            if not np.max(np.abs(data.qvel)) < RUNAWAY or self._warnings.any():
                raise ArmNotSettled(
                    f"the arm runs away: its joints move at {np.round(data.qvel, 1).tolist()} rad/s "
                    f"(MuJoCo warns of: {warnings_of(self._warnings) or 'nothing'}); accepted: commanded positions within its "
                    f"limits, and drives below {RUNAWAY:g} rad/s"
                )
            self._positions.append(data.qpos.copy())

    def hold(self, position: Array, duration: float) -> None:
        """Stay for a time [s], and a step longer."""
        count = int(np.ceil(duration / STEP)) + 1
        self.follow(np.tile(position, (count, 1)), np.zeros((count, 6)))

    def settle(self, position: Array, drive: Drive) -> None:
        """Hold a position until the arm is at rest."""
        until = self.time + drive.settle
        while np.max(np.abs(self._data.qvel)) >= drive.rest:
            if self.time >= until:
                raise ArmNotSettled(
                    f"the arm still moves at {np.max(np.abs(self._data.qvel)):.2g} rad/s after {drive.settle:g} s; accepted: "
                    f"below {drive.rest:g} rad/s; let it settle for longer"
                )
            self.hold(position, 0.0)

    def path(self) -> CubicSpline:
        """Joint positions (..., 6) [rad] at times (...) [s]."""
        return CubicSpline(STEP * np.arange(len(self._positions)), self._positions)


def add_actuators(spec: mujoco.MjSpec) -> None:
    """Position actuators, gravity compensation and the motors' inertia for the arm of a model."""
    for name, kp, kd, torque in zip(JOINTS, KP, KD, TORQUES, strict=True):
        spec.joint(name).armature = ARMATURE
        actuator = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        actuator.set_to_position(kp=kp, kv=kd)
        actuator.forcelimited, actuator.forcerange = mujoco.mjtLimited.mjLIMITED_TRUE, [-torque, torque]
    for name in (*JOINTS, "flange"):
        spec.body(name).gravcomp = 1.0
