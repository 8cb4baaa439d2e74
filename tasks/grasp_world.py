"""The physics of a grasp: the arm moves, the cup seals on true geometry, holds, and lets go when it is asked too much."""

from collections.abc import Iterator, Sequence

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from extremal.estimator.camera import Array
from extremal.estimator.errors import ExtremalError, InvalidInput
from extremal.scenes import Surface
from extremal.sim import ArmGeometry
from extremal.sim.arm import CUP_TIP
from extremal.sim.execution import KD, KP
from extremal.sim.warnings import warning_counts, warnings_of
from extremal.tasks.grasp_film import pictures
from extremal.tasks.grasp_model import SEAL, TARGET, geom_owners, grasp_model, set_weld
from extremal.tasks.grasp_motion import PEAK, STEP, T_FLANGE_CUP, CupKinematics, JointPath, timed
from extremal.tasks.grasp_outcome import LIFT, GraspOutcome
from extremal.tasks.suction import Seal, SuctionCup, load_ratio, seal

MARGIN = 0.005  # by which a lift goes higher than it must: arm and weld give way a little [m]
GUARD = 2.5e-4  # of travel between two looks at the vacuum gauge [m]
APPROACH_SPEED = 0.015  # of the cup, guarded [m/s]
BRAKE = 0.03  # time in which a guarded motion comes to rest [s]
AREA_DENSITY = 3.0  # of the target's wall: 3 mm of plastic, 1.2 mm of glass [kg/m^2]
FRICTION = 0.5  # between target, table and whatever else touches
FILM = 50  # steps between positions that are kept for a film: a tenth of a second
RUNAWAY = 1e3  # [m/s], [rad/s] nothing sound moves so fast


class GraspDiverged(ExtremalError, RuntimeError):
    """A simulation whose numbers mean nothing any more."""


class GraspWorld:
    """An arm with a suction cup beside a table on which the target stands. The same calls give the same bytes.

    The cup's seal is judged on the exact surface. The lip itself is soft and exerts no force until it seals; what is
    behind it, and the rest of the arm, is rigid.

    Args:
        target: what is to be grasped, standing on the world's plane z = 0; free to move; hollow.
        arm: where it stands, and what is believed of it; `lift` moves the cup accordingly.
        start: joint positions (6,) at which the arm is at rest [rad].
        obstacles: other objects, fixed.
        actual: the arm as it is; None: as believed.
        cup: the suction cup.
        area_density: of the target's wall [kg/m^2].
    """

    def __init__(
        self,
        target: Surface,
        arm: CupKinematics,
        start: ArrayLike,
        obstacles: Sequence[Surface] = (),
        actual: ArmGeometry | None = None,
        cup: SuctionCup | None = None,
        area_density: float = AREA_DENSITY,
    ) -> None:
        self.target, self.arm, self.cup = target, arm, cup or SuctionCup()
        self._model = grasp_model(
            target, obstacles, arm.T_world_base, actual or arm.believed, area_density, FRICTION
        )
        self._data = mujoco.MjData(self._model)
        self._warnings = warning_counts(self._data)
        self._reference = _joints(start)
        self._data.qpos[:6] = self._reference
        self._names = geom_owners(self._model, target, obstacles)
        self._body, self._cup_tip = self._model.body(TARGET).id, self._model.site(CUP_TIP).id
        self._wrong = self._all_but_standing()
        mujoco.mj_forward(self._model, self._data)
        self._stood = self._centre.copy()
        self._steps = self._held = 0
        self._sealed = self._released = self._lifting = False
        self._moved = self._largest_load = 0.0
        self._touched = ""
        self._film = [self._data.qpos.copy()]
        self.wrench = np.zeros(6)

    # What is there.

    @property
    def time(self) -> float:
        """[s]"""
        return STEP * self._steps

    @property
    def mass(self) -> float:
        """Of the target [kg]."""
        return float(self._model.body_mass[self._body])

    @property
    def joint_positions(self) -> Array:
        """(6,) as the encoders read them [rad]."""
        return self._data.qpos[:6].copy()

    @property
    def T_world_target(self) -> RigidTransform:
        """The target's true pose."""
        data = self._data
        rotation = Rotation.from_quat(data.xquat[self._body], scalar_first=True)
        return RigidTransform.from_components(data.xpos[self._body], rotation)

    @property
    def T_world_cup(self) -> RigidTransform:
        """The cup's true pose."""
        rotation = Rotation.from_matrix(self._data.site_xmat[self._cup_tip].reshape(3, 3))
        return RigidTransform.from_components(self._data.site_xpos[self._cup_tip], rotation)

    @property
    def holds(self) -> bool:
        """Whether the cup holds the target."""
        return self._sealed and not self._released

    @property
    def outcome(self) -> GraspOutcome:
        """What has become of the grasp so far."""
        return GraspOutcome(
            self._sealed,
            float(self._centre[2] - self._stood[2]),
            STEP * self._held,
            self._released,
            self._moved,
            self._touched,
            self._largest_load,
        )

    def film(self) -> Iterator[NDArray[np.uint8]]:
        """Pictures of what has happened so far, ten a second (`grasp_film.pictures`)."""
        return pictures(self._model, self._film)

    @property
    def _centre(self) -> Array:
        return self._data.xipos[self._body]

    # What can be done.

    def follow(self, path: JointPath) -> None:
        """Take a step along each of the references of a path (`timed`)."""
        for q, rate in zip(path.positions, path.velocities, strict=True):
            self._step(q, rate)

    def hold(self, seconds: float) -> None:
        """Stay.

        Raises:
            InvalidInput: a time that is negative or above 1000 s.
        """
        if not 0 <= seconds <= 1000:
            raise InvalidInput(f"time to hold is {seconds!r}; accepted: 0 to 1000 s")
        still = np.zeros(6)
        for _ in range(round(seconds / STEP)):
            self._step(self._reference, still)

    def gauge(self) -> Seal:
        """How the rim meets the target's true surface where both are now."""
        T_surface_cup = self.target.T_world_object * self.T_world_target.inv() * self.T_world_cup
        return seal(self.cup, self.target, T_surface_cup)

    def seal_now(self) -> Seal:
        """Draw the vacuum: where the rim seals, the cup holds from now on; once it has let go it can't again."""
        found = self.gauge()
        if found.sealed and not self._sealed:
            T_flange_target = T_FLANGE_CUP * self.T_world_cup.inv() * self.T_world_target
            set_weld(self._model, self._data, T_flange_target, T_FLANGE_CUP.translation)
            self._sealed = True
        return found

    def approach(self, waypoints: Array, speed: float = APPROACH_SPEED) -> Seal:
        """Guarded motion: follow joint positions (V, 6) until the vacuum gauge says that the rim has sealed, or to their end.

        Between two looks the cup advances by `GUARD`, or by the gap that is still open, whatever is longer: no seal is possible
        before it is closed.

        Args:
            waypoints: from where the arm is, as of `CupKinematics.straight_approach` [rad].
            speed: of the cup, at most about [m/s].

        Raises:
            InvalidInput: waypoints that are not finite (V, 6), or a speed that is not positive.
        """
        if not 0 < speed <= 1:
            raise InvalidInput(f"speed of the approach is {speed!r}; accepted: above 0, up to 1 m/s")
        places = self.arm.cup_poses(waypoints).translation
        length = float(np.sum(np.linalg.norm(np.diff(places, axis=0), axis=1)))
        path = timed(waypoints, least=PEAK * length / speed)
        seen, wait = self._cup_place(), 0.0
        for q, rate in zip(path.positions, path.velocities, strict=True):
            if np.linalg.norm(self._cup_place() - seen) >= wait:
                found, seen = self.seal_now(), self._cup_place()
                if self._sealed:
                    self.follow(_braking(self._reference, rate))
                    return found
                wait = max(GUARD, float(found.gap)) if np.isfinite(found.gap) else GUARD
            self._step(q, rate)
        return self.seal_now()

    def lift(self, height: float = LIFT + MARGIN, speed: float = 0.5) -> None:
        """Raise the cup straight up.

        Args:
            height: [m].
            speed: of the fastest joint [rad/s].

        Raises:
            UnreachablePose: the arm does not reach as high.
        """
        start = self.arm.cup_poses(self._reference[None])[0]
        path = self.arm.straight(self._reference, RigidTransform.from_translation([0.0, 0.0, height]) * start)
        self._lifting = True
        self.follow(timed(path, speed))

    # One step.

    def _cup_place(self) -> Array:
        return self._data.site_xpos[self._cup_tip].copy()

    def _step(self, position: Array, velocity: Array) -> None:
        data = self._data
        self._reference = position
        data.ctrl[:] = position + KD / KP * velocity
        mujoco.mj_step(self._model, data)
        self._steps += 1
        q, v = data.qpos, data.qvel
        if self._steps % FILM == 0:
            self._film.append(q.copy())
        # MuJoCo resets what is not finite, and the time with it.
        sound = v @ v < RUNAWAY**2 and q @ q < np.inf and abs(data.time - self.time) < STEP / 2
        if not sound or self._warnings.any():
            raise GraspDiverged(
                f"the simulation of {self.target.name!r} diverged after {self.time:.3f} s: velocities "
                f"{np.round(v, 1).tolist()}, MuJoCo warns of: {warnings_of(self._warnings) or 'nothing'}; accepted: finite, below "
                f"{RUNAWAY:g}, and no warnings"
            )
        if self.holds:
            self._bear()
        self._watch()

    def _all_but_standing(self) -> NDArray[np.bool_]:
        """Pairs of geoms (ngeom, ngeom) that must not touch: all but the target's with the world's own, the table and its pegs."""
        bodies = self._model.geom_bodyid
        stands, carries = bodies == self._body, bodies == 0
        return ~(stands[:, None] & carries | carries[:, None] & stands)

    def _bear(self) -> None:
        """Measure the weld's wrench, and let go for good where the cup can't bear it."""
        self.wrench = self._measured()
        ratio = float(load_ratio(self.cup, self.wrench[:3], self.wrench[3:]))
        self._largest_load = max(self._largest_load, ratio)
        if ratio > 1:
            self._released = True
            self._data.eq_active[self._model.equality(SEAL).id] = 0

    def _measured(self) -> Array:
        """Wrench (6,) of the target on the cup, in the cup frame about the lip's middle [N], [N m].

        The weld's multipliers f, the first ones of the solver, act on the target's free joint as J' f: a force at the body's
        origin in world axes, and a torque about it in the body's axes (virtual work).
        """
        data, rows = self._data, self._data.ne
        jacobian = data.efc_J[: rows * self._model.nv].reshape(rows, -1)[:, 6:12]
        acting = data.efc_force[:rows] @ jacobian
        R = data.site_xmat[self._cup_tip].reshape(3, 3)
        force = -acting[:3] @ R
        x, y, z = (data.xpos[self._body] - data.site_xpos[self._cup_tip]) @ R
        fx, fy, fz = force
        moved = np.array([y * fz - z * fy, z * fx - x * fz, x * fy - y * fx])
        torque = moved - (data.xmat[self._body].reshape(3, 3) @ acting[3:]) @ R
        return np.concatenate([force, torque])

    def _watch(self) -> None:
        """Keep account of where the target goes and what touches what."""
        shift = self._centre - self._stood
        if not self._lifting:
            self._moved = max(self._moved, float(np.sqrt(shift @ shift)))
        self._held = self._held + 1 if self.holds and shift[2] >= LIFT else 0
        if not self._touched and self._data.ncon:
            pairs = self._data.contact.geom
            wrong = self._wrong[pairs[:, 0], pairs[:, 1]]
            if wrong.any():
                self._touched = " on ".join(sorted(self._names[g] for g in pairs[np.argmax(wrong)]))


def _joints(start: ArrayLike) -> Array:
    q = np.array(start, float)
    if q.shape != (6,) or not np.all(np.isfinite(q)):
        raise InvalidInput(
            f"joint positions to start from are {q.tolist()}; accepted: six finite numbers [rad]"
        )
    return q


def _braking(position: Array, velocity: Array) -> JointPath:
    """From a velocity (6,) [rad/s] to rest, evenly."""
    s = np.linspace(0, 1, round(BRAKE / STEP) + 1)[1:, None]
    return JointPath(position + velocity * BRAKE * (s - s * s / 2), velocity * (1 - s))
