"""How near a sphere comes to the objects of a scene."""

import numpy as np

from extremal.estimator.camera import Array
from extremal.scenes import Scene, Surface

FAR = 0.15  # [m] from which a bound on a distance will do
CHECKED = 0.004  # [m] between points of a step at which distance is measured


def gap(scene: Scene, points: Array, radius: float) -> float:
    """Smallest distance [m] from the surface of a sphere with its centre at points (n, 3) to any object; a lower bound where
    that is far."""
    return min(_distance(surface, points) for surface in scene.objects) - radius


def between(start: Array, end: Array) -> Array:
    """Points (n, 3) of a step, CHECKED apart, its end the last."""
    count = 1 + int(np.linalg.norm(end - start) / CHECKED)
    return start + np.linspace(0, 1, count + 1)[1:, None] * (end - start)


def _distance(surface: Surface, points: Array) -> float:
    centre, radius = surface.bounding_sphere
    beyond = float(np.min(np.linalg.norm(points - centre, axis=1)) - radius)
    return beyond if beyond > FAR else float(np.min(surface.signed_distance(points)))
