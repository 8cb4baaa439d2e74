"""`extremal/Inspect-v0`: look around, then say what a contour is."""

from typing import Any

import gymnasium as gym
import numpy as np
from scipy.spatial.transform import RigidTransform

from extremal.estimator.camera import Array
from extremal.estimator.errors import DegenerateGeometry, InvalidInput
from extremal.scenes import Scene
from extremal.sim import fixating
from extremal.tasks.answers import (
    LARGEST,
    Answer,
    is_right,
    negative_log_likelihood,
    quality,
)
from extremal.tasks.clearance import Clearance, between
from extremal.tasks.environment import ActiveVisionEnv, Observation
from extremal.tasks.inspect_setup import InspectSetup, InspectTruth, inspect_truth
from extremal.tasks.question import Question, Tracked
from extremal.tasks.spaces import REACH, SLOTS, motion_space, slots
from extremal.tasks.tiers import Tier

SPHERE = 0.02  # [m] radius of the camera
PATH_WORTH, PATH_LONG = 0.2, 1.0  # share of the reward that a path of so many metres costs
UNSEEN = 0.05  # [m] of R, where nothing was seen


class InspectEnv(ActiveVisionEnv[InspectSetup]):
    """Look around with a hand-held camera, then answer for one outline of an object: R, contact point, label.

    An object stands on a table beside a box (see `inspect_setup`). The question is about the outline of object or box furthest to
    one side at the level that the camera fixates; `query` says where it is seen at the start. Scores are the truth's, for the view
    in which the answer is given: an outline of the object slides over it as the camera moves; of the box, the edge stays the one
    that was asked about. What features say of R is true in the middle of the arc from which they were seen: so answer there.

    ## Action space

    `Box((7,), float32)`: 0-5 move the camera as in `extremal/Navigate-v0`; 6 above 0: answer now. With `answer="policy"`, `Box((13,),
    float32)`, the policy's own answer follows:

    | # | answer | unit |
    |---|---|---|
    | 7 | probability that the contour is an extremal boundary | -1 (0 %) to 1 (100 %) |
    | 8 | R | 0.1 m |
    | 9 | sigma of R | -1 to 1: 0.1 mm to 0.1 m, logarithmic |
    | 10-12 | contact point, world, as believed | 2 m |

    With `answer="estimator"` (the default) the answer is the estimator's.

    ## Observation space

    As `extremal/Navigate-v0`, with two keys in place of `goal`:

    | key | shape | meaning |
    |---|---|---|
    | `query` | (2,) | pixel of the contour in the first view, in widths of the image |
    | `target` | (64,) | 1 for rows of `features` that belong to that contour (not in `obs_mode="rgb"`) |

    ## Rewards

    At the answer alone. `"sparse"`: 1 if it is right: label, R within 2 mm or 10 %, contact point within 10 mm. `"shaped"`: in
    [0, 1], proper scores of label (Brier) and R (CRPS, worthless at 20 mm), less a fifth for a path of 1 m.

    ## Episode end

    Terminated by the answer, on contact, and after `max_steps`, where the answer is given as it stands.

    ## Info

    `is_success`; `answered`, `collision` (0, 1); once answered `radius_error_mm` (extremal boundaries), `place_error_mm`,
    `label_right`, `negative_log_likelihood` (nats, R in mm) and `quality`; `path_length_m`; `steps`.

    ## Seeds and arguments

    As `extremal/Navigate-v0`.
    """

    def __init__(self, answer: str = "estimator", **arguments: Any) -> None:
        if answer not in ("estimator", "policy"):
            raise InvalidInput(f"answer is {answer!r}; accepted: estimator, policy")
        self._own_answer = answer == "policy"
        super().__init__(**arguments)

    def _draw(self, seed: int, tier: Tier) -> InspectSetup:
        return InspectSetup.draw(seed, tier)

    def _scene(self) -> tuple[Scene, RigidTransform]:
        return self.setup.scene, self.setup.T_world_camera

    def _actions(self) -> gym.spaces.Box:
        motion, more = motion_space(self.action_mode), np.ones(7 if self._own_answer else 1, np.float32)
        return gym.spaces.Box(np.append(motion.low, -more), np.append(motion.high, more), dtype=np.float32)

    def _observations(self) -> dict[str, gym.Space[Any]]:
        found = super()._observations() | {"query": gym.spaces.Box(-1.0, 2.0, (2,), np.float32)}
        if self.obs_mode != "rgb":
            found["target"] = gym.spaces.Box(0.0, 1.0, (SLOTS,), np.float32)
        return found

    def _begin(self) -> None:
        asked = inspect_truth(self.setup, self.actual).point
        self._query = self.camera.project(self.actual.inv().apply(asked))
        self._shown_query = np.clip(self._query / self.camera.width, -1, 2).astype(np.float32)
        self._question = Question(self.camera, self.commanded, self._query)
        self._collision, self._scores = False, dict.fromkeys(_SCORES, float("nan"))
        self._near = Clearance(self.scene, SPHERE, smallest=0.0)
        self._trace = [self.here]

    def _extra(self) -> Observation:
        extra: Observation = {"query": self._shown_query.copy()}
        if self.obs_mode != "rgb":
            rows = np.zeros(SLOTS, np.float32)
            order = slots(self.features)
            rows[: len(order)] = self._belongs()[order]
            extra["target"] = rows
        return extra

    def _belongs(self) -> np.ndarray:
        """Which features lie on the contour that is asked about."""
        return self._question.belongs(self._tracked())

    def _tracked(self) -> Tracked:
        f = self.features
        return Tracked(f.position, f.normal, f.contour, f.views, f.best_radius, f.best_sigma)

    def _judge(self, action: Array, before: Array) -> tuple[float, bool, bool]:
        here = self.here
        self._trace.append(here)
        self._near.take_in(between(before, here))
        self._collision = self._near.smallest < 0
        if self._collision:
            return 0.0, True, False
        if action[6] <= 0 and self.steps < self.max_steps:
            return 0.0, False, False
        answer = _policys(action[7:]) if self._own_answer else self._estimators()
        try:
            truth = inspect_truth(self.setup, self.actual)
        except DegenerateGeometry:
            return 0.0, True, False  # from here the question makes no sense
        success, worth = is_right(answer, truth), quality(answer, truth)
        self._scores = _scored(answer, truth) | {"quality": worth}
        path = 1 - PATH_WORTH * min(self.travelled / PATH_LONG, 1.0)
        return (float(success) if self.reward_mode == "sparse" else worth * path), True, success

    def _estimators(self) -> Answer:
        """The estimator's answer: what the features on the contour say."""
        found = self._question.answer(self.T_commanded[:3, 3], self._tracked())
        return found or Answer(0.5, UNSEEN, LARGEST / np.sqrt(12), self.commanded.apply([0.0, 0.0, 0.5]))

    def _metrics(self) -> dict[str, float]:
        answered = float(np.isfinite(self._scores["quality"]))
        return {"answered": answered, "collision": float(self._collision)} | self._scores

    def _onlooker(self) -> tuple[RigidTransform, list[tuple[Array, str]]]:
        start, middle = self._trace[0], self.setup.fixation
        eye = middle + 1.3 * (start - middle) + [0.0, -0.25, 0.3]
        return fixating(eye[None], middle)[0], [
            (np.array(self._trace), "path"),
            (self._trace[-1][None], "camera"),
        ]


_SCORES = ("radius_error_mm", "place_error_mm", "label_right", "negative_log_likelihood", "quality")


def _policys(values: Array) -> Answer:
    """The answer that a policy gives: see the action space."""
    sigma = 1e-4 * 10 ** (1.5 * (values[2] + 1))
    return Answer((values[0] + 1) / 2, LARGEST * values[1], sigma, REACH * values[3:])


def _scored(answer: Answer, truth: InspectTruth) -> dict[str, float]:
    return {
        "radius_error_mm": float("nan") if truth.is_fixed else 1e3 * abs(answer.radius - truth.radius),
        "place_error_mm": 1e3 * float(np.linalg.norm(answer.point - truth.point)),
        "label_right": float((answer.extremal > 0.5) == (not truth.is_fixed)),
        "negative_log_likelihood": negative_log_likelihood(answer, truth),
    }
