"""Images and poses in, surface shape with uncertainty out (Cipolla ch. 3; Cipolla and Blake, IJCV 1992)."""

from extremal.estimator.camera import Camera, View
from extremal.estimator.circle import OsculatingCircle, osculating_circle
from extremal.estimator.contours import Contours, find_contours
from extremal.estimator.errors import (
    DegenerateGeometry,
    ExtremalError,
    InvalidInput,
    RenderingError,
    SceneError,
)
from extremal.estimator.shape import Shape, estimate_shape

__all__ = [
    "Camera",
    "Contours",
    "DegenerateGeometry",
    "ExtremalError",
    "InvalidInput",
    "OsculatingCircle",
    "RenderingError",
    "SceneError",
    "Shape",
    "View",
    "estimate_shape",
    "find_contours",
    "osculating_circle",
]
