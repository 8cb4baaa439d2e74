"""What is wrong with an arm, and what one can know of its camera's poses in spite of it.

    T_actual = T_believed exp(e),     e = A c + r z,     c, z ~ N(0, I)

An arm comes back to a place far better than it goes to one that was only computed: ISO 9283 (1998) tells the repeatability
of a pose (the spread when it is commanded again) from its accuracy (how far off their mean is). Here

- `c` makes an individual arm and stays as it is: zeros of the joint encoders, lengths of the links, the camera's mounting.
  Such geometric errors make up nine tenths of an industrial arm's (Klimchik, Pashkevich, Wu, Furet and Caro, Optimization
  of measurement configurations for geometrical calibration of industrial robot, 2012). Their effect A is the chain's
  derivative (for an overview: Roth, Mooring and Ravani, IEEE J. Robotics Autom. 3(5), 1987).
- `z` is drawn anew in every view: noise of the encoders, backlash, friction, warming up.

The presets `ARMS`, root mean square of each axis of the camera's pose error [mm] / [mrad], over 2000 arms and the poses of
`look` (15 views over 0.4 m at 0.6 m; 3 over 0.1 m at 0.5 m and 30 views of a board differ by less than 4 %, the part of
the joints' zeros by up to 15 %):

| | calibrated | typical | poor |
|---|---|---|---|
| zeros of the joints | 0.025 / 0.070 | 0.25 / 0.70 | 1.0 / 2.8 |
| lengths of the links | 0.059 / 0 | 0.59 / 0 | 2.0 / 0 |
| the camera's mounting | 0.070 / 0.070 | 0.70 / 0.70 | 2.0 / 4.0 |
| in each view: encoder noise | 0.005 / 0.014 | 0.015 / 0.042 | 0.04 / 0.11 |
| in each view: repeatability | 0.020 / 0.010 | 0.040 / 0.030 | 0.10 / 0.10 |
| all | 0.10 / 0.10 | 0.95 / 1.0 | 3.0 / 4.9 |

`typical` is an arm as it comes from the factory: one that was measured had a repeatability of 0.037 mm and 0.087 mrad and an
accuracy of 0.65 mm and 2.8 mrad (Slamani, Nubiola and Bonev, Industrial Robot 39(1), 2012). `poor` is one on its data sheet's
numbers alone: stretched out, two of the same type differ by millimetres (Universal Robots, Kinematic robot calibration).
"""

from dataclasses import dataclass, fields, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from extremal.estimator.camera import Array
from extremal.estimator.errors import InvalidInput
from extremal.estimator.poses import PosePrior, pose_exp, square_root
from extremal.estimator.projection import adjoint
from extremal.sim.chain import ARM_PARAMETERS, NOMINAL, ArmGeometry


@dataclass(frozen=True)
class ArmErrors:
    """Standard deviations of independent normal errors; all zero: the robot knows its poses.

    Attributes:
        position, rotation: repeatability of each view's pose, each axis, in the camera frame [m], [rad].
        encoder_noise: of each reading of each joint [rad].
        joint_offset: of each joint's zero, the same in all views [rad].
        link_length: of each Denavit-Hartenberg length a_i, d_i, the same in all views [m].
        hand_eye_position, hand_eye_rotation: of the camera's mounting, each axis, the same in all views [m], [rad].
    """

    position: float = 0.0
    rotation: float = 0.0
    encoder_noise: float = 0.0
    joint_offset: float = 0.0
    link_length: float = 0.0
    hand_eye_position: float = 0.0
    hand_eye_rotation: float = 0.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not (np.isfinite(value) and value >= 0):
                name = field.name.replace("_", " ")
                raise InvalidInput(f"{name} error is {value!r}; accepted: 0 or a positive standard deviation")

    @property
    def repeatability(self) -> Array:
        """(6,) standard deviations of (translation [m], rotation vector [rad]) in each view, encoder noise left out."""
        return np.repeat([self.position, self.rotation], 3)

    @property
    def parameters(self) -> Array:
        """(18,) standard deviations of `ARM_PARAMETERS` [rad], [m].

        Zero for the last joint: what its zero and its lengths do is what the camera's mounting does, and is part of it.
        """
        sigma = np.repeat([self.joint_offset, self.link_length], [6, 12])
        sigma[5::6] = 0
        return sigma

    @property
    def hand_eye(self) -> Array:
        """(6,) standard deviations of (translation [m], rotation vector [rad]) of the mounting."""
        return np.repeat([self.hand_eye_position, self.hand_eye_rotation], 3)

    def draw(self, rng: np.random.Generator, around: ArmGeometry = NOMINAL) -> ArmGeometry:
        """An individual arm that is believed to be `around`; draws the same numbers whatever the sizes are."""
        chain, mounting = rng.standard_normal(18), rng.standard_normal(6)
        arm = around.with_parameters(around.parameters + self.parameters * chain)
        return replace(arm, T_flange_camera=around.T_flange_camera * pose_exp(self.hand_eye * mounting))

    def scatter(self, views: int, rng: np.random.Generator) -> tuple[Array, Array]:
        """What is drawn anew in every view: encoder noise (views, 6) [rad] and pose errors (views, 6) [m], [rad]."""
        poses, encoders = rng.standard_normal((2, views, 6))
        return self.encoder_noise * encoders, self.repeatability * poses

    def prior(self, believed: ArmGeometry, readings: Array, T_world_base: RigidTransform) -> PosePrior:
        """What one knows of T_world_camera (V) at encoder readings (V, 6) [rad] of an arm drawn around `believed`."""
        derivatives = believed.camera_derivatives(readings)
        common = derivatives * np.concatenate([self.parameters, self.hand_eye])
        return PosePrior(
            T_world_base * believed.camera_poses(readings),
            self.view_root(derivatives),
            common[:, :, np.any(common, axis=(0, 1))],
        )

    def flange_model(self, believed: ArmGeometry, readings: Array) -> "FlangeKinematics":
        """What one knows of T_base_flange (V) at encoder readings (V, 6) [rad], as a function of the geometric errors."""
        scatter = adjoint(believed.T_flange_camera) @ np.diag(self.repeatability)
        root = self._root(believed.derivatives(readings)[:, :, :6], scatter)
        return FlangeKinematics(believed, readings, self.parameters, root)

    def view_root(self, derivatives: Array) -> Array:
        """(V, 6, K) square roots of what is independent in every view of the camera, of its `camera_derivatives` (V, 6, 24)."""
        return self._root(derivatives[:, :, :6], np.diag(self.repeatability))

    def _root(self, jacobian: Array, scatter: Array) -> Array:
        """(V, 6, K) square roots of what is independent in every view: noise through Jacobians (V, 6, 6), and (6, 6)."""
        noise = self.encoder_noise * jacobian
        return square_root(noise @ np.swapaxes(noise, 1, 2) + scatter @ scatter.T)


@dataclass(frozen=True, eq=False)
class FlangeKinematics:
    """T_base_flange (V) as a function of geometric errors c (C,) in units of their standard deviations.

    Attributes:
        believed: where all c are zero.
        readings: of the encoders (V, 6) [rad].
        sigma: (18,) standard deviations of `ARM_PARAMETERS`; those that are zero are left out of c.
        root: (V, 6, K) square roots of what is independent in every view, in the flange frame.
    """

    believed: ArmGeometry
    readings: Array
    sigma: Array
    root: Array

    @property
    def uncertain(self) -> NDArray[np.intp]:
        """Indices (C,) into `ARM_PARAMETERS` of what c stands for."""
        return np.flatnonzero(self.sigma)

    @property
    def names(self) -> tuple[str, ...]:
        """Of the C parameters."""
        return tuple(ARM_PARAMETERS[i] for i in self.uncertain)

    @property
    def scales(self) -> Array:
        """(C,) standard deviations [rad], [m]: what one unit of c stands for."""
        return self.sigma[self.uncertain]

    def geometry(self, c: Array) -> ArmGeometry:
        """The arm at errors c (C,)."""
        values = self.believed.parameters
        values[self.uncertain] += self.scales * c
        return self.believed.with_parameters(values)

    def __call__(self, c: Array) -> PosePrior:
        """Flange poses (V) at c (C,), their derivatives there as common errors; `root` does not depend on c."""
        arm = self.geometry(c)
        moved = arm.derivatives(self.readings)[:, :, self.uncertain] * self.scales
        return PosePrior(arm.flange_poses(self.readings), self.root, moved)


ArmName = Literal["ideal", "calibrated", "typical", "poor"]
ARMS: dict[str, ArmErrors] = {
    "ideal": ArmErrors(),
    "calibrated": ArmErrors(
        position=2e-5,
        rotation=1e-5,
        encoder_noise=1e-5,
        joint_offset=5e-5,
        link_length=3e-5,
        hand_eye_position=7e-5,
        hand_eye_rotation=7e-5,
    ),
    "typical": ArmErrors(
        position=4e-5,
        rotation=3e-5,
        encoder_noise=3e-5,
        joint_offset=5e-4,
        link_length=3e-4,
        hand_eye_position=7e-4,
        hand_eye_rotation=7e-4,
    ),
    "poor": ArmErrors(
        position=1e-4,
        rotation=1e-4,
        encoder_noise=8e-5,
        joint_offset=2e-3,
        link_length=1e-3,
        hand_eye_position=2e-3,
        hand_eye_rotation=4e-3,
    ),
}


def get_arm(name: str) -> ArmErrors:
    """The preset of this name; InvalidInput lists the names there are."""
    if not isinstance(name, str) or name not in ARMS:
        raise InvalidInput(f"arm is {name!r}; accepted: {', '.join(ARMS)}")
    return ARMS[name]
