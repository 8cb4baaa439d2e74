"""Baselines of Inspect: a sweep sideways, and answers by better and better knowledge. With `answer="policy"`.

Radii are those of the arc that was seen, in its middle: whoever answers from the end of the sweep says what was true half-way.
"""

from collections.abc import Callable, Mapping
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from extremal.estimator.camera import Array
from extremal.tasks.answers import LARGEST, RIGHT, RIGHT_SHARE, Answer
from extremal.tasks.inspect_setup import inspect_truth
from extremal.tasks.policies.navigation import best, by_parallax, pose_of, steered
from extremal.tasks.policies.policy import Policy, RandomPolicy
from extremal.tasks.question import AHEAD, Question, Tracked
from extremal.tasks.spaces import DT, REACH, SPEED, SeenFeatures

SWEEP, LEAST_SWEEP = 0.4, 0.1  # [m] sideways
ENOUGH = 0.5  # sigma of R, in errors of an answer that is right, at which a sweep ends
MEAN_RADIUS, SPREAD = 0.045, 0.02  # [m] of objects
EXTREMAL = 0.75  # how often contours that are asked about are extremal
Knowledge = Callable[[SeenFeatures], tuple[Array, Array]]


class Knowing:
    """The oracle answers at once."""

    def reset(self, env: gym.Env[Any, Any], rng: np.random.Generator) -> None:
        self._env = env.unwrapped

    def act(self, observation: Mapping[str, Any]) -> NDArray[np.floating]:
        truth = inspect_truth(self._env.setup, self._env.actual)  # pyright: ignore[reportAttributeAccessIssue]
        return answered(Answer(float(not truth.is_fixed), truth.radius, 2e-4, truth.point))


class Sweep:
    """Moves sideways while it fixates, until R is known well enough or the way was long enough; then it answers.

    Args:
        knowledge: (radius, sigma) [m] of (n,) rows: what is taken for the section's.
        back: whether it first goes back to the middle of the sweep, where the radius is what the whole arc tells.
    """

    def __init__(self, knowledge: Knowledge, back: bool) -> None:
        self._knowledge, self._back = knowledge, back

    def reset(self, env: gym.Env[Any, Any], rng: np.random.Generator) -> None:
        self._camera = env.unwrapped.camera  # pyright: ignore[reportAttributeAccessIssue]
        self._start: RigidTransform | None = None
        self._goal: float | None = None

    def act(self, observation: Mapping[str, Any]) -> NDArray[np.floating]:
        pose = pose_of(observation)
        if self._start is None:
            query = self._camera.width * np.asarray(observation["query"], float)
            self._start, self._question = pose, Question(self._camera, pose, query)
            self._side = 1.0 if query[0] > self._camera.cx else -1.0
        sideways = self._side * self._start.rotation.apply([1.0, 0.0, 0.0])
        gone = float((pose.translation - self._start.translation) @ sideways)
        if self._goal is None:
            found = self._answer(observation, pose)
            wanted = 0.0 if found is None else ENOUGH * max(RIGHT, RIGHT_SHARE * found.radius)
            enough = found is not None and found.sigma < wanted and gone >= LEAST_SWEEP
            if not (enough or gone >= SWEEP - 1e-6):
                return self._move(pose, sideways)
            self._goal = gone / 2 if self._back else gone
        if gone > self._goal + 0.5 * DT * SPEED:
            return self._move(pose, -sideways)
        there = self._start.apply([0.0, 0.0, AHEAD])
        return answered(self._answer(observation, pose) or Answer(0.5, MEAN_RADIUS, SPREAD, there))

    def _move(self, pose: RigidTransform, direction: Array) -> NDArray[np.floating]:
        assert self._start is not None
        motion = steered(pose, SPEED * direction, self._start.apply([0.0, 0.0, AHEAD]))
        return np.concatenate([motion, [-1.0], np.zeros(6)])

    def _answer(self, observation: Mapping[str, Any], pose: RigidTransform) -> Answer | None:
        seen = SeenFeatures.of(dict(observation))
        known = Tracked(seen.position, seen.normal, seen.contour, seen.looks, *self._knowledge(seen))
        return self._question.answer(pose.translation, known)


class Blind:
    """Looks where the contour is, without a sweep, and says of it what is true of most."""

    def reset(self, env: gym.Env[Any, Any], rng: np.random.Generator) -> None:
        self._camera = env.unwrapped.camera  # pyright: ignore[reportAttributeAccessIssue]

    def act(self, observation: Mapping[str, Any]) -> NDArray[np.floating]:
        pose, query = pose_of(observation), self._camera.width * np.asarray(observation["query"], float)
        ray = pose.rotation.apply(self._camera.rays(query))
        return answered(Answer(EXTREMAL, MEAN_RADIUS, SPREAD, pose.translation + AHEAD * ray))


def answered(answer: Answer) -> NDArray[np.floating]:
    """The action that gives an answer."""
    sigma = np.log10(answer.sigma / 1e-4) / 1.5 - 1
    values = [2 * answer.extremal - 1, answer.radius / LARGEST, sigma, *(answer.point / REACH)]
    return np.clip(np.concatenate([np.zeros(6), [1.0], values]), -1, 1)


def to_the_centimetre(seen: SeenFeatures) -> tuple[Array, Array]:
    """Without parallax, to the nearest centimetre."""
    return np.round(seen.radius, 2), np.where(seen.sigma < 1.0, 0.005, 1.0)


BASELINES: dict[str, Callable[[], Policy]] = {
    "random": RandomPolicy,
    "oracle": Knowing,
    "active": lambda: Sweep(best, back=True),
    "parallax": lambda: Sweep(by_parallax, back=False),
    "absolute": lambda: Sweep(to_the_centimetre, back=False),
    "blind": Blind,
}
