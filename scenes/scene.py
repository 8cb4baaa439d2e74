"""Scenes: objects, lights and background, as a MuJoCo model and as exact truth."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from extremal.estimator.errors import SceneError
from extremal.scenes.curves import Array, SurfaceCurve
from extremal.scenes.grids import MEASURED, Facets
from extremal.scenes.matching import Truth, match
from extremal.scenes.mjcf import Spec, add_light, empty_world
from extremal.scenes.surface import Surface
from extremal.scenes.visibility import visible_edges

MOST_LIGHTS = 7  # OpenGL's fixed pipeline has eight; one stays free for the headlight


@dataclass(frozen=True)
class Light:
    """Directional white light without shadows.

    Attributes:
        direction: (3,) in which the light travels, world frame, of any length.
        diffuse, ambient, specular: strengths in [0, 1].
    """

    direction: tuple[float, float, float]
    diffuse: float = 0.6
    ambient: float = 0.0
    specular: float = 0.3

    def __post_init__(self) -> None:
        if len(self.direction) != 3 or not 1e-6 < np.linalg.norm(self.direction) < 1e6:
            raise SceneError(f"light direction is {self.direction!r}; accepted: three numbers, not all zero")
        for name in ("diffuse", "ambient", "specular"):
            if not 0 <= getattr(self, name) <= 1:
                raise SceneError(f"light {name} is {getattr(self, name)!r}; accepted: a number from 0 to 1")


@dataclass(frozen=True)
class Background:
    """What fills the frame beyond all objects: a sky of one colour, rgb in [0, 1]."""

    sky: tuple[float, float, float] = (0.85, 0.87, 0.9)

    def __post_init__(self) -> None:
        if len(self.sky) != 3 or not all(0 <= value <= 1 for value in self.sky):
            raise SceneError(f"sky is {self.sky!r}; accepted: three numbers from 0 to 1")


@dataclass(frozen=True, eq=False)
class Scene:
    """Objects on a table whose top is the world's plane z = 0.

    Attributes:
        objects: all that is drawn, the table (a `Box`) included; names differ.
        lights: up to seven.
        background: the sky.
        target: (3,) point [m] of the world that a camera should look at.
        name: for reports.
    """

    objects: tuple[Surface, ...]
    lights: tuple[Light, ...] = (Light((1, 0, -1), ambient=0.3),)
    background: Background = Background()
    target: tuple[float, float, float] = (0.0, 0.0, 0.1)
    name: str = "scene"

    def __post_init__(self) -> None:
        names = [surface.name for surface in self.objects]
        if not 1 <= len(names) <= 100:
            raise SceneError(f"the scene has {len(names)} objects; accepted: 1 to 100")
        for name in names:
            if names.count(name) > 1:
                raise SceneError(f"{names.count(name)} objects are called {name!r}; names must differ")
        if len(self.lights) > MOST_LIGHTS:
            raise SceneError(f"the scene has {len(self.lights)} lights; accepted: up to {MOST_LIGHTS}")
        if len(self.target) != 3 or not np.all(np.abs(self.target) <= 100):
            raise SceneError(f"target is {self.target!r}; accepted: three numbers within 100 m")

    def __getitem__(self, name: str) -> Surface:
        """The object called `name`; KeyError if there is none."""
        return {surface.name: surface for surface in self.objects}[name]

    def to_spec(self, facets: Facets = MEASURED) -> Spec:
        """The scene as a MuJoCo model, curved surfaces cut into facets: no shadows, no headlight, no floor plane, no camera."""
        spec = empty_world(self.name, self.background.sky)
        for i, light in enumerate(self.lights):
            add_light(spec, f"light{i}", light.direction, light.diffuse, light.ambient, light.specular)
        for surface in self.objects:
            surface.add_to(spec, facets)
        return spec

    def true_edges(self, centre: ArrayLike) -> list[SurfaceCurve]:
        """All true image edges seen from `centre` (3,): contour generators, creases, outlines of markings.

        `visible` is false where the curve's own object or another one hides it.
        """
        return visible_edges(self.objects, checked_centre(centre))

    def truth(
        self,
        centre: ArrayLike,
        rays: ArrayLike,
        tangent_planes: ArrayLike,
        epipolar_normals: ArrayLike,
        tolerance: float = 0.004,
    ) -> Truth:
        """What is true of image points tracked by a camera at `centre`.

        A point belongs to the visible true edge that is nearest, perpendicular to the edge, within `tolerance`,
        and whose orientation agrees within 25 degrees. Its truth is the point of that curve in its epipolar
        plane (by Newton on the surface for extremal boundaries); where the edge runs along that plane, the
        nearest point of the curve.

        Args:
            centre: (3,) camera centre, world [m].
            rays: (N, 3) world rays through the image points.
            tangent_planes: (N, 3) normals of the planes of ray and image tangent, of either sign.
            epipolar_normals: (N, 3) normals of the planes of ray and direction of travel, of either sign.
            tolerance: [rad].
        """
        c = checked_centre(centre)
        curves = visible_edges(self.objects, c)
        return match(self.objects, curves, c, rays, tangent_planes, epipolar_normals, tolerance)


def checked_centre(centre: ArrayLike) -> Array:
    """A camera centre (3,) as floats; SceneError if it is not one."""
    c = np.asarray(centre, float)
    if c.shape != (3,) or not np.all(np.isfinite(c)):
        raise SceneError(f"camera centre is {centre!r}; accepted: three finite numbers [m]")
    return c
