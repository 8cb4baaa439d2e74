"""Baselines of Grasp: a sweep past the vase, then the grasp that is likeliest to seal by what is believed of it."""

from collections.abc import Callable, Mapping
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from extremal.estimator.camera import Array
from extremal.estimator.errors import InvalidInput, SceneError
from extremal.tasks.grasp_motion import T_TABLE_BASE, CupKinematics
from extremal.tasks.planning.belief import ArcBelief
from extremal.tasks.planning.grasp import NoGrasp, plan_grasp
from extremal.tasks.policies.navigation import best, by_parallax, pose_of, steered
from extremal.tasks.policies.policy import Policy, RandomPolicy
from extremal.tasks.spaces import POSE_TURN, REACH, SPEED, SeenFeatures

AHEAD = 0.35  # [m] of the vase, at the start
ASIDE = 0.08  # [m] of its axis from there, at most
SHORT, LONG, SPEEDING = (
    0.11,
    0.16,
    0.6,
)  # [m] of a glance and of a path that leaves nothing out; share of the largest speed
NEAR_LEVEL, LEAST_LOOKS = 0.05, 5  # [m] of the grasp's height, within which contours count
ENOUGH, AGAIN = 0.0007, 2  # [m] sigma of R that will do, and ways more that are gone for it
BACK = 0.08  # [m] beyond the start, of ways back: R is known as the square of the arc that was seen
WORST = 0.03  # [m] sigma of R beyond which it says nothing
MOST = 10  # beliefs that are passed on
STEEPEST, LARGEST = 10.0, 0.12  # [1/m] of half a meridian's curvature; [m] of a radius: at most
LEAST_LEVEL = 0.1  # squared cosine to the level: a section that stands upright says nothing of the level one
MEAN_RADIUS, SPREAD = 0.05, 0.015  # [m] of vases
VASES = 0.02, 0.1  # [m] smallest and largest radius that a vase is believed to have
SURE = 1e-4  # [m] sigma of those who take their R for certain
HEIGHTS = 0.025  # [m] to either side of the level, in which the grasp may be
UP = np.array([0.0, 0.0, 1.0])


class Grasper:
    """Looks from all along a sweep, and if need be again on the way back, then grasps.

    Args:
        radius: (radius, sigma) [m] of (n,) rows: what is taken for the section's.
        step: [m] to whose multiples the vase's radius is rounded, and then taken for certain; None: it is not.
        sweep: [m] how far it goes. again: how many ways more it goes while R is not well enough known: back, beyond where it
            started, and forth.
    """

    def __init__(
        self,
        radius: Callable[[SeenFeatures], tuple[Array, Array]],
        step: float | None = None,
        sweep: float = SHORT,
        again: int = 0,
    ) -> None:
        self._radius, self._step, self._sweep, self._again = radius, step, sweep, again

    def reset(self, env: gym.Env[Any, Any], rng: np.random.Generator) -> None:
        self._start, self._arm = None, CupKinematics(T_TABLE_BASE)
        self._left, self._to = self._again, 1.0
        self._known: list[ArcBelief] = []

    def act(self, observation: Mapping[str, Any]) -> NDArray[np.floating]:
        pose = pose_of(observation)
        if self._start is None:
            self._start = pose
        swept = float(self._start.inv().apply(pose.translation)[0])
        if swept >= self._sweep if self._to > 0 else swept <= -BACK:
            # tracks may be lost on the way, and new ones not tell yet what former ones did
            self._known = min(self._known, self._beliefs(observation), key=_least_sigma)
            if self._left == 0 or _least_sigma(self._known) < ENOUGH:
                return grasp_at(self._arm, self._known, pose.translation, observation)
            self._left, self._to = self._left - 1, -self._to
        # around the vase: to the camera's right, from where it is, and back
        velocity = self._to * SPEEDING * SPEED * pose.rotation.apply([1.0, 0.0, 0.0])
        motion = steered(pose, velocity, self._start.apply([0.0, 0.0, AHEAD]))
        return np.concatenate([motion, [-1.0], np.zeros(6)])

    def _beliefs(self, observation: Mapping[str, Any]) -> list[ArcBelief]:
        """The contour generator on the right, near the grasp's height."""
        seen, pose = SeenFeatures.of(dict(observation)), pose_of(observation)
        radius, sigma = self._radius(seen)
        right = seen.normal @ pose.rotation.apply([1.0, 0.0, 0.0])
        level = float(observation["accepted"][2])
        use = (seen.extremal > 0) & (seen.reference == 0) & (seen.looks >= LEAST_LOOKS) & (sigma < WORST)
        use &= (right > 0.6) & (np.abs(seen.position[:, 2] - level) < NEAR_LEVEL) & (radius > 0.012)
        use &= np.abs(seen.normal[:, 2]) < 0.5
        assert self._start is not None
        off = (seen.position - radius[:, None] * seen.normal - self._start.apply([0.0, 0.0, AHEAD]))[:, :2]
        use &= np.linalg.norm(off, axis=1) < ASIDE + sigma  # others stand elsewhere
        rows = _plainest(seen.contour, radius / sigma, np.flatnonzero(use))
        if len(rows) == 0:
            return []
        around, spread = radius_around(
            radius[rows], sigma[rows], seen.position[rows], seen.normal[rows], seen.plane[rows]
        )
        middle = np.median(around)
        good = (around > 0.01) & (np.abs(around - middle) < 0.5 * middle + 0.005)  # others stand elsewhere
        if self._step is not None:
            around = np.full_like(around, self._step * np.round(middle / self._step))
            spread = np.full_like(around, SURE)
        near = np.argsort(np.abs(seen.position[rows, 2] - level))
        return [
            ArcBelief(
                seen.position[rows[i]],
                seen.normal[rows[i]],
                UP,
                float(around[i]),
                float(spread[i]),
                float(min(seen.sigma_position[rows[i]], 0.05)),
            )
            for i in near[good[near]][:MOST]
        ]


def _least_sigma(beliefs: list[ArcBelief]) -> float:
    """[m] of a radius; infinite of none."""
    return min((b.sigma_radius for b in beliefs), default=np.inf)


def _plainest(contour: Array, significance: Array, rows: NDArray[np.intp]) -> NDArray[np.intp]:
    """Of rows (m,) those of the contour that is curved beyond doubt: a crease of the box may pass for one at 95 %."""
    if len(rows) == 0:
        return rows
    numbers, which = np.unique(contour[rows], return_inverse=True)
    best = numbers[np.argmax(np.bincount(which, significance[rows] ** 2))]
    return rows[contour[rows] == best]


def radius_around(
    radius: Array, sigma: Array, position: Array, normal: Array, plane: Array
) -> tuple[Array, Array]:
    """Radii (n,) of the level sections and their sigma [m], from those of sections by planes (n, 3) that slant.

    A section's curvature is that of the surface along it over the cosine between its plane and the normal (Meusnier); that is
    the curvature around, weighted by what of the section's direction is level, and that of the meridian, weighted by the rest
    (Euler). The meridian's comes from how far out the contour generator lies at different heights.
    """
    along, level = np.cross(normal, plane), np.cross(normal, UP)
    cosine, upright = np.linalg.norm(along, axis=1), np.linalg.norm(level, axis=1)
    around = np.maximum((np.sum(along * level, axis=1) / (cosine * upright)) ** 2, LEAST_LEVEL)
    out = np.mean(normal * [1.0, 1.0, 0.0], axis=0)
    meridian = 0.0
    if len(radius) >= 3 and np.ptp(position[:, 2]) > 0.04:
        bend = np.polyfit(position[:, 2], position @ out / np.linalg.norm(out), 2)[0]
        meridian = -2.0 * float(np.clip(bend, -STEEPEST, STEEPEST))
    curvature = (cosine / radius - (1 - around) * meridian * upright**3) / around
    found = upright / np.maximum(curvature, upright / LARGEST)
    return found, sigma * (found / radius) ** 2 * cosine / (around * upright)


class Knowing:
    """The oracle: the contour generator as it is, at once."""

    def reset(self, env: gym.Env[Any, Any], rng: np.random.Generator) -> None:
        self._env, self._arm = env.unwrapped, CupKinematics(T_TABLE_BASE)

    def act(self, observation: Mapping[str, Any]) -> NDArray[np.floating]:
        setup, eye = self._env.setup, self._env.actual.translation  # pyright: ignore[reportAttributeAccessIssue]
        right = self._env.actual.rotation.apply([1.0, 0.0, 0.0])  # pyright: ignore[reportAttributeAccessIssue]
        beliefs = []
        for curve in setup.vase.contour_generator(eye):
            use = (curve.normals @ right > 0.3) & (np.abs(curve.points[:, 2] - setup.level) < NEAR_LEVEL)
            rows = np.flatnonzero(use)[:: max(1, int(use.sum()) // MOST)]
            radii = setup.vase.section_radius(curve.points[rows], np.tile(UP, (len(rows), 1)))
            beliefs += [
                ArcBelief(p, n, UP, float(r), SURE, SURE)
                for p, n, r in zip(curve.points[rows], curve.normals[rows], radii, strict=True)
            ]
        return grasp_at(self._arm, beliefs, eye, observation)


def grasp_at(
    arm: CupKinematics, beliefs: list[ArcBelief], eye: Array, observation: Mapping[str, Any]
) -> NDArray[np.floating]:
    """The action that grasps where a seal is likeliest in the accepted azimuths; any other where there is no such place."""
    nowhere = np.concatenate([np.zeros(6), [1.0], np.zeros(6)])
    if not beliefs:
        return nowhere
    low, high, level = (float(v) for v in observation["accepted"])
    try:
        normal = np.mean([b.normal for b in beliefs], axis=0)
        generator = float(np.mod(np.arctan2(normal[1], normal[0]), 2 * np.pi))
        inside = 0.1 * (high - low)  # for what is believed of the generator is not exact
        plan = plan_grasp(
            beliefs,
            eye,
            arm,
            np.asarray(observation["joints"], float),
            (low - generator + inside, high - generator - inside),
            (level - HEIGHTS, level + HEIGHTS),
        )
    except (NoGrasp, InvalidInput, SceneError):
        return nowhere
    cup = plan.T_world_cup
    values = [*(cup.translation / REACH), *(cup.rotation.as_rotvec() / POSE_TURN)]
    return np.concatenate([np.zeros(6), [1.0], values])


def without_parallax(seen: SeenFeatures) -> tuple[Array, Array]:
    """Each contour's own, as far as vases go, and taken for certain."""
    return np.clip(seen.radius, *VASES), np.where(seen.sigma < 1.0, SURE, 1.0)


def mean_object(seen: SeenFeatures) -> tuple[Array, Array]:
    """Every vase is the mean one."""
    return np.full(len(seen.rows), MEAN_RADIUS), np.full(len(seen.rows), SPREAD)


BASELINES: dict[str, Callable[[], Policy]] = {
    "random": RandomPolicy,
    "oracle": Knowing,
    "active": lambda: Grasper(best, sweep=LONG, again=AGAIN),
    "parallax": lambda: Grasper(by_parallax),
    "absolute": lambda: Grasper(without_parallax, step=0.01),
    "blind": lambda: Grasper(mean_object),
}
