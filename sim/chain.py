"""The arm's geometry as a Denavit-Hartenberg chain: flange and camera poses from joint readings, and their derivatives."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from extremal.estimator.camera import Array
from extremal.estimator.errors import InvalidInput
from extremal.estimator.projection import adjoint

# Standard Denavit-Hartenberg parameters (Universal Robots, "DH parameters for calculations of kinematics and dynamics",
# UR5e): T_i = Rz(q_i) Tz(d_i) Tx(a_i) Rx(alpha_i), metres and radians.
DH_A = (0.0, -0.425, -0.3922, 0.0, 0.0, 0.0)
DH_D = (0.1625, 0.0, 0.0, 0.1333, 0.0997, 0.0996)
DH_ALPHA = (np.pi / 2, 0.0, 0.0, np.pi / 2, -np.pi / 2, 0.0)

# The optical centre sits 75 mm beside the cup's axis and 40 mm behind its lip, looking along the flange's z: the lip
# is 56 degrees off the optical axis, and the rest of the arm is behind the camera. A frame of up to 50 degrees
# from axis to corner (the default camera: 27) never shows the arm.
T_FLANGE_CAMERA = RigidTransform.from_translation([0.0, -0.075, 0.06])

ARM_PARAMETERS = tuple(
    f"{name}_{joint}" for name in ("joint_offset", "link_a", "link_d") for joint in range(1, 7)
)


def _nothing() -> Array:
    return np.zeros(6)


@dataclass(frozen=True, eq=False)
class ArmGeometry:
    """One arm: by how much its parts differ from the data sheet, and where its camera is mounted.

        T_base_flange = prod_i Rz(r_i + joint_offset_i) Tz(d_i + link_d_i) Tx(a_i + link_a_i) Rx(alpha_i)

    with encoder readings r. Twists alpha_i are those of the data sheet: parts are milled and bored square far better
    than encoders are zeroed.

    Attributes:
        joint_offset: (6,) angle of each joint where its encoder reads zero [rad].
        link_a, link_d: (6,) deviations of the lengths a_i and d_i [m].
        T_flange_camera: the camera's mounting (hand-eye transform).
    """

    joint_offset: Array = field(default_factory=_nothing)
    link_a: Array = field(default_factory=_nothing)
    link_d: Array = field(default_factory=_nothing)
    T_flange_camera: RigidTransform = T_FLANGE_CAMERA

    def __post_init__(self) -> None:
        for name in ("joint_offset", "link_a", "link_d"):
            value = np.asarray(getattr(self, name), float)
            if value.shape != (6,) or not np.all(np.isfinite(value)):
                raise InvalidInput(f"{name} is {value.tolist()}; accepted: six finite numbers")
            object.__setattr__(self, name, value)
        mounting = self.T_flange_camera
        if not (mounting.single and np.all(np.isfinite(mounting.as_matrix()))):
            raise InvalidInput("T_flange_camera must be one finite transform")

    @property
    def parameters(self) -> Array:
        """(18,) values of `ARM_PARAMETERS` [rad], [m]."""
        return np.concatenate([self.joint_offset, self.link_a, self.link_d])

    def with_parameters(self, values: ArrayLike) -> "ArmGeometry":
        """The same mounting on an arm of other parameters (18,), in the order of `ARM_PARAMETERS`."""
        joint_offset, link_a, link_d = np.reshape(np.asarray(values, float), (3, 6))
        return ArmGeometry(joint_offset, link_a, link_d, self.T_flange_camera)

    def flange_poses(self, readings: ArrayLike) -> RigidTransform:
        """T_base_flange (V) at encoder readings (V, 6) [rad]."""
        return RigidTransform.from_matrix(self._frames(readings)[:, -1])

    def camera_poses(self, readings: ArrayLike) -> RigidTransform:
        """T_base_camera (V) at encoder readings (V, 6) [rad]."""
        return self.flange_poses(readings) * self.T_flange_camera

    def derivatives(self, readings: ArrayLike) -> Array:
        """Derivatives D (V, 6, 18) of the flange poses by `ARM_PARAMETERS` at encoder readings (V, 6) [rad].

        T_base_flange(p + dp) = T_base_flange(p) exp(D dp) to first order: twists (translation, rotation vector) in the
        flange frame. Joint i turns about z_(i-1) through o_(i-1); d_i shifts along the same axis, a_i along x_i. The
        first six columns are the arm's Jacobian.
        """
        frames = self._frames(readings)
        axes, origins = frames[:, :6, :3, 2], frames[:, :6, :3, 3]
        still = np.zeros_like(axes)
        arms = frames[:, -1:, :3, 3] - origins
        moved = np.concatenate([np.cross(axes, arms), frames[:, 1:, :3, 0], axes], axis=1)
        turned = np.concatenate([axes, still, still], axis=1)
        to_flange = frames[:, -1, :3, :3]  # applied from the right: rows are vectors
        return np.concatenate([moved @ to_flange, turned @ to_flange], axis=2).swapaxes(1, 2)

    def camera_derivatives(self, readings: ArrayLike) -> Array:
        """Derivatives (V, 6, 24) of the camera poses by `ARM_PARAMETERS` and by a twist of the mounting.

        Twists are in the camera frame: T_base_camera exp(D dp), with T_flange_camera exp(dp[18:]).
        """
        chain = adjoint(self.T_flange_camera.inv()) @ self.derivatives(readings)
        mounting = np.broadcast_to(np.eye(6), (len(chain), 6, 6))
        return np.concatenate([chain, mounting], axis=2)

    def _frames(self, readings: ArrayLike) -> Array:
        """T_base_i (V, 7, 4, 4) of the chain's frames 0 to 6."""
        q = np.asarray(readings, float)
        if q.ndim != 2 or q.shape[1] != 6 or not np.all(np.isfinite(q)):
            raise InvalidInput(f"joint readings are {q.shape}; accepted: finite numbers (V, 6) [rad]")
        theta = q + self.joint_offset
        a, d = np.array(DH_A) + self.link_a, np.array(DH_D) + self.link_d
        ct, st, ca, sa = np.cos(theta), np.sin(theta), np.cos(DH_ALPHA), np.sin(DH_ALPHA)
        links = np.zeros((*q.shape, 4, 4))
        links[..., 0, :] = np.stack([ct, -st * ca, st * sa, a * ct], axis=-1)
        links[..., 1, :] = np.stack([st, ct * ca, -ct * sa, a * st], axis=-1)
        links[..., 2, 1], links[..., 2, 2], links[..., 2, 3], links[..., 3, 3] = sa, ca, d, 1.0
        frames = [np.broadcast_to(np.eye(4), (len(q), 4, 4))]
        for i in range(6):
            frames.append(frames[-1] @ links[:, i])
        return np.stack(frames, axis=1)


NOMINAL = ArmGeometry()
