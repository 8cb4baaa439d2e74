"""Which parts of the true edges a camera sees."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from extremal.scenes.curves import Array, SurfaceCurve
from extremal.scenes.surface import Surface

# Distance [m] before a point within which a hit is the point itself.
TOUCH = 1e-6


def visible_edges(objects: Sequence[Surface], centre: Array) -> list[SurfaceCurve]:
    """Contour generators and fixed curves of all objects, with `visible` after all occlusions.

    A marking is seen where its face looks at the camera, a crease where at least one of its faces does.
    """
    curves: list[SurfaceCurve] = []
    for surface in objects:
        limbs = surface.contour_generator(centre)
        others = [other for other in objects if other is not surface]
        curves += _without_hidden(limbs, centre, others)
        fixed = [replace(curve, visible=_faces_camera(curve, centre)) for curve in surface.fixed_curves()]
        curves += _without_hidden(fixed, centre, objects)
    return curves


def _faces_camera(curve: SurfaceCurve, centre: Array) -> NDArray[np.bool_]:
    ray = curve.points - centre
    facing = np.sum(curve.normals * ray, axis=1) < 0
    if curve.other_normals is not None:
        facing |= np.sum(curve.other_normals * ray, axis=1) < 0
    return facing


def _without_hidden(
    curves: list[SurfaceCurve], centre: Array, occluders: Sequence[Surface]
) -> list[SurfaceCurve]:
    """The curves with `visible` cleared where an occluder stands before them (one ray cast for all)."""
    if not curves:
        return []
    points = np.concatenate([curve.points for curve in curves])
    seen = np.concatenate([curve.visible for curve in curves])
    distance = np.linalg.norm(points - centre, axis=1)
    directions = (points - centre) / distance[:, None]
    for occluder in occluders:
        rows = np.nonzero(seen)[0]
        seen[rows] = occluder.intersect(centre, directions[rows]) >= distance[rows] - TOUCH
    parts = np.split(seen, np.cumsum([len(curve.points) for curve in curves])[:-1])
    return [replace(curve, visible=part) for curve, part in zip(curves, parts, strict=True)]
