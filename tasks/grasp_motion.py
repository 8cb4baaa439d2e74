"""Where the cup goes: joint paths for the believed arm, on one branch of its inverse kinematics, and their timing."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import RigidTransform, Rotation

from extremal.estimator.camera import Array
from extremal.estimator.errors import InvalidInput
from extremal.sim import NOMINAL, ArmGeometry, ArmKinematics, UnreachablePose, fixating
from extremal.sim.arm import CUP_LENGTH, JOINT_LIMITS
from extremal.tasks.arm_chain import Chain, straight_to

# Beside a table with the target at the world's origin. As in `sim.kinematics` joints 2, 3 and 4 turn about the vertical,
# but turned over: the forearm is carried above the hand, clear of the table. Found by trying bases on a grid, clear of the table
# by 5 mm: the arm grasps at 0.1 m height from azimuths of 140 to 310 degrees (R = 25 to 80 mm), lifts, and at 0.2 m height looks from
# azimuths of 98 to 140 degrees, 0.35 to 0.45 m away. Seen from 120 degrees the right contour generator is at about 200, and 45 to
# 90 degrees beyond it is where the arm grasps best.
T_TABLE_BASE = RigidTransform.from_components([-0.5, 0.2, 0.4], Rotation.from_rotvec([np.pi / 2, 0, 0]))
T_FLANGE_CUP = RigidTransform.from_translation([0.0, 0.0, CUP_LENGTH])
STEP = 2e-3  # of the simulation [s]
SPACING, TURN = 0.005, 0.02  # between poses of a straight path [m], [rad]
JUMP = 0.2  # a joint that turns further between them has left its branch, or passes a singularity [rad]
RESIDUAL = 1e-10  # accepted distance from the wanted pose [m] and [rad]
FASTEST = 5.0  # of any joint [rad/s]: 5 mrad in a step of 1 ms
PEAK = 1.875  # largest speed of the time law of least jerk, in mean speeds
STANDING = 1e-6  # between positions of a path, at least [rad]: else no time would pass


@dataclass(frozen=True, eq=False)
class JointPath:
    """The reference at every step of the simulation: positions (n, 6) [rad] and velocities (n, 6) [rad/s]."""

    positions: Array
    velocities: Array

    def __post_init__(self) -> None:
        for name in ("positions", "velocities"):
            value = getattr(self, name)
            if value.ndim != 2 or value.shape[1] != 6 or not np.all(np.isfinite(value)):
                raise InvalidInput(f"{name} of the joints are {value.shape}; accepted: finite numbers (n, 6)")


def timed(
    waypoints: ArrayLike, speed: float = 1.0, acceleration: float = 3.0, least: float = 0.0
) -> JointPath:
    """From rest to rest through joint positions (V, 6) [rad] along a spline, in the time law of least jerk (Flash and Hogan 1985).

    Args:
        speed, acceleration: of the fastest joint, at most [rad/s], [rad/s^2]; turns of the spline may add to the latter.
        least: time that it takes at least [s].

    Raises:
        InvalidInput: fewer than two waypoints, numbers that are not finite, or a speed above 5 rad/s.
    """
    q = np.asarray(waypoints, float)
    if q.ndim != 2 or q.shape[1] != 6 or len(q) < 2 or not np.all(np.isfinite(q)):
        raise InvalidInput(
            f"joint positions are {q.shape}; accepted: finite numbers (V, 6) [rad], two or more"
        )
    if not 0 < speed <= FASTEST or not 0 < acceleration <= 100:
        raise InvalidInput(
            f"speed and acceleration are {speed!r}, {acceleration!r}; accepted: above 0, up to {FASTEST:g} and 100"
        )
    lengths = np.maximum(np.max(np.abs(np.diff(q, axis=0)), axis=1), STANDING)
    along = np.concatenate([[0.0], np.cumsum(lengths)])
    spline = CubicSpline(along / along[-1], q)
    steepest = np.max(np.abs(spline(np.linspace(0, 1, 20 * len(q)), 1)))
    duration = max(least, PEAK * steepest / speed, np.sqrt(5.7735 * steepest / acceleration), STEP)
    count = int(np.ceil(duration / STEP))
    t = np.arange(1, count + 1)[:, None] / count
    s = t**3 * (10 - 15 * t + 6 * t**2)
    rate = 30 * t**2 * (1 - t) ** 2 / (count * STEP)
    return JointPath(spline(s[:, 0]), spline(s[:, 0], 1) * rate)


def cup_facing(points: ArrayLike, normals: ArrayLike) -> RigidTransform:
    """T_world_cup (N) of cups whose lip lies at points (N, 3), square to outward normals (N, 3), the camera above.

    Raises:
        InvalidInput: a number is not finite, or a normal is vertical or zero.
    """
    points, normals = np.asarray(points, float), np.asarray(normals, float)
    return fixating(points, points - normals)


class CupKinematics:
    """Joint positions that bring the cup where it is wanted, if the arm is as believed.

    Args:
        T_world_base: pose of the arm's base.
        believed: the geometry of which one knows; joint positions are encoder readings.
    """

    def __init__(self, T_world_base: RigidTransform, believed: ArmGeometry = NOMINAL) -> None:
        self.T_world_base, self.believed = T_world_base, believed
        self._arm, self._chain = ArmKinematics(T_world_base, believed), Chain.of(T_world_base, believed)

    def cup_poses(self, joint_positions: ArrayLike) -> RigidTransform:
        """T_world_cup (V) at joint positions (V, 6) [rad]."""
        return self.T_world_base * self.believed.flange_poses(joint_positions) * T_FLANGE_CUP

    def joint_positions(self, T_world_cup: RigidTransform) -> Array:
        """Joint positions (V, 6) [rad] along a path of cup poses (V), all on the branch of `ArmKinematics`.

        Raises:
            UnreachablePose: a pose is out of reach, at a joint limit, or behind a singularity.
        """
        return self._arm.joint_positions(T_world_cup * T_FLANGE_CUP.inv() * self.believed.T_flange_camera)

    def joint_path_to(self, start: ArrayLike, T_world_cup: RigidTransform) -> Array:
        """Joint positions (2, 6): from `start` (6,) to one pose of the cup, straight in joint space.

        Raises:
            UnreachablePose: as for `joint_positions`.
        """
        goal = self.joint_positions(RigidTransform.concatenate([T_world_cup]))
        return np.concatenate([np.reshape(np.asarray(start, float), (1, 6)), goal])

    def straight_approach(
        self, T_world_cup_pregrasp: RigidTransform, T_world_cup_contact: RigidTransform
    ) -> Array:
        """Joint positions (V, 6) [rad] that carry the cup straight from one pose to another, on one branch.

        Raises:
            UnreachablePose: the line leaves the arm's reach or its branch.
        """
        start = self.joint_positions(RigidTransform.concatenate([T_world_cup_pregrasp]))[0]
        return self.straight(start, T_world_cup_contact)

    def straight(self, start: ArrayLike, T_world_cup: RigidTransform) -> Array:
        """Joint positions (V, 6) [rad] from `start` (6,) that carry the cup straight to a pose; Newton's method in small steps.

        Raises:
            UnreachablePose: the line leaves the arm's reach or its branch.
        """
        return self.straight_to(start, T_world_cup.as_matrix())

    def straight_to(self, start: ArrayLike, T_world_cup: Array) -> Array:
        """As `straight`, to a pose (4, 4)."""
        q = np.array(start, float)
        try:
            path, is_there = straight_to(
                self._chain, q, _CUP, T_world_cup, SPACING, TURN, JOINT_LIMITS, RESIDUAL, JUMP
            )
        except np.linalg.LinAlgError:
            path, is_there = q[None], False
        if not is_there:
            place = np.round(T_world_cup[:3, 3], 3).tolist()
            raise UnreachablePose(
                f"the arm can't bring its cup straight to {place} [m]; accepted: lines within its reach and its limits, "
                "away from singularities"
            )
        return path


_CUP = T_FLANGE_CUP.as_matrix()
