"""Baselines of Navigate: strings around what is known of the obstacle, by better and better knowledge.

All but `oracle` start the same way: past the obstacle, a little away from it, until contours are tracked. From then on the
newest contour generator near the camera's own level is an `ArcBelief`; earlier ones stay the strip already passed. `absolute` and
`blind` look no further than the first.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from extremal.estimator.camera import Array
from extremal.sim import fixating
from extremal.tasks.navigate_setup import CLEARANCE, SPHERE
from extremal.tasks.planning.arcs import plan_around
from extremal.tasks.planning.belief import ArcBelief, Caution
from extremal.tasks.planning.pursuit import next_velocity
from extremal.tasks.policies.policy import Policy, RandomPolicy
from extremal.tasks.spaces import DT, SPEED, TURN, SeenFeatures

MEAN_RADIUS, SPREAD = 0.1, 0.03  # [m] of obstacles
LEVEL = 0.05  # [m] from the camera's level, within which a contour generator counts
SAME = 0.006  # [m] between contact points that are one
LEAST_LOOKS, WORST = 5, 0.06  # looks and sigma [m], before which a radius says nothing
STRIDE = 0.12  # [m] from one contact point to the next that is tracked, where it moves on along the obstacle
MOST = 0.5  # of a contour's points are curved, if it is a limb
SHARPEST = 0.012  # [m] what is sharper is an edge that was taken for a contour
OUTWARD = np.radians(25)  # of the first steps from the optical axis
UNSEEN = 0.25  # of the radius, of which it is known where the contour generator is out of sight, at best
MARGIN = 0.002  # [m] on top of the wanted clearance: for poses


class Knowing:
    """The oracle: along the true shortest path."""

    def reset(self, env: gym.Env[Any, Any], rng: np.random.Generator) -> None:
        setup = env.unwrapped.setup  # pyright: ignore[reportAttributeAccessIssue]
        self._points = setup.optimum.points

    def act(self, observation: Mapping[str, Any]) -> NDArray[np.floating]:
        pose = pose_of(observation)
        return steered(pose, next_velocity(pose.translation, self._points, SPEED, DT), None)


class Around:
    """Follows the string around what is believed.

    Args:
        radius: (radius, sigma) [m] of (n,) rows: what is taken for the section's.
        again: whether the plan follows the belief as it sharpens; else the first is kept for each contour.
        once: whether the first contour is all that is looked at.
    """

    def __init__(
        self,
        radius: Callable[[SeenFeatures], tuple[Array, Array]],
        k: float = 2.0,
        again: bool = True,
        once: bool = False,
    ) -> None:
        self._radius, self._again, self._once = radius, again, once
        self._caution = Caution(SPHERE + CLEARANCE + MARGIN, k)

    def reset(self, env: gym.Env[Any, Any], rng: np.random.Generator) -> None:
        self._beliefs: list[ArcBelief] = []
        self._start: RigidTransform | None = None

    def act(self, observation: Mapping[str, Any]) -> NDArray[np.floating]:
        pose, goal = pose_of(observation), np.asarray(observation["goal"], float)
        self._start = pose if self._start is None else self._start
        found = self._believed(SeenFeatures.of(dict(observation)), pose)
        if found is not None:
            self._remember(found)
        if not self._beliefs:
            return steered(pose, self._first_step(goal), None)
        *earlier, newest = self._beliefs
        beliefs = [*earlier, _unseen(newest) if self._again and not found else newest]
        plan, _ = plan_around(pose.translation, goal, [beliefs], self._caution)
        velocity = next_velocity(pose.translation, plan.waypoints, SPEED, DT)
        return steered(pose, velocity, self._beliefs[-1].point)

    def _first_step(self, goal: Array) -> Array:
        """Forward and away from the obstacle, which hides the goal."""
        assert self._start is not None
        there = self._start.inv().apply(goal)
        away = -np.sign(there[0]) or 1.0
        along = np.array([away * np.sin(OUTWARD), 0.0, np.cos(OUTWARD)])
        return SPEED * self._start.rotation.apply(along)

    def _believed(self, seen: SeenFeatures, pose: RigidTransform) -> ArcBelief | None:
        """The contour generator that is in view at the camera's level."""
        radius, sigma = self._radius(seen)
        use = self._of_limb(seen, pose, radius) & (sigma < WORST)
        if use.sum() < 2:
            return None
        distance = np.linalg.norm(seen.position - pose.translation, axis=1)
        use &= distance < 1.3 * np.median(distance[use]) + 0.02
        weight = 1 / (sigma[use] ** 2 + 1e-8)
        weight /= weight.sum()
        normal = weight @ seen.normal[use]
        # errors of neighbours are much alike: their mean is not better than the best of them
        return ArcBelief(
            weight @ seen.position[use],
            normal,
            np.array([0.0, 0.0, 1.0]),
            float(weight @ radius[use]),
            float(np.min(sigma[use])),
            float(np.min(seen.sigma_position[use])),
        )

    def _of_limb(self, seen: SeenFeatures, pose: RigidTransform, radius: Array) -> NDArray[np.bool_]:
        """Which features (n,) are of a limb of the obstacle at the camera's level."""
        ray = seen.position - pose.translation
        tangent = np.abs(np.sum(ray * seen.normal, axis=1)) < 0.6 * np.linalg.norm(ray, axis=1)
        there = tangent & (np.abs(ray[:, 2]) < LEVEL) & (np.abs(seen.normal[:, 2]) < 0.7)
        there &= (seen.visible > 0) & (seen.looks >= LEAST_LOOKS)
        if self._beliefs:
            there &= np.linalg.norm(seen.position - self._beliefs[-1].point, axis=1) < STRIDE
        curved = there & (seen.extremal > 0) & (seen.reference == 0) & (radius > SHARPEST)
        # some points of an edge pass for curved: of a limb most do
        alike = (seen.contour[:, None] == seen.contour).astype(float)
        return curved & (alike @ curved > MOST * (alike @ there))

    def _remember(self, found: ArcBelief) -> None:
        for i, known in enumerate(self._beliefs):
            if np.linalg.norm(known.point - found.point) < SAME:
                if self._again:
                    self._beliefs[i] = found
                return
        if not (self._once and self._beliefs):
            self._beliefs.append(found)


def _unseen(belief: ArcBelief) -> ArcBelief:
    """Of a contour generator that is out of sight: mostly because its radius changes faster than it could be followed."""
    return replace(belief, sigma_radius=max(belief.sigma_radius, UNSEEN * belief.radius))


def pose_of(observation: Mapping[str, Any]) -> RigidTransform:
    """T_world_camera, as it is believed to be."""
    values = np.asarray(observation["pose"], float)
    return RigidTransform.from_components(values[:3], Rotation.from_quat(values[3:]))


def steered(pose: RigidTransform, velocity: Array, target: Array | None) -> NDArray[np.floating]:
    """The velocity action that moves the camera by `velocity` (3,) [m/s] while it turns to a point (3,), if there is one."""
    turn = np.zeros(3)
    if target is not None:
        after = pose.translation + DT * velocity
        if np.linalg.norm(target - after) > 0.02:
            turn = (pose.rotation.inv() * fixating(after[None], target)[0].rotation).as_rotvec() / DT
    share = min(1.0, TURN / max(float(np.linalg.norm(turn)), 1e-12))
    return np.concatenate([velocity / SPEED, turn * share / TURN])


def best(seen: SeenFeatures) -> tuple[Array, Array]:
    """Relative to references where there are any."""
    known = seen.sigma_relative < np.minimum(seen.sigma, 1.0)
    return np.where(known, seen.relative, seen.radius), np.where(known, seen.sigma_relative, seen.sigma)


def by_itself(seen: SeenFeatures) -> tuple[Array, Array]:
    """From all looks at the contour itself, without references."""
    return seen.radius, seen.sigma


def by_parallax(seen: SeenFeatures) -> tuple[Array, Array]:
    """Relative to references alone."""
    return seen.relative, seen.sigma_relative


def to_the_centimetre(seen: SeenFeatures) -> tuple[Array, Array]:
    """Without parallax, as the book found it: to the nearest centimetre."""
    return np.round(seen.radius, 2), np.minimum(seen.sigma, 0.01)


def mean_object(seen: SeenFeatures) -> tuple[Array, Array]:
    """Every obstacle is the mean one."""
    return np.full(len(seen.rows), MEAN_RADIUS), np.full(len(seen.rows), SPREAD)


BASELINES: dict[str, Callable[[], Policy]] = {
    "random": RandomPolicy,
    "oracle": Knowing,
    "active": lambda: Around(by_itself),
    "parallax": lambda: Around(best, again=False),  # many obstacles stand where nothing fixed is seen
    "absolute": lambda: Around(to_the_centimetre, k=0.0, again=False, once=True),
    "blind": lambda: Around(mean_object, k=0.0, again=False, once=True),
}
