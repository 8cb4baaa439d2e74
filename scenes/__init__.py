"""Objects with exact ground truth, and the MJCF they become."""

from extremal.scenes.box import Box
from extremal.scenes.curves import Appearance, SurfaceCurve
from extremal.scenes.lathe import Lathe
from extremal.scenes.loading import load_scene
from extremal.scenes.markings import BoxPatch, LathePatch
from extremal.scenes.matching import Truth
from extremal.scenes.mesh import Mesh
from extremal.scenes.quadrics import Ellipsoid, Sphere
from extremal.scenes.randomise import randomised
from extremal.scenes.scene import Background, Light, Scene
from extremal.scenes.superquadric import Superquadric
from extremal.scenes.surface import Surface

__all__ = [
    "Appearance",
    "Background",
    "Box",
    "BoxPatch",
    "Ellipsoid",
    "Lathe",
    "LathePatch",
    "Light",
    "Mesh",
    "Scene",
    "Sphere",
    "Superquadric",
    "Surface",
    "SurfaceCurve",
    "Truth",
    "load_scene",
    "randomised",
]
