"""A camera in a robot's hand, free to go anywhere: commanded, actual and believed poses without an arm's kinematics.

    T_actual = D T_commanded exp(h) exp(z),      T_believed = T_commanded

h is the mounting's error, D what joints and links do wrong, a rigid motion about where the episode starts: within the half
metre of an episode it hardly changes; z is drawn anew in every look. All three are those of an individual arm of
`ArmErrors` at `READINGS`.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from extremal.estimator.camera import Array
from extremal.estimator.poses import pose_exp, square_root
from extremal.sim import NOMINAL, ArmErrors, ArmGeometry

READINGS = np.array([[0.3, -1.9, 1.7, 0.4, 1.3, 0.2]])  # [rad] an arm that reaches out half-way


@dataclass(frozen=True, eq=False)
class CarriedCamera:
    """The errors of one individual robot.

    Attributes:
        geometry: the arm.
        world: D; mounting: exp(h).
        root: (6, 6) of the covariance root root' of z.
        covariance: (6, 6) of z.
        mounting_sigma: standard deviations of h: position [m], rotation [rad], each axis.
    """

    geometry: ArmGeometry
    world: RigidTransform
    mounting: RigidTransform
    root: Array
    covariance: Array
    mounting_sigma: tuple[float, float]

    @staticmethod
    def draw(errors: ArmErrors, start: RigidTransform, rng: np.random.Generator) -> "CarriedCamera":
        """An individual robot, whose episode starts at T_world_camera `start`."""
        geometry = errors.draw(rng, NOMINAL)
        mounting = NOMINAL.T_flange_camera.inv() * geometry.T_flange_camera
        hand = NOMINAL.flange_poses(READINGS)[0].inv() * geometry.flange_poses(READINGS)[0]
        off = NOMINAL.T_flange_camera.inv() * hand * NOMINAL.T_flange_camera  # in the camera frame
        view = errors.view_root(NOMINAL.camera_derivatives(READINGS))[0]
        own = view @ view.T
        root = square_root(own[None])[0]
        return CarriedCamera(
            geometry,
            start * off * start.inv(),
            mounting,
            np.pad(root, ((0, 0), (0, 6 - root.shape[1]))),
            own,
            (errors.hand_eye_position, errors.hand_eye_rotation),
        )

    def actual(self, T_world_camera: RigidTransform, rng: np.random.Generator) -> RigidTransform:
        """Where the camera goes when it is commanded to a pose."""
        return self.world * T_world_camera * self.mounting * pose_exp(self.root @ rng.standard_normal(6))
