"""`extremal/Grasp-v0`: look at a vase from one side, and lift it by its other."""

from collections.abc import Iterator
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from extremal.estimator.camera import Array
from extremal.scenes import Scene, Surface
from extremal.sim import NOMINAL, UnreachablePose, fixating
from extremal.tasks.clearance import Clearance, between
from extremal.tasks.environment import ActiveVisionEnv, Observation
from extremal.tasks.grasp_motion import T_FLANGE_CUP, CupKinematics
from extremal.tasks.grasp_outcome import LIFT, GraspOutcome
from extremal.tasks.grasp_setup import GraspSetup
from extremal.tasks.grasp_world import GraspDiverged, GraspWorld
from extremal.tasks.planning.clear_path import ClearPaths
from extremal.tasks.planning.grasp import GraspPlan, carry_out
from extremal.tasks.rigid import product
from extremal.tasks.spaces import POSE_TURN, REACH, motion_space
from extremal.tasks.tiers import Tier

CAMERA_RADIUS = 0.02  # [m]
BEFORE, BEHIND = (
    0.025,
    0.012,
)  # [m] of the pose that is asked for, where the guarded approach begins and where it gives up
_CAMERA_CUP = (NOMINAL.T_flange_camera.inv() * T_FLANGE_CUP).as_matrix()  # of the hand that holds both


class GraspEnv(ActiveVisionEnv[GraspSetup]):
    """Place a suction cup on the side of a vase that the camera has not seen, and lift it.

    A vase of radius 25 to 80 mm stands on a table, before a UR5e with a camera and a suction cup in its hand, beside a box whose
    creases are fixed features. The camera looks from 0.35 m away; the cup has to be placed 45 to 90 degrees of azimuth beyond
    the contour generator (see `grasp_setup`), where only R tells where the surface is. The cup is that of
    `suction.SuctionCup`: it seals by the true surface under its rim, and lets go by the forces that physics makes.

    ## Action space

    `Box((13,), float32)`: 0-5 move the camera as in `extremal/Navigate-v0`; 6 above 0: grasp now, at the pose of the cup that
    follows, T_world_cup as it is believed to be, z along the approach:

    | # | action | unit at 1 |
    |---|---|---|
    | 7-9 | position of the middle of the lip | 2 m |
    | 10-12 | rotation vector | pi rad |

    The arm goes there by itself on a way that is clear of everything, approaches along z from 25 mm before to 12 mm behind that
    pose until its vacuum gauge tells a seal, lifts by 100 mm and holds for a second, under physics.

    ## Observation space

    As `extremal/Navigate-v0`, with two keys in place of `goal`:

    | key | shape | meaning |
    |---|---|---|
    | `accepted` | (3,) | least and largest azimuth [rad] of the vase's outward normal at the grasp, from world x towards y; its height [m], about |
    | `joints` | (6,) | of the arm [rad] |

    ## Rewards

    At the grasp alone. `"sparse"`: 1 on success. `"shaped"`: 0.3 for a seal, as much again of 100 mm lifted, 0.4 on success.

    ## Episode end

    Terminated by the grasp, and when the camera touches something; truncated after `max_steps`.

    ## Info

    `is_success`: sealed in the accepted azimuths, lifted 100 mm, held 1 s, never released, the vase moved at most 5 mm before the
    lift, nothing else touched. `grasped`, `collision` (0, 1); after a grasp `sealed`, `released`, `other_contact`, `accepted` (0,
    1), `lifted_mm`, `held_s`, `moved_mm`, `normal_error_mm` of the asked pose from the true surface; `path_length_m`; `steps`.

    ## Seeds and arguments

    As `extremal/Navigate-v0`.
    """

    def _draw(self, seed: int, tier: Tier) -> GraspSetup:
        return GraspSetup.draw(seed, tier)

    def _scene(self) -> tuple[Scene, RigidTransform]:
        return self.setup.scene, self.setup.views[0]

    def _actions(self) -> gym.spaces.Box:
        motion = motion_space(self.action_mode)
        ones = np.ones(7, np.float32)
        return gym.spaces.Box(np.append(motion.low, -ones), np.append(motion.high, ones), dtype=np.float32)

    def _observations(self) -> dict[str, gym.Space[Any]]:
        return super()._observations() | {
            "accepted": gym.spaces.Box(-10.0, 10.0, (3,), np.float32),
            "joints": gym.spaces.Box(-7.0, 7.0, (6,), np.float32),
        }

    def _begin(self) -> None:
        self.arm = CupKinematics(self.setup.T_world_base)
        cup = RigidTransform.from_matrix(product(self.T_commanded, _CAMERA_CUP)[None])
        self.joints = self.arm.joint_positions(cup)[0]
        self._collision, self._grasp = False, dict.fromkeys(_GRASP, float("nan"))
        self._trace = [self.here]
        self._world: GraspWorld | None = None
        self._near = Clearance(self.scene, CAMERA_RADIUS, smallest=1e-9)

    def afterwards(self) -> Iterator[NDArray[np.uint8]]:
        return iter(()) if self._world is None else self._world.film()

    def _extra(self) -> Observation:
        accepted = [*self.setup.azimuth_range, self.setup.level]
        return {"accepted": np.array(accepted, np.float32), "joints": self.joints.astype(np.float32)}

    def _judge(self, action: Array, before: Array) -> tuple[float, bool, bool]:
        here = self.here
        self._trace.append(here)
        self._near.take_in(between(before, here))
        self._collision = self._near.smallest <= 0
        try:
            self.joints = self.arm.straight_to(self.joints, product(self.T_commanded, _CAMERA_CUP))[-1]
        except UnreachablePose:
            self._collision = True  # the arm is at the end of what it can do
        if self._collision or action[6] <= 0:
            return 0.0, self._collision, False
        asked = RigidTransform.from_components(
            REACH * action[7:10], Rotation.from_rotvec(POSE_TURN * action[10:13])
        )
        outcome = self._grasped(asked)
        accepted = self._is_accepted(asked)
        success = bool(outcome is not None and outcome.success and accepted)
        self._grasp = _scored(
            outcome, accepted, abs(float(self.setup.vase.signed_distance(asked.translation)))
        )
        if self.reward_mode == "sparse" or outcome is None:
            return float(success), True, success
        lifted = min(max(outcome.lifted_m / LIFT, 0.0), 1.0)
        return (
            0.3 * float(outcome.sealed) + 0.3 * lifted * float(outcome.sealed) + 0.4 * success,
            True,
            success,
        )

    def _grasped(self, asked: RigidTransform) -> GraspOutcome | None:
        """What becomes of a grasp at a pose of the cup; None where the arm can't get there."""
        others = [s for s in self.scene.objects if s.name not in ("table", "vase")]
        try:
            plan = _way(self.arm, self.joints, asked, self.setup.vase, others)
            if plan is None:
                return None
            self._world = GraspWorld(self.setup.vase, self.arm, plan.way[0], others, self.robot.geometry)
            return carry_out(self._world, plan)
        except (UnreachablePose, GraspDiverged):
            return None

    def _is_accepted(self, asked: RigidTransform) -> bool:
        """Whether the outward normal at the grasp is in the accepted azimuths."""
        normal = -asked.rotation.apply([0.0, 0.0, 1.0])
        low, high = self.setup.azimuth_range
        azimuth = np.mod(np.arctan2(normal[1], normal[0]) - low, 2 * np.pi)
        return bool(azimuth <= high - low + 1e-6 or azimuth >= 2 * np.pi - 1e-6)

    def _metrics(self) -> dict[str, float]:
        grasped = float(np.isfinite(self._grasp["sealed"]))
        return {"grasped": grasped, "collision": float(self._collision)} | self._grasp

    def _onlooker(self) -> tuple[RigidTransform, list[tuple[Array, str]]]:
        middle = np.array([0.0, 0.0, self.setup.level])
        eye = middle + np.array([0.25, 0.75, 0.4])
        return fixating(eye[None], middle)[0], [
            (np.array(self._trace), "path"),
            (self._trace[-1][None], "camera"),
        ]


_GRASP = (
    "sealed", "released", "other_contact", "accepted", "lifted_mm", "held_s", "moved_mm", "normal_error_mm",
)  # fmt: skip


def _way(
    arm: CupKinematics, joints: Array, asked: RigidTransform, vase: Surface, others: list[Surface]
) -> GraspPlan | None:
    """The way to a pose of the cup, clear of everything, and the guarded approach there; None where there is none."""
    before, end = (asked * RigidTransform.from_translation([0, 0, d]) for d in (-BEFORE, BEHIND))
    way = ClearPaths(arm, vase, others).path_to(joints, before, vase.T_world_object.translation)
    if way is None:
        return None
    return GraspPlan(
        asked, before, BEHIND, 1.0, 0.0, float(asked.translation[2]), way, arm.straight(way[-1], end)
    )


def _scored(outcome: GraspOutcome | None, accepted: bool, error: float) -> dict[str, float]:
    if outcome is None:
        return dict.fromkeys(_GRASP, 0.0) | {"accepted": float(accepted), "normal_error_mm": 1e3 * error}
    return {
        "sealed": float(outcome.sealed),
        "released": float(outcome.released),
        "other_contact": float(bool(outcome.other_contact)),
        "accepted": float(accepted),
        "lifted_mm": 1e3 * outcome.lifted_m,
        "held_s": outcome.held_s,
        "moved_mm": 1e3 * outcome.moved_before_lift_m,
        "normal_error_mm": 1e3 * error,
    }
