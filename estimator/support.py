"""Local shape as a support function: every edgel is a tangent plane, every feature a function h(n) that it must meet.

A contour seen from centre v touches the plane through v with normal n; relative to an origin near the contact point its
support is n . (v - o). What the plane touches is linear in few parameters theta, whatever the normal's length:

    n . (v - o) = h(n) = x(n) . theta

- *Sections*, in a plane spanned by N_0 (normal of the first ray) and T_0 (along it), with n = rho (cos phi, sin phi) there:
  theta = (s, q, R, a, b): the contact point o + s N_0 + q T_0 at phi = 0, and the radius of curvature
  rho(phi) = R + a phi + b phi^2 / 2 (as rho = h + h''; eq. 3.21-3.23 for a = b = 0). The first two alone are a fixed
  curve that pierces the plane, the first three an osculating circle.
- *Points*, seen by two planes a view: theta are their coordinates.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields, replace
from typing import Self

import numpy as np

from extremal.estimator.camera import Array
from extremal.estimator.errors import InvalidInput

FIXED, CIRCLE = 2, 3  # parameters of a section
MOST = 5


@dataclass(frozen=True, eq=False)
class Features(ABC):
    """n features in V views, each of which shows L tangent planes of theirs (1 of a section, 2 of a point).

    Attributes:
        normals: (n, L, V, 3) unit normals in the camera frames; of sections on the side of N_0.
        sigma: (n, L, V) [rad] standard deviation of the plane's angle about the camera centre; infinite where not seen.
        origin: (n, 3) [m] near the contact points; frame: (n, 3, 3) rows N_0, T_0, N_0 x T_0 in the world.
        order: (n,) number of parameters.
    """

    normals: Array
    sigma: Array
    origin: Array
    frame: Array
    order: np.ndarray

    def __post_init__(self) -> None:
        n, planes, views = self.sigma.shape
        shapes = (self.normals.shape, self.origin.shape, self.frame.shape, self.order.shape)
        if shapes != ((n, planes, views, 3), (n, 3), (n, 3, 3), (n,)):
            raise InvalidInput(f"features of shapes {shapes} don't fit sigma {self.sigma.shape}")
        if not np.all(self.sigma > 0):
            raise InvalidInput("sigma of tangent planes must be positive [rad]; infinite leaves one out")
        for name, values in (("normals", self.normals), ("origin", self.origin), ("frame", self.frame)):
            if not np.all(np.isfinite(values)):
                raise InvalidInput(f"{name} of features hold a number that is not finite")
        if not np.all(np.any(self.normals, axis=-1)):
            raise InvalidInput("normals of features hold a vector of no length; accepted: unit vectors")

    def __len__(self) -> int:
        return len(self.order)

    @property
    def width(self) -> int:
        """Largest number of parameters."""
        return int(self.order.max(initial=FIXED))

    def take(self, rows: np.ndarray) -> Self:
        """The features [rows]."""
        return replace(self, **{f.name: getattr(self, f.name)[rows] for f in fields(Features)})

    @abstractmethod
    def columns(self, normals: Array) -> Array:
        """x(n) (..., width) for normals (n, L, V, 3) in the features' frames; zero beyond a feature's order."""

    @abstractmethod
    def contact(self, normals: Array, theta: Array) -> Array:
        """Contact points (n, L, V, 3) = dh/dn in the features' frames, from their origins, for theta (n, width)."""


class Sections(Features):
    """Contours, each by its section with a plane of its own: fixed curves and extremal boundaries."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not np.all((self.order >= FIXED) & (self.order <= MOST)):
            raise InvalidInput(f"order of a section is {np.unique(self.order)}; accepted: {FIXED} to {MOST}")

    def columns(self, normals: Array) -> Array:
        a, b = normals[..., 0], normals[..., 1]
        rho, phi = np.hypot(a, b), np.arctan2(b, a)
        versine = b * b / np.maximum(rho + np.abs(a), 1e-300)  # rho - a without cancellation
        versine = np.where(a < 0, rho - a, versine)
        terms = [a, b, versine, rho * phi - b, 0.5 * rho * phi**2 - versine]
        columns = np.stack(terms[: self.width], axis=-1)
        return columns * (np.arange(self.width) < self.order[:, None, None, None])

    def contact(self, normals: Array, theta: Array) -> Array:
        phi = np.arctan2(normals[..., 1], normals[..., 0])
        sine, cosine = np.sin(phi), np.cos(phi)
        h = [cosine, sine, 1 - cosine, phi - sine, 0.5 * phi**2 - 1 + cosine]
        slope = [-sine, cosine, sine, 1 - cosine, phi - sine]
        along = [theta[:, k, None, None] for k in range(self.width)]  # theta is zero beyond the order
        support = sum(t * x for t, x in zip(along, h, strict=False))
        turn = sum(t * x for t, x in zip(along, slope, strict=False))
        return np.stack([support * cosine - turn * sine, support * sine + turn * cosine, 0 * phi], axis=-1)


class Points(Features):
    """Fixed points (corners, dots), each seen by two planes through its ray."""

    def columns(self, normals: Array) -> Array:
        return normals

    def contact(self, normals: Array, theta: Array) -> Array:
        return np.broadcast_to(theta[:, None, None], normals.shape)
