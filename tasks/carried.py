"""A camera in a robot's hand, free to go anywhere: commanded, actual and believed poses without an arm's kinematics.

    T_actual = D T_commanded exp(h) exp(z),      T_believed = T_commanded

Of one preset of `sim.ARMS`, an individual robot has what stays through an episode: the error h of its camera's mounting, and D,
what its joints and links do wrong, a rigid motion about where the episode starts. Of another, z is drawn anew in every look.
How large it is depends on how a task moves the camera:

- `repeatability`: it glides along one path, on which what joints and links do wrong hardly changes, and comes to each place as
  well as it ever does (typical: 0.04 mm, 0.05 mrad).
- `whole_error`: each look is taken as if in another configuration of the arm, off by all that the preset knows (typical: 1 mm, 1 mrad,
  each axis, the errors of Cipolla fig. 3.12).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial.transform import RigidTransform

from extremal.estimator.camera import Array
from extremal.estimator.poses import six_columns, square_root
from extremal.sim import NOMINAL, ArmErrors, ArmGeometry
from extremal.tasks.compiled import compiled
from extremal.tasks.rigid import exponential, product

READINGS = np.array([[0.3, -1.9, 1.7, 0.4, 1.3, 0.2]])  # [rad] an arm that reaches out half-way


def repeatability(errors: ArmErrors) -> Array:
    """Covariance (6, 6) of how far an arm misses a pose to which it went before."""
    root = errors.view_root(NOMINAL.camera_derivatives(READINGS))[0]
    return root @ root.T


def whole_error(errors: ArmErrors) -> Array:
    """Covariance (6, 6) of all that is wrong with a pose."""
    return errors.prior(NOMINAL, READINGS, RigidTransform.identity()).covariance[0]


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
    def draw(
        bias: ArmErrors, scatter: Array, start: RigidTransform, rng: np.random.Generator
    ) -> "CarriedCamera":
        """An individual robot, whose episode starts at T_world_camera `start`; scatter: covariance (6, 6) of z."""
        geometry = bias.draw(rng, NOMINAL)
        mounting = NOMINAL.T_flange_camera.inv() * geometry.T_flange_camera
        hand = NOMINAL.flange_poses(READINGS)[0].inv() * geometry.flange_poses(READINGS)[0]
        off = NOMINAL.T_flange_camera.inv() * hand * NOMINAL.T_flange_camera  # in the camera frame
        root = square_root(scatter[None])[0]
        return CarriedCamera(
            geometry,
            start * off * start.inv(),
            mounting,
            np.ascontiguousarray(six_columns(root)),
            scatter,
            (bias.hand_eye_position, bias.hand_eye_rotation),
        )

    def actual(self, T_world_camera: Array, rng: np.random.Generator) -> Array:
        """Where (4, 4) the camera goes when it is commanded to a pose (4, 4)."""
        return _reached(self._world, T_world_camera, self._mounted, self.root, rng.standard_normal(6))

    @cached_property
    def _world(self) -> Array:
        return np.ascontiguousarray(self.world.as_matrix())

    @cached_property
    def _mounted(self) -> Array:
        return self.mounting.as_matrix()


@compiled
def _reached(world: Array, commanded: Array, mounting: Array, root: Array, normal: Array) -> Array:
    """D T_commanded exp(h) exp(z), of twists z = root normal (6,) (translation [m], rotation vector [rad])."""
    z = np.zeros(6)
    for i in range(6):
        for j in range(6):
            z[i] += root[i, j] * normal[j]
    off = exponential((z[0], z[1], z[2]), (z[3], z[4], z[5]))
    return product(product(product(world, commanded), mounting), off)
