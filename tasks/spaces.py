"""What environments observe and how a camera is moved: arrays of fixed size, and back."""

import math
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from extremal.estimator.camera import Array
from extremal.estimator.errors import InvalidInput
from extremal.tasks.features import Features

SLOTS = 48  # features that an observation holds: the visible ones first, then those seen most often
COLUMNS = (
    "radius", "sigma", "relative", "sigma_relative", "x", "y", "z", "sigma_position", "nx", "ny", "nz", "extremal",
    "reference", "visible", "contour", "looks",
)  # fmt: skip
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
    return np.lexsort((-features.views, ~features.visible))[:SLOTS]


def feature_rows(features: Features) -> NDArray[np.float32]:
    """Features as an observation; rows that are left over are zero: no looks."""
    f, order = features, slots(features)
    rows = np.zeros((SLOTS, len(COLUMNS)), np.float32)
    if not len(order):
        return rows
    along = ((f.normal[:, None] @ np.minimum(f.covariance, UNKNOWN**2))[:, 0] * f.normal).sum(axis=1)
    values = np.empty((len(f), len(COLUMNS)))
    values[:, 0], values[:, 2] = f.radius, f.relative_radius
    values[:, 1], values[:, 3], values[:, 7] = f.sigma_radius, f.sigma_relative, np.sqrt(np.maximum(along, 0))
    values[:, 4:7], values[:, 8:11] = f.position, f.normal
    values[:, 11], values[:, 12], values[:, 13] = f.extremal, f.reference, f.visible
    values[:, 14], values[:, 15] = f.contour, f.views
    np.copyto(values, 0.0, where=np.isnan(values))  # no relative radius
    rows[: len(order)] = np.minimum(np.maximum(values[order], _LOW), _HIGH)
    return rows


@dataclass(frozen=True, eq=False)
class SeenFeatures:
    """The rows of an observation by their names: (n,) each, position and normal (n, 3)."""

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
        return self.rows[:, COLUMNS.index("x") : COLUMNS.index("x") + 3]

    @property
    def normal(self) -> Array:
        return self.rows[:, COLUMNS.index("nx") : COLUMNS.index("nx") + 3]


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
    values = np.asarray(action, float)
    if values.shape != space.shape or not np.isfinite(values).all():
        raise InvalidInput(
            f"action is {np.array2string(values, threshold=8)}; accepted: {space.shape} finite numbers"
        )
    return np.minimum(np.maximum(values, space.low), space.high)


def moved(pose: RigidTransform, action: Array, mode: str) -> RigidTransform:
    """Where a step takes a commanded camera pose: at most DT SPEED and DT TURN away.

    "velocity": (linear in the world, angular in the camera frame) in shares of the largest; "pose": towards (position [m],
    rotation vector [rad]) of T_world_camera, both at their largest speed.
    """
    at, turn = pose.as_matrix(), action[3:]
    if mode == "velocity":
        way, turn = DT * SPEED * action[:3], DT * TURN * turn
    else:
        way = action[:3] - at[:3, 3]
        turn = (pose.rotation.inv() * Rotation.from_rotvec(turn)).as_rotvec()
        turn = turn * _share(turn, DT * TURN)
    turned = at[:3, :3] @ Rotation.from_rotvec(turn).as_matrix()
    after = np.eye(4)
    after[:3, :3] = turned @ (
        1.5 * np.eye(3) - 0.5 * (turned.T @ turned)
    )  # orthonormal to rounding after any number of steps
    after[:3, 3] = at[:3, 3] + way * _share(way, DT * SPEED)
    return RigidTransform(after, normalize=False, copy=False)


def pose_values(pose: RigidTransform) -> NDArray[np.float32]:
    """(7,) position [m] and unit quaternion x, y, z, w, w >= 0."""
    matrix = pose.as_matrix()
    return np.concatenate([matrix[:3, 3], _quaternion(matrix.tolist())]).astype(np.float32)


def _quaternion(m: list[list[float]]) -> list[float]:
    """x, y, z, w of a rotation (3, 3), by its largest component (Shepperd, J. Guidance and Control 1, 1978)."""
    (a, b, c, *_), (d, e, f, *_), (g, h, i, *_) = m[:3]
    squares = (1 + a - e - i, 1 - a + e - i, 1 - a - e + i, 1 + a + e + i)
    rows = (
        (squares[0], b + d, c + g, h - f),
        (b + d, squares[1], f + h, c - g),
        (c + g, f + h, squares[2], d - b),
        (h - f, c - g, d - b, squares[3]),
    )
    largest = max(range(4), key=squares.__getitem__)
    scale = math.copysign(0.5 / math.sqrt(squares[largest]), rows[largest][3])
    return [scale * value for value in rows[largest]]


def _share(step: Array, longest: float) -> float:
    return min(1.0, longest / max(math.sqrt(step @ step), 1e-12))
