"""Curves on surfaces whose images are edges, and the appearance of what they bound."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from extremal.estimator.errors import SceneError

Array = NDArray[np.floating]
MOST_SAMPLES = (
    10_000  # of a curve: longer than 4 m they are sampled more coarsely, else one took minutes and gigabytes
)
Kind = Literal["extremal", "crease", "marking"]
Colour = tuple[float, float, float, float]


@dataclass(frozen=True, eq=False)
class SurfaceCurve:
    """An ordered polyline on a surface that may be seen as an image edge; world frame.

    Attributes:
        name: "object/curve", for instance "vase/limb0" or "box/edge+x+y".
        object: name of the object that carries it.
        kind: "extremal" (contour generator), "crease" or "marking".
        points: (N, 3) [m], in order; a closed curve repeats its first point at the end.
        normals: (N, 3) outward unit normals of the surface (for a crease: of one of its two faces).
        visible: (N,) bool; what it covers is said by the method that returned the curve.
        other_normals: (N, 3) normals of a crease's second face, else None.
    """

    name: str
    object: str
    kind: Kind
    points: Array
    normals: Array
    visible: NDArray[np.bool_]
    other_normals: Array | None = None


@dataclass(frozen=True)
class Appearance:
    """Colour and reflectance (OpenGL's Phong model, as MuJoCo draws it).

    Attributes:
        rgba: colour, each in [0, 1].
        specular: strength of highlights in [0, 1]; 0 is matte.
        shininess: sharpness of highlights in [0, 1].
    """

    rgba: Colour = (0.5, 0.5, 0.5, 1.0)
    specular: float = 0.0
    shininess: float = 0.0

    def __post_init__(self) -> None:
        check_colour("appearance", self.rgba)
        for name, value in (("specular", self.specular), ("shininess", self.shininess)):
            if not 0 <= value <= 1:
                raise SceneError(f"{name} is {value!r}; accepted: a number from 0 to 1")


@dataclass(frozen=True, eq=False)
class Piece:
    """A triangle mesh of one colour, object frame: vertices (V, 3) [m], normals (V, 3), faces (F, 3)."""

    vertices: Array
    normals: Array
    faces: NDArray[np.integer]
    rgba: Colour


def check_colour(what: str, rgba: Colour) -> None:
    """Raise SceneError unless `rgba` is four opaque-able numbers from 0 to 1."""
    if len(rgba) != 4 or not all(0 <= value <= 1 for value in rgba):
        raise SceneError(f"{what}: rgba is {rgba!r}; accepted: four numbers from 0 to 1")


def check_length(what: str, value: float) -> None:
    """Raise SceneError unless `value` is a length from 0.1 mm to 100 m."""
    if not (isinstance(value, int | float | np.number) and 1e-4 <= value <= 100):
        raise SceneError(f"{what} is {value!r}; accepted: a length from 0.0001 to 100 m")


def arc_samples(length: float, spacing: float = 5e-4) -> int:
    """Number of points on a curve of `length` [m] so that neighbours are at most `spacing` [m] apart, or of `MOST_SAMPLES`."""
    return min(max(2, int(np.ceil(length / spacing)) + 1), MOST_SAMPLES)
