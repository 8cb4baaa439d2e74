"""What a sensor tells while the camera moves: tracked contour points with their radii.

Two sensors have one interface. `RenderedSensor` looks at rendered frames through the vision pipeline; `GeometricSensor` draws
the errors of edges from a model instead. Both follow the same rules (`track_sets`, `section_tracks`).
"""

from dataclasses import dataclass, fields, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from extremal.estimator.camera import Array, Camera
from extremal.estimator.errors import InvalidInput
from extremal.estimator.sequential import CONFIDENCE
from extremal.scenes import Scene


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
        n = len(self.radius)
        for name, tail in _TAILS.items():
            if getattr(self, name).shape != (n, *tail):
                raise InvalidInput(
                    f"{name} of features is {getattr(self, name).shape}; accepted: {(n, *tail)}"
                )
        for name in ("sigma_radius", "sigma_relative"):
            if n and not getattr(self, name).min() >= 0:
                raise InvalidInput(f"{name} of features must be 0, positive or infinite [m]")

    def __len__(self) -> int:
        return len(self.radius)

    @property
    def best_radius(self) -> Array:
        """(n,) [m] relative to references where there are any, absolute elsewhere."""
        return np.where(np.isfinite(self.sigma_relative), self.relative_radius, self.radius)

    @property
    def best_sigma(self) -> Array:
        """(n,) [m] of `best_radius`."""
        return np.where(np.isfinite(self.sigma_relative), self.sigma_relative, self.sigma_radius)

    @property
    def significance(self) -> Array:
        """(n,) |R| / sigma, by which a point is labelled; 0 where nothing is known."""
        return np.abs(np.nan_to_num(self.best_radius)) / np.maximum(self.best_sigma, 1e-12)

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
        return replace(self, visible=np.zeros(len(self), bool))

    def and_then(self, others: "Features") -> "Features":
        """These features, then others, whose contours have other numbers."""
        if not len(others) or not len(self):
            return others if not len(self) else self
        both = {name: np.concatenate([getattr(self, name), getattr(others, name)]) for name in _TAILS}
        both["contour"][len(self) :] += self.contour.max() + 1
        return Features(**both)


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
    n, best = len(normal), held or free
    side = np.where(best.radius < 0, -1.0, 1.0)
    known = np.isfinite(best.sigma)
    none, unknown = np.full(n, np.nan), np.full(n, np.inf)
    return Features(
        side * free.radius,
        free.sigma,
        side * held.radius if held else none,
        held.sigma if held else unknown,
        position,
        covariance,
        side[:, None] * normal,
        plane,
        known & (np.abs(best.radius) > CONFIDENCE * best.sigma),
        reference,
        contour,
        pixels,
        visible,
        views,
    )


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
    away = features.position - eye
    off2 = position**2 + rotation**2 * np.vecdot(away, away)
    return replace(
        features,
        sigma_radius=np.sqrt(features.sigma_radius**2 + off2),
        covariance=features.covariance + off2[:, None, None] * np.eye(3),
    )
