"""What a sensor tells while the camera moves: tracked contour points with their radii.

Two sensors have one interface. `RenderedSensor` looks at rendered frames through the vision pipeline; `GeometricSensor` draws
the errors of edges from a model instead. Both follow the same rules (`track_sets`, `section_tracks`).
"""

import math
from dataclasses import dataclass, fields
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from extremal.estimator.camera import Array, Camera
from extremal.estimator.errors import InvalidInput
from extremal.estimator.sequential import CONFIDENCE
from extremal.scenes import Scene
from extremal.tasks.compiled import compiled
from extremal.tasks.triples import Vector, dot, plus, row


@dataclass(frozen=True, eq=False)
class Features:
    """n tracked contour points, in the world as it is believed to be.

    The section is that by the track's epipolar plane. Its radius is positive where the object is convex about `normal`; which
    way the normal points is itself estimated, so that `best_radius` is never negative.

    Attributes:
        radius, sigma_radius: (n,) [m] from all looks at the contour itself; sigma is infinite where nothing is known yet.
        relative_radius, sigma_relative: (n,) [m] given that the bootstrapped references are fixed (eq. 2.57-2.59, of all
            references at once); NaN and infinite where there are none. Of a reference itself, given the others.
        position: (n, 3) [m] contact point in the middle of the arc that was seen; covariance: (n, 3, 3) [m^2], in the plane.
        normal: (n, 3) unit normal there, out of the object. plane: (n, 3) unit normal of the section's plane.
        extremal: (n,) label by eq. 3.27: R is not zero at 95 %. reference: (n,) serves as a fixed reference.
        contour: (n,) number of the image contour on which a track started.
        pixels: (n, 2) where it was last seen. visible: (n,) whether it was in the last look that was taken in.
        views: (n,) number of looks in which it was.
    """

    radius: Array
    sigma_radius: Array
    relative_radius: Array
    sigma_relative: Array
    position: Array
    covariance: Array
    normal: Array
    plane: Array
    extremal: NDArray[np.bool_]
    reference: NDArray[np.bool_]
    contour: NDArray[np.integer]
    pixels: Array
    visible: NDArray[np.bool_]
    views: NDArray[np.integer]

    def __post_init__(self) -> None:
        n, values = len(self.radius), self.__dict__
        for name, tail in _TAILS.items():
            if values[name].shape != (n, *tail):
                raise InvalidInput(f"{name} of features is {values[name].shape}; accepted: {(n, *tail)}")
        for name in ("sigma_radius", "sigma_relative"):
            if not _are_sigmas(values[name]):
                raise InvalidInput(f"{name} of features must be 0, positive or infinite [m]")

    def __len__(self) -> int:
        return len(self.radius)

    @property
    def best_radius(self) -> Array:
        """(n,) [m] relative to references where there are any, absolute elsewhere."""
        return _where_finite(self.sigma_relative, self.relative_radius, self.radius)

    @property
    def best_sigma(self) -> Array:
        """(n,) [m] of `best_radius`."""
        return _where_finite(self.sigma_relative, self.sigma_relative, self.sigma_radius)

    @property
    def significance(self) -> Array:
        """(n,) |R| / sigma, by which a point is labelled; 0 where nothing is known."""
        return np.abs(np.nan_to_num(self.best_radius)) / np.maximum(self.best_sigma, 1e-12)

    def make_sense(self) -> bool:
        """Whether every place is a number, and every radius of a finite sigma."""
        return _are_numbers(self.radius, self.sigma_radius, self.position)

    @staticmethod
    def empty() -> "Features":
        """No tracks."""
        zero, many = np.zeros(0), np.zeros((0, 3))
        no, count = np.zeros(0, bool), np.zeros(0, int)
        return Features(
            zero,
            zero,
            zero,
            zero,
            many,
            np.zeros((0, 3, 3)),
            many,
            many,
            no,
            no,
            count,
            many[:, :2],
            no,
            count,
        )

    def take(self, rows: NDArray[np.integer] | NDArray[np.bool_]) -> "Features":
        """The features [rows]."""
        return Features(*(getattr(self, name)[rows] for name in _TAILS))

    def left(self) -> "Features":
        """As they stay when their tracks are given up."""
        return self.changed(visible=np.zeros(len(self), bool))

    def changed(self, **values: NDArray[Any]) -> "Features":
        """The same with other values, of the same shapes and as acceptable: they are not looked at again."""
        changed = object.__new__(Features)
        changed.__dict__.update(self.__dict__, **values)
        return changed

    def and_then(self, others: "Features") -> "Features":
        """These features, then others, whose contours have other numbers."""
        if not len(others) or not len(self):
            return others if not len(self) else self
        both = {name: np.concatenate([getattr(self, name), getattr(others, name)]) for name in _TAILS}
        both["contour"][len(self) :] += self.contour.max() + 1
        return self.changed(**both)


_TAILS = {field.name: () for field in fields(Features)} | {
    "position": (3,), "covariance": (3, 3), "normal": (3,), "plane": (3,), "pixels": (2,)
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Radii:
    """Signed radii (n,) [m] about the tangent planes' normals as they are measured, with sigma."""

    radius: Array
    sigma: Array


def labelled(
    free: Radii,
    held: Radii | None,
    position: Array,
    covariance: Array,
    normal: Array,
    plane: Array,
    reference: NDArray[np.bool_],
    contour: NDArray[np.integer],
    pixels: Array,
    visible: NDArray[np.bool_],
    views: NDArray[np.integer],
) -> Features:
    """Features of n tracks, of radii without references and with them, if there are any; normals (n, 3) of either sign."""
    best = held or free
    absolute, relative, sigma, outward, extremal = _sided(
        free.radius, best.radius, best.sigma, normal, held is not None
    )
    return Features(
        absolute,
        free.sigma,
        relative,
        sigma,
        position,
        covariance,
        outward,
        plane,
        extremal,
        reference,
        contour,
        pixels,
        visible,
        views,
    )


@compiled
def _where_finite(sigma: Array, a: Array, b: Array) -> Array:
    """Of numbers (n,) a where sigma (n,) is finite, elsewhere b."""
    out = np.empty(len(sigma))
    for i in range(len(sigma)):
        out[i] = a[i] if math.isfinite(sigma[i]) else b[i]
    return out


@compiled
def _are_sigmas(values: Array) -> bool:
    """Whether no number (n,) is negative or none at all."""
    return bool(np.all(values >= 0))


@compiled
def _are_numbers(radius: Array, sigma: Array, position: Array) -> bool:
    for i in range(len(radius)):
        if math.isnan(radius[i]) and math.isfinite(sigma[i]):
            return False
        for j in range(3):
            if math.isnan(position[i, j]):
                return False
    return True


@compiled
def _sided(
    free: Array, best: Array, sigma: Array, normal: Array, is_held: bool
) -> tuple[Array, Array, Array, Array, NDArray[np.bool_]]:
    """Radii (n,) `free` and `best`, about the normals (n, 3) about which the best are positive, `sigma` (n,) of the latter, none if
    these are not held, the normals, and whether (n,) the best are no zeros."""
    n = len(best)
    absolute, outward, extremal = np.empty(n), np.empty((n, 3)), np.empty(n, np.bool_)
    relative, relative_sigma = np.full(n, np.nan), np.full(n, np.inf)
    for i in range(n):
        side = -1.0 if best[i] < 0 else 1.0
        absolute[i] = side * free[i]
        if is_held:
            relative[i], relative_sigma[i] = side * best[i], sigma[i]
        for j in range(3):
            outward[i, j] = side * normal[i, j]
        extremal[i] = math.isfinite(sigma[i]) and abs(best[i]) > CONFIDENCE * sigma[i]
    return absolute, relative, relative_sigma, outward, extremal


class FeatureSensor(Protocol):
    """A camera that follows contours; a look is one view."""

    def reset(self, scene: Scene, camera: Camera, rng: np.random.Generator) -> None:
        """Forget everything; a new scene. `rng` is the only source of randomness until the next reset."""
        ...

    def look(self, T_world_camera: Array, T_world_camera_believed: Array, pose_covariance: Array) -> Features:
        """Look from where the camera actually is; all that is told is in the world as it is believed to be.

        Args:
            T_world_camera: (4, 4) actual pose.
            T_world_camera_believed: (4, 4) as the robot believes it, independently off in every look; pose_covariance: (6, 6) of
                that error, (translation [m], rotation vector [rad]) in the camera frame, of the same rank in all looks.

        Raises InvalidInput before `reset`, and for poses or covariances that are none.
        """
        ...

    @property
    def frame(self) -> NDArray[np.uint8] | None:
        """Image (height, width) of the last look in grey levels; None where there is none."""
        ...

    def close(self) -> None:
        """Free what the sensor holds; `reset` opens it again."""
        ...


def with_mounting(features: Features, eye: Array, position: float, rotation: float) -> Features:
    """Features with what a wrong mounting of the camera adds to their uncertainty.

    Turned about what it fixates, a camera that is off by h across its axis sees every tangent pass h farther out: all radii
    are larger by h. Differences between radii are not.

    Args:
        eye: (3,) [m] camera centre.
        position, rotation: standard deviations of the mounting, each axis [m], [rad].
    """
    sigma, covariance = _with_mounting(
        features.sigma_radius, features.covariance, features.position, tuple(eye.tolist()), position, rotation
    )
    return features.changed(sigma_radius=sigma, covariance=covariance)


@compiled
def _with_mounting(
    sigma: Array, covariance: Array, points: Array, eye: Vector, position: float, rotation: float
) -> tuple[Array, Array]:
    """Sigma (n,) of radii and covariances (n, 3, 3) of points (n, 3), off by `position` and `rotation` times the distance besides."""
    sigma, covariance = sigma.copy(), covariance.copy()
    for i in range(len(sigma)):
        away = plus(row(points, i), -1.0, eye)
        off2 = position * position + rotation * rotation * dot(away, away)
        sigma[i] = math.sqrt(sigma[i] * sigma[i] + off2)
        for j in range(3):
            covariance[i, j, j] += off2
    return sigma, covariance
