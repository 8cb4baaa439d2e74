"""Distances of points from solids outside which they are, by compiled loops; NaN where that is not what they are.

`Surface.signed_distance` is the answer for any point.
"""

import math

import numpy as np

from extremal.estimator.camera import Array
from extremal.tasks.compiled import compiled
from extremal.tasks.level_sets import Solids, differential, inside, profile
from extremal.tasks.triples import Vector, crossed, dot, plus, times, unit

ITERATIONS, CONVERGED = 20, 1e-9  # [m]
SAMPLES = 400  # of a meridian
LEAST_CURVATURE = 0.1  # of half the squared distance along a meridian, in Newton's steps
HALVINGS = 40


@compiled
def from_box(half: Array, p: Vector) -> float:
    """Distance [m] of a point from a box, of half its size (3,), in its frame."""
    beyond = 0.0
    for j in range(3):
        beyond += max(abs(p[j]) - half[j], 0.0) ** 2
    return math.sqrt(beyond)


@compiled
def from_lathe(solids: Solids, k: int, meridian: Array, p: Vector) -> float:
    """Distance [m] of a point from lathe k, in its frame: of the side by the nearest of samples r (SAMPLES,) of its
    `meridian`, then Newton between their neighbours; and of the caps."""
    rho, z, height = math.hypot(p[0], p[1]), p[2], solids.shape[k, 0]
    spacing = height / (SAMPLES - 1)
    best, least = 0, np.inf
    for j in range(SAMPLES):
        off = (meridian[j] - rho) ** 2 + (j * spacing - z) ** 2
        if off < least:
            best, least = j, off
    low, high, x = max(best - 1, 0) * spacing, min(best + 1, SAMPLES - 1) * spacing, best * spacing
    for _ in range(ITERATIONS):
        r, r1, r2 = profile(solids, k, x)
        slope, curvature = (r - rho) * r1 + x - z, r1 * r1 + (r - rho) * r2 + 1
        before, x = x, min(max(x - slope / max(curvature, LEAST_CURVATURE), low), high)
        if abs(x - before) < CONVERGED:
            break
    r = profile(solids, k, x)[0]
    if rho < r and 0 < z < height:
        return np.nan
    bottom = math.hypot(max(rho - meridian[0], 0.0), z)
    top = math.hypot(max(rho - meridian[SAMPLES - 1], 0.0), z - height)
    return min(math.hypot(r - rho, x - z), bottom, top)


@compiled
def nearest(solids: Solids, k: int, start: Vector, y: Vector) -> tuple[Vector, Vector, float]:
    """The point x of smooth convex object k that is nearest to y, the outward normal n there, and its distance [m], in its frame.

    y - x is along n. By Newton in the tangent planes, from a point near x: with distance d and curvature S there,
    (1 + d S) dx is what y - x is off the normal.
    """
    x = n = start
    for _ in range(ITERATIONS):
        F, g, _ = differential(solids, k, x, x)
        steep = max(math.sqrt(dot(g, g)), 1e-300)
        n = times(1 / steep, g)
        u, v = tangents(n)
        Su = times(1 / steep, differential(solids, k, x, u)[2])
        Sv = times(1 / steep, differential(solids, k, x, v)[2])
        r = plus(y, -1.0, x)
        d = dot(r, n)
        a, b, c = 1 + d * dot(u, Su), d * dot(u, Sv), 1 + d * dot(v, Sv)
        p, q = dot(r, u), dot(r, v)
        det = a * c - b * b
        if det == 0:
            break
        step = plus(plus(times((c * p - b * q) / det, u), (a * q - b * p) / det, v), -F / steep, n)
        x = plus(x, 1.0, step)
        if max(abs(step[0]), abs(step[1]), abs(step[2])) < CONVERGED:
            return x, n, dot(plus(y, -1.0, x), n)
    return x, n, np.nan


@compiled
def radial(solids: Solids, k: int, y: Vector) -> Vector:
    """Where the line from the middle of convex object k to y leaves it, in its frame."""
    low, high = 0.0, 1.0
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        if inside(solids, k, times(middle, y)):
            low = middle
        else:
            high = middle
    return times(low, y)


@compiled
def tangents(n: Vector) -> tuple[Vector, Vector]:
    """Two unit vectors that complete a unit normal to a frame, as `scenes.surface.tangent_basis`."""
    x, y, z = abs(n[0]), abs(n[1]), abs(n[2])
    aside = (1.0, 0.0, 0.0) if x <= y and x <= z else (0.0, 1.0, 0.0) if y <= z else (0.0, 0.0, 1.0)
    u = unit(crossed(n, aside))
    return u, crossed(n, u)
