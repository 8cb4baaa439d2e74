"""A rig: one individual arm with its camera, what they are and what is believed of them.

    T_actual = T_believed exp(M k + r z),      k = actual - believed parameters ~ N(0, root root'),  z ~ N(0, I)

The parameters are the camera's intrinsics, those of the arm's geometry and the camera's mounting. Without a calibration
what is believed is the data sheet, and each is off by itself; a calibration knows all of them better, and how their errors
hang together.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from extremal.estimator.calibration import HAND_EYE, Calibration
from extremal.estimator.camera import Array, Camera
from extremal.estimator.errors import InvalidInput, is_whole
from extremal.estimator.poses import PosePrior, pose_exp
from extremal.estimator.projection import INTRINSICS, focal_sigma, intrinsics, turning, with_intrinsics
from extremal.sim.arm_errors import ArmErrors, get_arm
from extremal.sim.cameras import get_camera
from extremal.sim.chain import ARM_PARAMETERS, NOMINAL, ArmGeometry
from extremal.sim.sensor import Sensor

_INDIVIDUAL = 0x45787472  # first word of the seed of an individual arm: nothing else draws from this stream


@dataclass(frozen=True, eq=False)
class Rig:
    """An individual arm and camera.

    Attributes:
        camera, geometry: what they are.
        sensor: of the camera.
        believed_camera, believed: what is believed of them.
        errors: of the kind of arm; what is drawn anew in every view is its.
        arm, camera_name: presets' names; "real" where the rig is drawn from a calibration of a real one.
        root: (33, C) square root of the covariance of actual minus believed `INTRINSICS`, `ARM_PARAMETERS` and mounting
            (twist (translation [m], rotation vector [rad]) in the camera frame).

    Raises InvalidInput for another root.
    """

    camera: Camera
    geometry: ArmGeometry
    sensor: Sensor
    believed_camera: Camera
    believed: ArmGeometry
    errors: ArmErrors
    root: Array
    arm: str
    camera_name: str

    def __post_init__(self) -> None:
        rows = len(INTRINSICS) + len(ARM_PARAMETERS) + len(HAND_EYE)
        if self.root.ndim != 2 or len(self.root) != rows or not np.all(np.isfinite(self.root)):
            raise InvalidInput(f"root of a rig is {self.root.shape}; accepted: finite numbers ({rows}, any)")

    @staticmethod
    def individual(arm: str, camera: str, seed: int) -> "Rig":
        """The arm number `seed` of a kind, with a camera whose intrinsics are known, believed to be as the data sheet says.

        Raises InvalidInput for an unknown arm or camera, the message lists the names, and for a seed that is no whole number
        from 0.
        """
        if not (is_whole(seed) and seed >= 0):
            raise InvalidInput(f"seed of an arm is {seed!r}; accepted: a whole number from 0")
        errors, preset = get_arm(arm), get_camera(camera)
        geometry = errors.draw(np.random.default_rng([_INDIVIDUAL, seed]))
        sigma = np.concatenate([np.zeros(len(INTRINSICS)), errors.parameters, errors.hand_eye])
        root = np.diag(sigma)[:, sigma > 0]
        return Rig(preset.camera, geometry, preset.sensor, preset.camera, NOMINAL, errors, root, arm, camera)

    def calibrated(self, calibration: Calibration) -> "Rig":
        """The same individual, believed to be as its calibration says."""
        believed, root = _believed(calibration)
        return replace(self, believed_camera=calibration.camera, believed=believed, root=root)

    @staticmethod
    def like(calibration: Calibration, rng: np.random.Generator) -> "Rig":
        """A rig of which all that is known is a calibration: what it is is drawn from the calibration's covariance."""
        believed, root = _believed(calibration)
        off = root @ rng.standard_normal(root.shape[1])
        chain, mounting = np.split(off[len(INTRINSICS) :], [len(ARM_PARAMETERS)])
        geometry = replace(
            believed.with_parameters(believed.parameters + chain),
            T_flange_camera=believed.T_flange_camera * pose_exp(mounting),
        )
        position, rotation = calibration.view_errors
        camera = with_intrinsics(calibration.camera, intrinsics(calibration.camera) + off[: len(INTRINSICS)])
        errors = ArmErrors(position=position, rotation=rotation)
        return Rig(camera, geometry, Sensor(), calibration.camera, believed, errors, root, "real", "real")

    @property
    def intrinsics_root(self) -> Array:
        """(9, C) square root of the covariance of the intrinsics."""
        return self.root[: len(INTRINSICS)]

    def prior(self, readings: Array, T_world_base: RigidTransform) -> PosePrior:
        """What is known of T_world_camera (V) at encoder readings (V, 6) [rad].

        Raises InvalidInput for readings of another shape or that are not finite, and for a base without one finite pose.
        """
        if readings.ndim != 2 or readings.shape[1] != 6 or not np.all(np.isfinite(readings)):
            raise InvalidInput(f"readings are {readings.shape}; accepted: finite numbers (V, 6) [rad]")
        if not (T_world_base.single and np.all(np.isfinite(T_world_base.as_matrix()))):
            raise InvalidInput("T_world_base is not one transform of finite numbers")
        by_parameters = self.believed.camera_derivatives(readings)
        by_intrinsics = np.broadcast_to(turning(self.believed_camera), (len(readings), 6, len(INTRINSICS)))
        return PosePrior(
            T_world_base * self.believed.camera_poses(readings),
            self.errors.view_root(by_parameters),
            np.concatenate([by_intrinsics, by_parameters], axis=2) @ self.root,
            focal_sigma(self.believed_camera, self.intrinsics_root),
        )


def _believed(calibration: Calibration) -> tuple[ArmGeometry, Array]:
    """The geometry that a calibration found, and the square root (33, C) of its covariance."""
    unknown = sorted(set(calibration.arm) - set(ARM_PARAMETERS))
    if unknown:
        raise InvalidInput(
            f"the calibration has the arm parameter {unknown[0]!r}; accepted: {', '.join(ARM_PARAMETERS)}"
        )
    values = [calibration.arm.get(name, 0.0) for name in ARM_PARAMETERS]
    geometry = replace(NOMINAL, T_flange_camera=calibration.T_flange_camera).with_parameters(values)
    known = tuple(name for name in ARM_PARAMETERS if name in calibration.arm)
    names = INTRINSICS + known + HAND_EYE
    covariance = calibration.covariance_of(names)
    scale = np.sqrt(np.where(np.diagonal(covariance) > 0, np.diagonal(covariance), 1.0))
    half = scale[:, None] * _root_of(covariance / np.outer(scale, scale))
    rows = [(INTRINSICS + ARM_PARAMETERS + HAND_EYE).index(name) for name in names]
    root = np.zeros((len(INTRINSICS) + len(ARM_PARAMETERS) + len(HAND_EYE), half.shape[1]))
    root[rows] = half
    return geometry, root


def _root_of(correlation: Array) -> Array:
    """Square root (P, K) of a positive semi-definite matrix (P, P) of unit diagonal."""
    values, vectors = np.linalg.eigh(correlation)
    kept = values > 1e-12
    return vectors[:, kept] * np.sqrt(values[kept])
