"""A suction cup on exact geometry: where its rim seals, and the wrench at which it lets go."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import RigidTransform

from extremal.estimator.camera import Array
from extremal.estimator.errors import InvalidInput
from extremal.scenes import Surface
from extremal.sim.arm import CUP_LENGTH

RAYS = 64  # along the rim


@dataclass(frozen=True)
class SuctionCup:
    """A bellows cup with a soft lip, after the models of Dex-Net 3.0 (Mahler et al., ICRA 2018: springs along the rim
    that bear a limited strain, and the wrench that a ring contact resists) and SuctionNet-1Billion (Cao et al., RA-L 2021).

    The cup frame has its origin in the middle of the free lip and z along the approach, out of the cup.

    Attributes:
        lip_radius: r [m].
        stroke: by how much the lip can be pushed in [m].
        strain: largest relative lengthening of the rim.
        pressure: dp, of the ambient air above the vacuum [Pa].
        friction: mu, between lip and object.
    """

    lip_radius: float = 0.015
    stroke: float = 0.006
    strain: float = 0.10
    pressure: float = 60e3
    friction: float = 0.5

    def __post_init__(self) -> None:
        for name, most in (
            ("lip_radius", 1.0),
            ("stroke", CUP_LENGTH),
            ("strain", 10.0),
            ("pressure", 101325.0),
            ("friction", 10.0),
        ):
            value = getattr(self, name)
            if not 0 < value <= most:
                label = name.replace("_", " ")
                raise InvalidInput(f"{label} of the cup is {value!r}; accepted: above 0, up to {most:g}")

    @property
    def vacuum_force(self) -> float:
        """V = dp pi r^2 [N], with which the air presses cup and object together."""
        return self.pressure * np.pi * self.lip_radius**2

    @property
    def rim(self) -> Array:
        """Points (64, 3) of the free lip in the cup frame [m]."""
        angle = 2 * np.pi / RAYS * np.arange(RAYS)
        return self.lip_radius * np.stack([np.cos(angle), np.sin(angle), np.zeros(RAYS)], axis=-1)


@dataclass(frozen=True, eq=False)
class Seal:
    """How a cup's rim meets a surface, for one pose or a batch (...).

    Attributes:
        cup: the cup.
        travel: (..., 64) from the free lip to the surface along the approach [m]: negative where the lip is pushed in,
            inf where the rim passes the object.
    """

    cup: SuctionCup
    travel: Array

    @cached_property
    def strain(self) -> Array:
        """(...) relative lengthening of the rim's polygon when it lies on the surface; inf where a ray misses."""
        hit = np.all(np.isfinite(self.travel), axis=-1)
        depth = np.where(hit[..., None], self.travel, 0.0)
        side = 2 * self.cup.lip_radius * np.sin(np.pi / RAYS)
        lengths = np.hypot(side, np.diff(depth, axis=-1, append=depth[..., :1]))
        return np.where(hit, lengths.mean(axis=-1) / side - 1, np.inf)

    @property
    def gap(self) -> Array:
        """(...) by which the cup has to advance before the whole rim touches [m]; inf where a ray misses."""
        return np.max(self.travel, axis=-1)

    @property
    def sealed(self) -> NDArray[np.bool_]:
        """(...) the rim touches all around, no part is pushed in beyond the stroke, and it bears the strain."""
        pushed = -np.min(self.travel, axis=-1)
        return (self.gap <= 0) & (pushed <= self.cup.stroke) & (self.strain <= self.cup.strain)

    @property
    def reason(self) -> NDArray[np.str_]:
        """(...) what prevents the seal: "missed", "gap", "stroke" or "strain"; empty where it is sealed."""
        failures = [
            (np.isinf(self.gap), "missed"),
            (self.gap > 0, "gap"),
            (np.min(self.travel, axis=-1) < -self.cup.stroke, "stroke"),
            (self.strain > self.cup.strain, "strain"),
        ]
        return np.select([bad for bad, _ in failures], [name for _, name in failures], "")


def seal(cup: SuctionCup, surface: Surface, T_world_cup: RigidTransform) -> Seal:
    """Where the rim of a cup, brought along its axis, meets the true surface.

    Args:
        T_world_cup: one pose or a batch (N): origin in the middle of the free lip, z along the approach.

    Raises:
        InvalidInput: a pose is not finite.
    """
    matrices = T_world_cup.as_matrix()
    if not np.all(np.isfinite(matrices)):
        raise InvalidInput("T_world_cup must be finite")
    # The rays start where the rim comes from, as far back as the cup is long: a lip that is pushed in starts outside.
    start = cup.rim - (0.0, 0.0, CUP_LENGTH)
    origins = np.einsum("...ij,kj->...ki", matrices[..., :3, :3], start) + matrices[..., None, :3, 3]
    approach = np.broadcast_to(matrices[..., None, :3, 2], origins.shape)
    travel = surface.intersect(origins.reshape(-1, 3), approach.reshape(-1, 3)) - CUP_LENGTH
    return Seal(cup, travel.reshape(origins.shape[:-1]))


def load_ratio(cup: SuctionCup, force: ArrayLike, torque: ArrayLike) -> Array:
    """How much of its grip a cup needs (...): above 1 it lets go (the ring contact of Dex-Net 3.0, sec. IV).

        f_N = V - F_z,    max(F_z / V, hypot(F_t / (mu f_N), tau_z / (mu f_N r)), tau_xy / (f_N r))

    Args:
        force: (..., 3) of the object on the cup, in the cup frame [N]; F_z > 0 pulls the object off.
        torque: (..., 3) likewise, about the middle of the lip [N m].
    """
    f, tau = np.asarray(force, float), np.asarray(torque, float)
    r, V = cup.lip_radius, cup.vacuum_force
    normal = np.maximum(V - f[..., 2], 1e-9 * V)  # where nothing is left of it, F_z / V is 1 or more
    sliding = np.sqrt(f[..., 0] ** 2 + f[..., 1] ** 2 + (tau[..., 2] / r) ** 2) / (cup.friction * normal)
    bending = np.hypot(tau[..., 0], tau[..., 1]) / (normal * r)
    return np.maximum(np.maximum(f[..., 2] / V, sliding), bending)
