"""What hides points of a scene from a camera.

Boxes are exact. Smooth objects are found on samples of the line of sight: between two of them a chord of a few millimetres can
pass an object unseen, a fraction of a pixel inside its silhouette.
"""

import math

import numpy as np
from numpy.typing import NDArray

from extremal.estimator.camera import Array
from extremal.tasks.compiled import compiled
from extremal.tasks.level_sets import BOX, Solids, inside, local
from extremal.tasks.triples import Vector, dot, plus, row

SAMPLES = 24  # along a line of sight, within the sphere around an object
MARGIN = 0.003  # [m] before a point within which nothing hides it
FLAT = 1e-15  # [m] of a line of sight along an axis, below which it lies within a face's plane


@compiled
def hidden(solids: Solids, centre: Vector, points: Array) -> NDArray[np.bool_]:
    """Whether (n,) objects stand between a centre [m] and points (n, 3) [m]."""
    out = np.zeros(len(points), np.bool_)
    for k in range(len(solids.kind)):
        c = local(solids, k, centre)
        for i in range(len(points)):
            if not out[i]:
                d = plus(local(solids, k, row(points, i)), -1.0, c)
                out[i] = (
                    _box_between(solids.shape[k], c, d)
                    if solids.kind[k] == BOX
                    else _between(solids, k, c, d)
                )
    return out


@compiled
def _box_between(half: Array, c: Vector, d: Vector) -> bool:
    """Whether a box, of half its size (3,), meets c + t d for a t from 0 to almost 1: by its pairs of faces."""
    enter, leave = -np.inf, np.inf
    for j in range(3):
        slow = d[j] if abs(d[j]) > FLAT else FLAT
        one, other = (-half[j] - c[j]) / slow, (half[j] - c[j]) / slow
        enter, leave = max(enter, min(one, other)), min(leave, max(one, other))
    first = enter if enter > 0 else leave
    return enter <= leave and leave > 0 and first < _end(d)


@compiled
def _between(solids: Solids, k: int, c: Vector, d: Vector) -> bool:
    """Whether c + t d is inside smooth object k, in its frame, on samples of t from 0 to almost 1 in the sphere around it."""
    away = plus(row(solids.ball, k), -1.0, c)
    square = max(dot(d, d), FLAT)
    along = dot(d, away) / square
    room = solids.ball[k, 3] ** 2 - dot(away, away) + along * along * square
    if not room > 0:
        return False
    half = math.sqrt(room / square)
    start, end = max(along - half, 0.0), min(along + half, _end(d))
    if start < end:
        for j in range(SAMPLES):
            if inside(solids, k, plus(c, start + (j + 0.5) / SAMPLES * (end - start), d)):
                return True
    return False


@compiled
def _end(d: Vector) -> float:
    return 1 - MARGIN / max(math.sqrt(dot(d, d)), FLAT)
