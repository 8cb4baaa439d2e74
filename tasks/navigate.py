"""`extremal/Navigate-v0`: around an unknown curved obstacle to a goal that it hides."""

import math
from typing import Any

import gymnasium as gym
import numpy as np
from scipy.spatial.transform import RigidTransform

from extremal.estimator.camera import Array
from extremal.scenes import Scene
from extremal.sim import ArmErrors, fixating
from extremal.tasks.carried import repeatability
from extremal.tasks.clearance import Clearance, between
from extremal.tasks.environment import ActiveVisionEnv, Observation
from extremal.tasks.metrics import path_ratio, regret, spl
from extremal.tasks.navigate_setup import NavigateSetup
from extremal.tasks.tiers import Tier

ARRIVED = 0.01  # [m]


class NavigateEnv(ActiveVisionEnv[NavigateSetup]):
    """Bring a camera, a sphere of 20 mm, to a goal on the far side of an unknown curved obstacle without touching anything.

    Start and goal are 30 to 50 mm from an obstacle of radius 60 to 150 mm; the shortest path that keeps the wanted clearance
    wraps 60 to 120 degrees around it (see `navigate_setup`). The camera starts looking along the tangent to the obstacle, with
    a box, whose creases are fixed features, past it. Poses are as well known as the tier's robot; what is observed is
    in the world as it is believed to be; scores are the truth's.

    ## Action space

    `action_mode="velocity"`: `Box(-1, 1, (6,), float32)`

    | # | action | unit at 1 |
    |---|---|---|
    | 0-2 | velocity along world x, y, z (together at most 1) | 0.1 m/s |
    | 3-5 | angular velocity about the camera's x (right), y (down), z (forward) | 1 rad/s |

    `action_mode="pose"`: `Box((6,), float32)`: the goal T_world_camera as position [m] and rotation vector [rad]; the camera goes
    towards it at no more than these speeds. A step takes 0.1 s.

    ## Observation space

    `Dict`, all float32, world coordinates as believed:

    | key | shape | meaning |
    |---|---|---|
    | `pose` | (7,) | camera: position [m], unit quaternion x, y, z, w |
    | `goal` | (3,) | [m] |
    | `time` | (1,) | share of the time limit that is used up |
    | `features` | (64, 19) | tracked contour points, zero rows where there are none (not in `obs_mode="rgb"`) |
    | `rgb` | (128, 128, 3) uint8 | (`obs_mode="rgb"`, `"both"`) |

    Columns of `features`: `radius`, `sigma` [m] of the section by the epipolar plane (sigma 1: unknown), `relative`,
    `sigma_relative` [m] the same relative to the fixed references, `x`, `y`, `z` contact point [m], `sigma_position` [m] along
    the normal, `nx`, `ny`, `nz` outward normal, `extremal` 1 where R is not zero at 95 %, `reference`, `visible`, `contour`
    number of the image contour, `looks` number of views, `plane_x`, `plane_y`, `plane_z` unit normal of the section's plane.

    ## Rewards

    `"sparse"`: 1 on arrival. `"shaped"`: half of the progress towards the goal as the crow flies, when it is the best so far, and
    0.5 on arrival; the sum of an episode is in [0, 1].

    ## Episode end

    Terminated on arrival (within 10 mm of the goal) and on contact; truncated after `max_steps` (200).

    ## Info

    `is_success`; `collision` (0, 1); `smallest_clearance_mm` from the sphere's surface to any object; `violation_mm` of the wanted
    20 mm; `distance_mm` to the goal; `spl` (Anderson et al. 2018); on success `path_ratio` to the true shortest path and
    `regret` = (L - L*) / (L* - |AB|); `path_length_m`; `steps`. A path ratio below 1 means that clearance was violated.

    ## Seeds

    `reset(seed=s)` is the episode of s. Train on `tiers.TRAIN_SEEDS` (0 to 99,999), report on `TEST_SEEDS` (1,000,000 on).
    `reset(options={"appearance": "glossy"})` replaces fields of the tier.

    ## Arguments

    See `ActiveVisionEnv`.
    """

    def _draw(self, seed: int, tier: Tier) -> NavigateSetup:
        return NavigateSetup.draw(seed, tier)

    def _scatter(self, errors: ArmErrors) -> Array:
        return repeatability(errors)

    def _scene(self) -> tuple[Scene, RigidTransform]:
        return self.setup.scene, self.setup.T_world_camera

    def _begin(self) -> None:
        self._best = 0.0
        self._near = Clearance(self.scene, self.setup.radius)
        self._near.take_in(self.here[None])
        self._whole = self._distance
        self._trace = [self.here]

    def _observations(self) -> dict[str, gym.Space[Any]]:
        return super()._observations() | {"goal": gym.spaces.Box(-10.0, 10.0, (3,), np.float32)}

    def _extra(self) -> Observation:
        return {"goal": self.setup.goal.astype(np.float32)}

    def _judge(self, action: Array, before: Array) -> tuple[float, bool, bool]:
        self._near.take_in(between(before, self.here))
        self._trace.append(self.here)
        distance = self._distance
        success = self._clearance > 0 and distance <= ARRIVED
        reward = (
            0.5 * self._progress(distance) if self.reward_mode == "shaped" and self._clearance > 0 else 0.0
        )
        arrived = (0.5 if self.reward_mode == "shaped" else 1.0) if success else 0.0
        return reward + arrived, success or self._clearance <= 0, success

    def _progress(self, distance: float) -> float:
        """By how much the share of the way that is done, `distance` [m] being left, exceeds its best so far."""
        done = min(max(1 - distance / self._whole, 0.0), 1.0)
        gained = max(done - self._best, 0.0)
        self._best += gained
        return gained

    @property
    def _distance(self) -> float:
        return math.dist(self.setup.goal, self.here)

    @property
    def _clearance(self) -> float:
        return self._near.smallest

    def _metrics(self) -> dict[str, float]:
        setup, shortest, done, distance = (
            self.setup,
            self.setup.optimum.length,
            self.is_success,
            self._distance,
        )
        length = self.travelled + distance  # what is left of the last millimetres, too
        return {
            "collision": float(self._clearance <= 0),
            "smallest_clearance_mm": 1e3 * self._clearance,
            "violation_mm": 1e3 * max(setup.clearance - self._clearance, 0.0),
            "distance_mm": 1e3 * distance,
            "spl": float(spl(done, length, shortest)) if done else 0.0,
            "path_ratio": float(path_ratio(length, shortest)) if done else float("nan"),
            "regret": float(regret(length, shortest, self._whole)) if done else float("nan"),
        }

    def _onlooker(self) -> tuple[RigidTransform, list[tuple[Array, str]]]:
        above = np.append(self.setup.obstacle.T_world_object.translation[:2], self.setup.start[2])
        away = self.setup.start - above
        eye = above + 3.2 * away * [1, 1, 0] + np.cross([0, 0, 1], away) + [0, 0, 0.9]
        marks = [
            (np.array(self._trace), "path"),
            (self.setup.goal[None], "goal"),
            (self.here[None], "camera"),
        ]
        return fixating(eye[None], above)[0], marks
