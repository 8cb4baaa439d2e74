"""What the robot believes about its camera's pose: errors of encoders, hand-eye calibration and repeatability."""

from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np
from scipy.spatial.transform import RigidTransform

from extremal.estimator.camera import Array
from extremal.estimator.errors import InvalidInput
from extremal.estimator.poses import PosePrior, pose_exp, square_root


@dataclass(frozen=True)
class PoseErrors:
    """Standard deviations of independent normal errors; all zero: the robot knows its poses.

    T_believed = FK(q + bias) exp(hand-eye error) exp(error of the view), errors in the camera frame.

    Attributes:
        position, rotation: of each view, each axis: repeatability [m], [rad].
        hand_eye_position, hand_eye_rotation: of the camera's mounting, the same in all views [m], [rad].
        joint_bias: of each joint's encoder, the same in all views [rad].
    """

    position: float = 0.0
    rotation: float = 0.0
    hand_eye_position: float = 0.0
    hand_eye_rotation: float = 0.0
    joint_bias: float = 0.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not (np.isfinite(value) and value >= 0):
                name = field.name.replace("_", " ")
                raise InvalidInput(f"{name} error is {value!r}; accepted: 0 or a positive standard deviation")

    @property
    def view_covariance(self) -> Array:
        """(6, 6) covariance of (translation [m], rotation vector [rad]) of what is independent in every view."""
        return np.diag([self.position**2] * 3 + [self.rotation**2] * 3)

    def prior(
        self,
        T_world_camera: RigidTransform,
        joint_positions: Array,
        forward: Callable[[Array], RigidTransform],
    ) -> PosePrior:
        """What these errors let one know of the actual poses, given the believed ones.

        Args:
            T_world_camera: believed poses (V).
            joint_positions, forward: as in `believed`.
        """
        views, step = len(joint_positions), 1e-6
        modes = [np.tile(np.diag([self.hand_eye_position] * 3 + [self.hand_eye_rotation] * 3), (views, 1, 1))]
        here = forward(joint_positions).inv()
        for turned in step * np.eye(joint_positions.shape[1]):
            twist = (here * forward(joint_positions + turned)).as_exp_coords() / step
            moved = np.concatenate([twist[:, 3:], twist[:, :3]], axis=1)
            modes.append(self.joint_bias * moved[:, :, None])
        common = np.concatenate(modes, axis=2)
        root = square_root(np.tile(self.view_covariance, (views, 1, 1)))
        return PosePrior(T_world_camera, root, common[:, :, np.any(common, axis=(0, 1))])

    def believed(
        self,
        joint_positions: Array,
        forward: Callable[[Array], RigidTransform],
        rng: np.random.Generator,
    ) -> RigidTransform:
        """Believed T_world_camera (V) of the robot at actual joint positions (V, 6) [rad].

        Args:
            joint_positions: actual angles.
            forward: forward kinematics, (V, 6) -> T_world_camera (V).
            rng: draws the same numbers whatever the standard deviations are.
        """
        bias = self.joint_bias * rng.standard_normal(6)
        hand_eye = rng.standard_normal(6) * ([self.hand_eye_position] * 3 + [self.hand_eye_rotation] * 3)
        views = rng.standard_normal((len(joint_positions), 6)) * ([self.position] * 3 + [self.rotation] * 3)
        return forward(joint_positions + bias) * pose_exp(hand_eye) * pose_exp(views)
