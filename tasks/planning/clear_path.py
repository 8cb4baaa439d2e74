"""Ways for the arm to a place before the vase that keep clear of everything, as far as it is believed."""

from collections.abc import Iterator, Sequence
from itertools import pairwise, product

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from extremal.estimator.camera import Array
from extremal.scenes import Surface
from extremal.sim import UnreachablePose
from extremal.tasks.grasp_model import TARGET, grasp_model
from extremal.tasks.grasp_motion import CupKinematics, cup_facing

MARGIN = 0.005  # kept between the arm and what is believed [m]
FINEST = 0.02  # between looks along a path [rad]
STANDOFFS, RAISES = (0.05, 0.1, 0.15), (0.0, 0.1)  # of a way around the target, from where it ends [m]
CHORD = 0.2  # between poses of the way around [rad]


class ClearPaths:
    """Collision-free joint paths beside what is believed.

    Args:
        arm: as it is believed.
        target: what is to be grasped.
        obstacles: what else is there.
    """

    def __init__(self, arm: CupKinematics, target: Surface, obstacles: Sequence[Surface] = ()) -> None:
        self.arm, self.target = arm, target
        self._model = grasp_model(target, obstacles, arm.T_world_base, arm.believed, 1.0, 0.5)
        self._model.geom_margin[:] = MARGIN
        self._model.body_margin[:] = MARGIN
        self._data = mujoco.MjData(self._model)
        bodies = self._model.geom_bodyid
        self._is_target = bodies == self._model.body(TARGET).id
        self._is_fixed = bodies == 0

    def clear(self, path: Array, ignore_target: bool = False) -> bool:
        """Whether the arm keeps `MARGIN` along joint positions (V, 6) and straight between them.

        Args:
            ignore_target: for the way on which the lip is to meet it.
        """
        return not any(self._touches(q, ignore_target) for q in _dense(path))

    def _touches(self, q: Array, ignore_target: bool) -> bool:
        model, data = self._model, self._data
        data.qpos[:6] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        pairs = data.contact.geom
        on_target = self._is_target[pairs]
        if ignore_target:
            allowed: NDArray[np.bool_] = on_target.any(axis=1)
        else:
            allowed = on_target.any(axis=1) & self._is_fixed[pairs].any(axis=1)
        return not bool(np.all(allowed))

    def path_to(self, start: Array, T_world_cup: RigidTransform, axis_point: Array) -> Array | None:
        """Joint positions (V, 6) from `start` (6,) to a pose of the cup; None where no way is found.

        Straight in joint space where that is clear; else around the vertical through `axis_point` (3,) in wider and higher
        arcs, the cup towards it.
        """
        try:
            path = self.arm.joint_path_to(start, T_world_cup)
            if self.clear(path):
                return path
        except UnreachablePose:
            pass
        for poses in self._ways_around(start, T_world_cup, axis_point):
            path = self._through(start, poses)
            if path is not None:
                return path
        return None

    def _through(self, start: Array, poses: RigidTransform) -> Array | None:
        """Joint positions (V, 6) straight from pose to pose; None where a step is out of reach or not clear."""
        parts = [start[None]]
        for pose in poses:
            try:
                parts.append(self.arm.straight(parts[-1][-1], pose))
            except UnreachablePose:
                return None
            if not self.clear(parts[-1]):
                return None
        return np.concatenate([parts[0], *(part[1:] for part in parts[1:])])

    def _ways_around(
        self, start: Array, T_world_cup: RigidTransform, axis_point: Array
    ) -> Iterator[RigidTransform]:
        """Poses (K) of the cup on arcs towards its goal, the shorter way first."""
        begin = self.arm.cup_poses(start[None])[0].translation - axis_point
        end = T_world_cup.translation - axis_point
        first, last = (np.arctan2(p[1], p[0]) for p in (begin, end))
        turn = np.remainder(last - first + np.pi, 2 * np.pi) - np.pi
        distance = np.hypot(end[0], end[1])
        ways = (turn, turn - np.copysign(2 * np.pi, turn))
        for standoff, rise, way in product(STANDOFFS, RAISES, ways):
            angle = first + np.linspace(0, way, int(np.ceil(abs(way) / CHORD)) + 1)
            n = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=-1)
            points = axis_point * (1, 1, 0) + (distance + standoff) * n
            points[:, 2] = T_world_cup.translation[2] + rise
            yield RigidTransform.concatenate([cup_facing(points, n), T_world_cup])


def _dense(path: Array) -> Iterator[Array]:
    """Joint positions (6,) along a path (V, 6), at most `FINEST` apart."""
    yield path[0]
    for a, b in pairwise(path):
        count = int(np.ceil(np.max(np.abs(b - a)) / FINEST)) or 1
        for s in np.arange(1, count + 1) / count:
            yield a + s * (b - a)
