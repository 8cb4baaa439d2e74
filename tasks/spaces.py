"""What environments observe and how a camera is moved: arrays of fixed size, and back."""

import math
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from extremal.estimator.camera import Array
from extremal.estimator.errors import InvalidInput
from extremal.tasks.compiled import compiled
from extremal.tasks.features import Features
from extremal.tasks.rigid import (
    exponential,
    inverse,
    is_finite,
    orthonormal,
    place,
    product,
    quaternion,
    reduced,
    rotation_vector,
)
from extremal.tasks.triples import Vector, plus, times

SLOTS = 64  # features that an observation holds: the visible ones first, then those seen most often
COLUMNS = (
    "radius", "sigma", "relative", "sigma_relative", "x", "y", "z", "sigma_position", "nx", "ny", "nz", "extremal",
    "reference", "visible", "contour", "looks", "plane_x", "plane_y", "plane_z",
)  # fmt: skip
MOST_VIEWS = 1 << 40
UNKNOWN = 1.0  # [m] that stands for an infinite sigma
REACH = 2.0  # [m] largest coordinate, and largest radius, of an observation
DT = 0.1  # [s] of a step
SPEED, TURN = 0.1, 1.0  # [m/s], [rad/s] at most
POSE_TURN = np.pi  # [rad] of a goal pose's rotation vector, at most

_SIGNED: dict[str, float] = {
    "radius": REACH,
    "relative": REACH,
    "x": REACH,
    "y": REACH,
    "z": REACH,
    "nx": 1,
    "ny": 1,
    "nz": 1,
    "plane_x": 1,
    "plane_y": 1,
    "plane_z": 1,
}
_MOST: dict[str, float] = {"contour": 1e4, "looks": 1e4}
_LOW = np.array([-_SIGNED.get(name, 0.0) for name in COLUMNS])
_HIGH = np.array([(_SIGNED | _MOST).get(name, 1.0) for name in COLUMNS])  # sigma 1: UNKNOWN


def feature_space() -> gym.spaces.Box:
    """(SLOTS, COLUMNS)."""
    lower, upper = (np.tile(bound.astype(np.float32), (SLOTS, 1)) for bound in (_LOW, _HIGH))
    return gym.spaces.Box(lower, upper, dtype=np.float32)


def slots(features: Features) -> NDArray[np.integer]:
    """Which features, in order, an observation holds."""
    return _order(features.visible, features.views)


def feature_rows(features: Features) -> NDArray[np.float32]:
    """Features as an observation; rows that are left over are zero: no looks."""
    f, rows = features, np.zeros((SLOTS, len(COLUMNS)), np.float32)
    _fill(
        rows, f.radius, f.sigma_radius, f.relative_radius, f.sigma_relative, f.position, f.covariance, f.normal,
        f.extremal, f.reference, f.visible, f.contour, f.views, f.plane, _LOW, _HIGH,
    )  # fmt: skip
    return rows


@compiled
def _order(visible: NDArray[np.bool_], views: NDArray[np.integer]) -> NDArray[np.integer]:
    """Up to SLOTS of n: the visible ones (n,) first, then those with the most views (n,)."""
    return np.argsort(visible * -MOST_VIEWS - views, kind="mergesort")[:SLOTS]


@compiled
def _fill(
    rows: NDArray[np.float32],
    radius: Array,
    sigma: Array,
    relative: Array,
    sigma_relative: Array,
    position: Array,
    covariance: Array,
    normal: Array,
    extremal: NDArray[np.bool_],
    reference: NDArray[np.bool_],
    visible: NDArray[np.bool_],
    contour: NDArray[np.integer],
    views: NDArray[np.integer],
    plane: Array,
    low: Array,
    high: Array,
) -> None:
    """Features, in their order, become rows of COLUMNS from `low` to `high`; NaN, where there is no relative radius, becomes 0."""
    order = _order(visible, views)
    for j in range(len(order)):
        i = order[j]
        along = 0.0
        for a in range(3):
            for b in range(3):
                along += normal[i, a] * min(covariance[i, a, b], UNKNOWN**2) * normal[i, b]
        values = (
            radius[i], sigma[i], relative[i], sigma_relative[i], position[i, 0], position[i, 1], position[i, 2],
            math.sqrt(max(along, 0.0)), normal[i, 0], normal[i, 1], normal[i, 2], 1.0 * extremal[i], 1.0 * reference[i],
            1.0 * visible[i], 1.0 * contour[i], 1.0 * views[i], plane[i, 0], plane[i, 1], plane[i, 2],
        )  # fmt: skip
        for c in range(len(values)):
            rows[j, c] = 0.0 if np.isnan(values[c]) else min(max(values[c], low[c]), high[c])


@dataclass(frozen=True, eq=False)
class SeenFeatures:
    """The rows of an observation by their names: (n,) each, position, normal and plane (n, 3)."""

    rows: NDArray[np.floating]

    @staticmethod
    def of(observation: dict[str, Any]) -> "SeenFeatures":
        """The rows that hold a feature."""
        rows = np.asarray(observation["features"], float)
        return SeenFeatures(rows[rows[:, COLUMNS.index("looks")] > 0])

    def __getattr__(self, name: str) -> Array:
        if name not in COLUMNS:
            raise AttributeError(name)
        return self.rows[:, COLUMNS.index(name)]

    @property
    def position(self) -> Array:
        return self._vectors("x")

    @property
    def normal(self) -> Array:
        return self._vectors("nx")

    @property
    def plane(self) -> Array:
        return self._vectors("plane_x")

    def _vectors(self, first: str) -> Array:
        """(n, 3) of three columns, by the name of the first."""
        return self.rows[:, COLUMNS.index(first) : COLUMNS.index(first) + 3]


def motion_space(mode: str) -> gym.spaces.Box:
    """(6,) actions of a camera: "velocity" or "pose"; InvalidInput for another mode."""
    if mode == "velocity":
        return gym.spaces.Box(-1.0, 1.0, (6,), np.float32)
    if mode == "pose":
        bound = np.array([REACH] * 3 + [POSE_TURN] * 3, np.float32)
        return gym.spaces.Box(-bound, bound, dtype=np.float32)
    raise InvalidInput(f"action_mode is {mode!r}; accepted: velocity, pose")


def checked_action(action: Any, space: gym.spaces.Box) -> Array:
    """An action, clipped to its space; InvalidInput for another shape or numbers that are not finite."""
    try:
        values = np.asarray(action).astype(float, casting="same_kind", copy=False)
    except (TypeError, ValueError):
        raise InvalidInput(f"action is {action!r:.200}; accepted: {space.shape} finite numbers") from None
    if values.shape != space.shape or not is_finite(values):
        raise InvalidInput(
            f"action is {np.array2string(values, threshold=8)}; accepted: {space.shape} finite numbers"
        )
    return _clipped(values, space.low, space.high)


@compiled
def _clipped(values: Array, low: NDArray[Any], high: NDArray[Any]) -> Array:
    out = np.empty(len(values))
    for i in range(len(values)):
        out[i] = min(max(values[i], low[i]), high[i])
    return out


def moved(pose: Array, action: Array, mode: str) -> Array:
    """Where a step takes a commanded camera pose (4, 4): at most DT SPEED and DT TURN away.

    "velocity": (linear in the world, angular in the camera frame) in shares of the largest; "pose": towards (position [m],
    rotation vector [rad]) of T_world_camera, both at their largest speed.
    """
    x, y, z, a, b, c = action.tolist()
    return _stepped(pose, (x, y, z), (a, b, c), mode == "velocity")


@compiled
def _stepped(pose: Array, way: Vector, turn: Vector, is_velocity: bool) -> Array:
    if is_velocity:
        way, turn = times(DT * SPEED, way), times(DT * TURN, turn)
    else:
        goal = exponential((0.0, 0.0, 0.0), turn)
        way = plus(way, -1.0, place(pose))
        back = inverse(pose)
        turn = reduced(rotation_vector(product(back, goal)), DT * TURN)
    way = reduced(way, DT * SPEED)
    after = product(pose, exponential((0.0, 0.0, 0.0), turn))
    for i in range(3):
        after[i, 3] = pose[i, 3] + way[i]
    orthonormal(after)  # after any number of steps
    return after


def pose_values(pose: Array) -> NDArray[np.float32]:
    """(7,) position [m] and unit quaternion x, y, z, w, w >= 0, of a pose (4, 4)."""
    return _pose_values(pose)


@compiled
def _pose_values(pose: Array) -> NDArray[np.float32]:
    out = np.empty(7, np.float32)
    out[0], out[1], out[2] = place(pose)
    out[3], out[4], out[5], out[6] = quaternion(pose)
    return out
