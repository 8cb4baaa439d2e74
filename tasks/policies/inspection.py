"""Baselines of Inspect: a sweep sideways, and answers by better and better knowledge. With `answer="policy"`."""

from collections.abc import Callable, Mapping
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from extremal.estimator.camera import Array
from extremal.tasks.answers import LARGEST, Answer, contact_from, probability_extremal
from extremal.tasks.inspect import LEAST_LOOKS
from extremal.tasks.inspect_setup import inspect_truth
from extremal.tasks.policies.navigation import best, by_parallax, pose_of, steered
from extremal.tasks.policies.policy import Policy, RandomPolicy
from extremal.tasks.spaces import REACH, SPEED, SeenFeatures

AHEAD = 0.55  # [m] of the object, until features tell
SWEEP, ENOUGH = 0.3, 0.0015  # [m] of the path at most; sigma of R at which it ends
MEAN_RADIUS, SPREAD = 0.045, 0.02  # [m] of objects
EXTREMAL = 0.75  # how often contours that are asked about are extremal


class Knowing:
    """The oracle answers at once."""

    def reset(self, env: gym.Env[Any, Any], rng: np.random.Generator) -> None:
        self._env = env.unwrapped

    def act(self, observation: Mapping[str, Any]) -> NDArray[np.floating]:
        truth = inspect_truth(self._env.setup, self._env.actual)  # pyright: ignore[reportAttributeAccessIssue]
        return answered(Answer(float(not truth.is_fixed), truth.radius, 2e-4, truth.point))


class Sweep:
    """Moves sideways while it fixates, and answers when R is known well enough or the way was long enough.

    Args:
        radius: (radius, sigma) [m] of (n,) rows: what is taken for the section's.
    """

    def __init__(self, radius: Callable[[SeenFeatures], tuple[Array, Array]] | None) -> None:
        self._radius = radius

    def reset(self, env: gym.Env[Any, Any], rng: np.random.Generator) -> None:
        self._start = None

    def act(self, observation: Mapping[str, Any]) -> NDArray[np.floating]:
        pose = pose_of(observation)
        if self._start is None:
            self._start = pose
            self._to = 1.0 if float(observation["query"][0]) > 0.5 else -1.0
        answer = self._answer(observation)
        travelled = float(np.linalg.norm(pose.translation - self._start.translation))
        if travelled >= SWEEP or (answer is not None and answer.sigma < ENOUGH and self._radius is not None):
            return answered(answer or Answer(0.5, MEAN_RADIUS, SPREAD, self._start.apply([0, 0, AHEAD])))
        velocity = SPEED * self._to * self._start.rotation.apply([1.0, 0.0, 0.0])
        motion = steered(pose, velocity, self._start.apply([0.0, 0.0, AHEAD]))
        return np.concatenate([motion, [-1.0], np.zeros(6)])

    def _answer(self, observation: Mapping[str, Any]) -> Answer | None:
        seen = SeenFeatures.of(dict(observation))
        rows = np.asarray(observation["target"])[: len(seen.rows)] > 0
        seen = SeenFeatures(seen.rows[rows])
        radius, sigma = best(seen) if self._radius is None else self._radius(seen)
        use = (seen.looks >= LEAST_LOOKS) & (sigma < 1.0)
        if not use.any():
            return None
        weight = sigma[use] ** -2 / np.sum(sigma[use] ** -2)
        place = weight @ seen.position[use]
        normal, eye = weight @ seen.normal[use], pose_of(observation).translation
        if self._radius is None:
            return Answer(EXTREMAL, MEAN_RADIUS, SPREAD, contact_from(eye, place, normal, MEAN_RADIUS))
        mean, least = float(weight @ radius[use]), float(sigma[use].min())
        place = contact_from(eye, place, normal, mean)
        return Answer(probability_extremal(mean, least), mean, least, place)


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
    "active": lambda: Sweep(best),
    "parallax": lambda: Sweep(by_parallax),
    "absolute": lambda: Sweep(to_the_centimetre),
    "blind": lambda: Sweep(None),
}
