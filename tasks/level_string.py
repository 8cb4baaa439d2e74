"""Strings around an object in a horizontal plane: both ways, in milliseconds.

Where that plane is a plane of symmetry of the object, as at the level of an ellipsoid or superquadric, the normals of its
section lie in it: the offset's section is the section's offset, and a curve of it that is shortest in the plane is a geodesic
of the offset. If the object is higher than wide there is none shorter.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.spatial import ConvexHull, QhullError  # pyright: ignore[reportAttributeAccessIssue]

from extremal.scenes import Lathe, Superquadric, Surface
from extremal.scenes.curves import Array

Side = Literal["left", "right"]  # of an object, as a camera sees it
COUNT = 1440  # points of a section: chords cut less than 1e-6 m into a clearance, and shorten an arc by 1e-6 of it


@dataclass(frozen=True, eq=False)
class Section:
    """A star-shaped horizontal section of a surface, anticlockwise seen from above.

    Attributes:
        points: (COUNT, 3) [m], at equal steps of azimuth about the object's axis.
        normals: (COUNT, 3) of the surface there.
    """

    points: Array
    normals: Array

    @staticmethod
    def of(surface: Surface, level: float) -> "Section":
        """The section of an upright object at a height [m] above the world's plane z = 0."""
        azimuth = np.arange(COUNT) * (2 * np.pi / COUNT)
        rays = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(COUNT)], axis=1)
        middle = np.append(surface.T_world_object.translation[:2], level)
        points = middle + _reach(surface, middle, rays)[:, None] * rays
        return Section(points, surface.normals(points))

    def offset(self, clearance: float) -> Array:
        """(COUNT, 2) the section of the offset, where the surface does not bend along its meridians."""
        horizontal = self.normals[:, :2]
        return self.points[:, :2] + clearance * horizontal / np.sum(horizontal**2, axis=1, keepdims=True)

    def tangent_point(self, eye: Array, side: int) -> Array:
        """Point (3,) at which a horizontal ray from `eye` (3,) touches the section; side 1: on the left, -1: on the right."""
        across = self.points[:, :2] - eye[:2]
        axis = self.points[:, :2].mean(axis=0) - eye[:2]
        left = np.array([-axis[1], axis[0]])
        return self.points[np.argmax(side * np.arctan2(across @ left, across @ axis))]


def _reach(surface: Surface, middle: Array, rays: Array) -> Array:
    """Distances (N,) [m] from a point of the upright axis to the surface along horizontal rays (N, 3)."""
    T_world_object = surface.T_world_object
    if isinstance(surface, Lathe):
        return np.full(len(rays), surface.profile.spline(middle[2] - T_world_object.translation[2]))
    if isinstance(surface, Superquadric) and abs(middle[2] - T_world_object.translation[2]) < 1e-9:
        x, y, _ = np.abs(T_world_object.rotation.inv().apply(rays)).T
        k = 2 / surface.e2
        return ((x / surface.a) ** k + (y / surface.b) ** k) ** (-1 / k)
    return surface.intersect(middle, rays)


def ways_around(section: Section, start: Array, goal: Array, clearance: float) -> tuple[Array, Array] | None:
    """The strings (n, 3), level, pulled taut from start to goal that pass the section on their left, and on its right.

    The first goes to the right of the object as seen from the start, anticlockwise about it; the second to the left of it,
    clockwise. None where one of the ends is not outside the hull of all else, so that one way is straight.

    Args:
        section: the obstacle's.
        start, goal: (3,) [m]; their height is left out.
        clearance: [m].
    """
    points = np.concatenate([[start[:2], goal[:2]], section.offset(clearance)])
    try:
        ring = ConvexHull(points).vertices  # anticlockwise
    except QhullError:
        return None
    place = {int(vertex): i for i, vertex in enumerate(ring)}
    if 0 not in place or 1 not in place:
        return None
    ring = np.roll(ring, -place[0])
    goal_at = int(np.nonzero(ring == 1)[0][0])
    if goal_at in (1, len(ring) - 1):
        return None
    level = np.column_stack([points, np.full(len(points), section.points[0, 2])])
    return level[ring[: goal_at + 1]], level[np.append(ring[goal_at:], ring[0])[::-1]]


def polyline_length(points: Array) -> float:
    """[m]"""
    return float(np.sum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
