"""What a planner may know of an obstacle, and how careful it is to be."""

from dataclasses import dataclass

import numpy as np

from extremal.estimator.errors import InvalidInput
from extremal.scenes.curves import Array


@dataclass(frozen=True, eq=False)
class ArcBelief:
    """The osculating circle at a contact point of an extremal boundary, as estimated.

    Attributes:
        point: (3,) [m] contact point, world frame.
        normal: (3,) outward unit normal there.
        axis: (3,) unit direction, either sign, of the contour generator there, or of the obstacle as a whole
            (better where its outline bulges: the helix is wound around it); within 65 degrees of the surface.
        radius: [m] of the section across `axis`; negative where it is concave (then taken for an edge, 0).
        sigma_radius: standard deviation [m]; may be infinite.
        sigma_point: standard deviation [m] of the point along the normal; finite.
    """

    point: Array
    normal: Array
    axis: Array
    radius: float
    sigma_radius: float = 0.0
    sigma_point: float = 0.0

    def __post_init__(self) -> None:
        for name in ("point", "normal", "axis"):
            value = np.array(getattr(self, name), float)
            if value.shape != (3,) or not np.all(np.isfinite(value)):
                raise InvalidInput(f"{name} is {getattr(self, name)!r}; accepted: three finite numbers")
            length = float(np.linalg.norm(value))
            if name != "point":
                if not length > 1e-9:
                    raise InvalidInput(f"{name} is {value.tolist()}; accepted: a direction")
                value = value / length
            value.flags.writeable = False
            object.__setattr__(self, name, value)
        if abs(float(self.normal @ self.axis)) > 0.9:
            raise InvalidInput(
                f"axis {self.axis.tolist()} is along the normal {self.normal.tolist()}; accepted: a direction across it"
            )
        if not np.isfinite(self.radius):
            raise InvalidInput(f"radius is {self.radius!r}; accepted: a finite number of metres")
        if not self.sigma_radius >= 0:
            raise InvalidInput(f"sigma_radius is {self.sigma_radius!r}; accepted: from 0 to infinity [m]")
        if not 0 <= self.sigma_point < np.inf:
            raise InvalidInput(
                f"sigma_point is {self.sigma_point!r}; accepted: a finite number of metres from 0"
            )


@dataclass(frozen=True)
class Caution:
    """How far to stay away.

    Attributes:
        clearance: radius of the moving sphere plus the wanted distance [m].
        k: number of standard deviations of the belief to allow for.
        largest_radius: [m] no obstacle's circle is taken to be larger, however uncertain.
    """

    clearance: float
    k: float = 2.0
    largest_radius: float = 0.2

    def __post_init__(self) -> None:
        for name in ("clearance", "largest_radius"):
            if not 0 < getattr(self, name) < 100:
                raise InvalidInput(
                    f"{name} is {getattr(self, name)!r}; accepted: a positive number of metres"
                )
        if not 0 <= self.k < 100:
            raise InvalidInput(f"k is {self.k!r}; accepted: a number of standard deviations from 0")
