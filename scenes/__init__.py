"""Objects with exact ground truth, and the MJCF they become."""

from extremal.scenes.box import Box
from extremal.scenes.lathe import Lathe
from extremal.scenes.loading import load_scene
from extremal.scenes.quadrics import Ellipsoid, Sphere
from extremal.scenes.scene import Scene

__all__ = ["Box", "Ellipsoid", "Lathe", "Scene", "Sphere", "load_scene"]
