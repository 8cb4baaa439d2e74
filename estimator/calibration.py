"""What a calibration found, with how well it knows it: the camera, where it sits on the flange, and the arm's own errors."""

import re
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import RigidTransform

from extremal.estimator.board import Board
from extremal.estimator.camera import Array, Camera
from extremal.estimator.errors import InvalidInput
from extremal.estimator.projection import INTRINSICS

_TWIST = ("x", "y", "z", "rx", "ry", "rz")
HAND_EYE = tuple(f"hand_eye_{axis}" for axis in _TWIST)
BOARD_POSE = tuple(f"board_{axis}" for axis in _TWIST)
MOST_PARAMETERS = 200  # of the arm


@dataclass(frozen=True)
class Simulation:
    """Which simulated set-up a calibration belongs to: it fits no other.

    Attributes:
        arm, camera: names of the presets. seed: of the individual arm.
    """

    arm: str
    seed: int
    camera: str

    def __post_init__(self) -> None:
        for name, value in (("arm", self.arm), ("camera", self.camera)):
            if not re.fullmatch(r"[\w.-]{1,100}", value):
                raise InvalidInput(f"simulation {name} is {value!r:.60}; accepted: a preset's name")
        if not 0 <= self.seed < 2**63:
            raise InvalidInput(f"simulation seed is {self.seed!r}; accepted: a whole number from 0")


@dataclass(frozen=True, eq=False)
class Calibration:
    """A calibrated camera on a robot's flange; `calibration_file` writes and reads it.

    Attributes:
        camera: the camera model.
        T_flange_camera: hand-eye transform.
        T_base_board: where the board stood.
        board: the board.
        arm: values of the arm's own parameters, deviations from its data sheet [m], [rad], by name; may be empty.
        covariance: (21 + C, 21 + C) of the errors of `parameters`: intrinsics [px], distortion [1], twists
            (translation [m], rotation vector [rad]) of T_flange_camera in the camera frame and of T_base_board in the board's,
            both right-multiplied, and the C parameters of the arm. T_actual = T exp(error).
        view_errors: standard deviations, each axis, of what is left of the camera's pose, independent in every view:
            position [m] and rotation [rad].
        rms: distance from corners to their predictions [px], root mean square.
        views: number of views used.
        simulation: in simulation, which set-up was calibrated.
    """

    camera: Camera
    T_flange_camera: RigidTransform
    T_base_board: RigidTransform
    board: Board
    covariance: Array
    view_errors: tuple[float, float]
    rms: float
    views: int
    arm: dict[str, float] = field(default_factory=dict)
    simulation: Simulation | None = None

    def __post_init__(self) -> None:
        for name, pose in (
            ("T_flange_camera", self.T_flange_camera),
            ("T_base_board", self.T_base_board),
        ):
            if not (pose.single and np.all(np.isfinite(pose.as_matrix()))):
                raise InvalidInput(f"{name} is not one transform of finite numbers")
        for name, value in (
            ("position error of a view", self.view_errors[0]),
            ("rotation error of a view", self.view_errors[1]),
            ("rms", self.rms),
        ):
            if not (np.isfinite(value) and value >= 0):
                raise InvalidInput(f"{name} is {value!r}; accepted: 0 or a positive number")
        if not self.views >= 3:
            raise InvalidInput(f"views is {self.views!r}; accepted: a whole number from 3")
        if len(self.arm) > MOST_PARAMETERS:
            raise InvalidInput(f"arm has {len(self.arm)} parameters; accepted: up to {MOST_PARAMETERS}")
        for name, value in self.arm.items():
            if not (re.fullmatch(r"\w{1,100}", name) and np.isfinite(value)):
                raise InvalidInput(
                    f"arm parameter {name!r:.60} is {value!r}; accepted: a finite number, a name of letters, digits and _"
                )
        _check_covariance(self.covariance, len(self.parameters))

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the rows of `covariance`."""
        return INTRINSICS + HAND_EYE + BOARD_POSE + tuple(self.arm)

    def covariance_of(self, names: tuple[str, ...]) -> Array:
        """(n, n) covariance of the parameters of these names."""
        rows = [self.parameters.index(name) for name in names]
        return self.covariance[np.ix_(rows, rows)]

    @property
    def sigma(self) -> dict[str, float]:
        """Standard deviation of every parameter."""
        return dict(zip(self.parameters, np.sqrt(np.diagonal(self.covariance)).tolist(), strict=True))


def _check_covariance(covariance: Array, size: int) -> None:
    """Symmetric and positive semi-definite, each unit measured by its own standard deviation."""
    if covariance.shape != (size, size) or not np.all(np.isfinite(covariance)):
        raise InvalidInput(f"covariance is {covariance.shape}; accepted: finite numbers ({size}, {size})")
    variance = np.diagonal(covariance)
    if np.any(variance < 0):
        raise InvalidInput(f"covariance has the variance {variance.min():.3g}; accepted: 0 or positive")
    scale = np.sqrt(np.where(variance > 0, variance, 1.0))
    scaled = covariance / np.outer(scale, scale)
    if np.any(np.abs(scaled - scaled.T) > 1e-9):
        raise InvalidInput("covariance is not symmetric")
    smallest = np.linalg.eigvalsh(scaled).min()
    if smallest < -1e-9:
        raise InvalidInput(
            f"covariance has the eigenvalue {smallest:.3g} (scaled to unit variances); accepted: a positive semi-definite matrix"
        )
