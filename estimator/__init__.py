"""Images and poses in, surface shape with uncertainty out (Cipolla ch. 3; Cipolla and Blake, IJCV 1992)."""

from extremal.estimator.camera import Camera, View
from extremal.estimator.errors import ExtremalError

__all__ = ["Camera", "ExtremalError", "View"]
