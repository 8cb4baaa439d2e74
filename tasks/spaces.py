"""What environments observe and how a camera is moved: arrays of fixed size, and back."""

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


def feature_space() -> gym.spaces.Box:
    """(SLOTS, COLUMNS)."""
    low = dict.fromkeys(COLUMNS, 0.0) | dict.fromkeys(("radius", "relative", "x", "y", "z"), -REACH)
    low |= dict.fromkeys(("nx", "ny", "nz"), -1.0)
    high = dict.fromkeys(COLUMNS, 1.0) | dict.fromkeys(("radius", "relative", "x", "y", "z"), REACH)
    high |= {"contour": 1e4, "looks": 1e4}
    bounds = (np.array([side[c] for c in COLUMNS], np.float32) for side in (low, high))
    lower, upper = (np.tile(bound, (SLOTS, 1)) for bound in bounds)
    return gym.spaces.Box(lower, upper, dtype=np.float32)


def slots(features: Features) -> NDArray[np.integer]:
    """Which features, in order, an observation holds."""
    return np.lexsort((-features.views, ~features.visible))[:SLOTS]


def feature_rows(features: Features) -> NDArray[np.float32]:
    """Features as an observation; rows that are left over are zero: no looks."""
    f = features.take(slots(features))
    along = np.einsum(
        "ni,nij,nj->n", f.normal, np.where(np.isfinite(f.covariance), f.covariance, UNKNOWN**2), f.normal
    )
    values = np.column_stack(
        [
            np.clip(np.nan_to_num(f.radius), -REACH, REACH),
            np.minimum(f.sigma_radius, UNKNOWN),
            np.clip(np.nan_to_num(f.relative_radius), -REACH, REACH),
            np.minimum(f.sigma_relative, UNKNOWN),
            np.clip(f.position, -REACH, REACH),
            np.sqrt(np.clip(along, 0, UNKNOWN**2)),
            np.clip(f.normal, -1, 1),
            f.extremal,
            f.reference,
            f.visible,
            np.clip(f.contour, 0, 1e4),
            np.clip(f.views, 0, 1e4),
        ]
    )
    rows = np.zeros((SLOTS, len(COLUMNS)), np.float32)
    rows[: len(values)] = values
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
    if values.shape != space.shape or not np.all(np.isfinite(values)):
        raise InvalidInput(
            f"action is {np.array2string(values, threshold=8)}; accepted: {space.shape} finite numbers"
        )
    return np.clip(values, space.low.astype(float), space.high.astype(float))


def moved(pose: RigidTransform, action: Array, mode: str) -> RigidTransform:
    """Where a step takes a commanded camera pose: at most DT SPEED and DT TURN away.

    "velocity": (linear in the world, angular in the camera frame) in shares of the largest; "pose": towards (position [m],
    rotation vector [rad]) of T_world_camera, both at their largest speed.
    """
    if mode == "velocity":
        way, turn = DT * SPEED * action[:3], Rotation.from_rotvec(DT * TURN * action[3:])
    else:
        way = action[:3] - pose.translation
        turn = (pose.rotation.inv() * Rotation.from_rotvec(action[3:])).as_rotvec()
        turn = Rotation.from_rotvec(turn * _share(turn, DT * TURN))
    way = way * _share(way, DT * SPEED)
    return RigidTransform.from_components(pose.translation + way, pose.rotation * turn)


def _share(step: Array, longest: float) -> float:
    return min(1.0, longest / max(float(np.linalg.norm(step)), 1e-12))
