"""Images and poses in, surface shape with uncertainty out (Cipolla ch. 3; Cipolla and Blake, IJCV 1992)."""

from extremal.estimator.adjustment import Adjustment, adjust
from extremal.estimator.camera import Camera, View
from extremal.estimator.circle import OsculatingCircle, osculating_circle
from extremal.estimator.contours import Contours, find_contours
from extremal.estimator.errors import (
    DegenerateGeometry,
    ExtremalError,
    InvalidInput,
    NotConverged,
    RenderingError,
    SceneError,
)
from extremal.estimator.poses import PosePrior
from extremal.estimator.second_order import SecondOrderShape, second_order_shape
from extremal.estimator.sequential import LiveShape, SequentialShape
from extremal.estimator.shape import Shape, all_contours, estimate_shape, shape_from_contours
from extremal.estimator.support import Points, Sections

__all__ = [
    "Adjustment",
    "Camera",
    "Contours",
    "DegenerateGeometry",
    "ExtremalError",
    "InvalidInput",
    "LiveShape",
    "NotConverged",
    "OsculatingCircle",
    "Points",
    "PosePrior",
    "RenderingError",
    "SceneError",
    "SecondOrderShape",
    "Sections",
    "SequentialShape",
    "Shape",
    "View",
    "adjust",
    "all_contours",
    "estimate_shape",
    "find_contours",
    "osculating_circle",
    "second_order_shape",
    "shape_from_contours",
]
