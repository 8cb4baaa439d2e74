"""What a camera that is not quite where it is believed to be sees of contact points: compiled loops over n tracks.

Poses are matrices T_world_camera (4, 4).
"""

import math

import numpy as np
from numpy.typing import NDArray

from extremal.estimator.camera import Array
from extremal.tasks.compiled import compiled
from extremal.tasks.contacts import FixedCurves, advanced
from extremal.tasks.level_sets import Solids
from extremal.tasks.rigid import place
from extremal.tasks.triples import Vector, crossed, dot, plus, put, row, times, turned, turned_back, unit

LEAST_SLOPE = 1e-9  # [1/px]


@compiled
def believed_planes(plane: Array, start: Array, points: Array, actual: Array, believed: Array) -> Array:
    """Normals (n, 3) of the epipolar planes, of normals `plane` (n, 3) through `start` (3,), as the robot believes them to lie: off the
    planes of a camera that left its line by a height, where a point at the contact's distance would lie in them.

        e = R_actual R_believed' e_0 + (e_0 . (v_believed - v_0) / |d|^2) d,    d = r - v_actual
    """
    out = np.empty(plane.shape)
    off = plus(place(believed), -1.0, (start[0], start[1], start[2]))
    for i in range(len(plane)):
        e = row(plane, i)
        d = plus(row(points, i), -1.0, place(actual))
        there = turned(actual, turned_back(believed, e))
        put(out, i, plus(there, dot(e, off) / dot(d, d), d))
    return out


@compiled
def followed(
    solids: Solids,
    curves: FixedCurves,
    points: Array,
    normals: Array,
    surface: NDArray[np.integer],
    curve: NDArray[np.integer],
    u: Array,
    plane: Array,
    start: Array,
    actual: Array,
    believed: Array,
) -> tuple[Array, Array, NDArray[np.bool_], Array, Array, Array, Vector]:
    """`advanced` contacts where `believed_planes` meet the contours; and those as `in_camera` has them."""
    planes = believed_planes(plane, start, points, actual, believed)
    points, normals, there, u = advanced(
        solids, curves, points, normals, surface, curve, u, place(actual), planes
    )
    away, ideal, line = in_camera(points, actual, believed)
    return points, normals, there, u, away, ideal, line


@compiled
def in_camera(points: Array, actual: Array, believed: Array) -> tuple[Array, Array, Vector]:
    """Points (n, 3) in the camera frame [m]; their ideal image coordinates (n, 2) = (X/Z, Y/Z), NaN behind the camera; and the middle
    of the rays to them in the world as believed, a unit vector."""
    out, ideal, middle = np.empty(points.shape), np.full((len(points), 2), np.nan), (0.0, 0.0, 0.0)
    for i in range(len(points)):
        p = turned_back(actual, plus(row(points, i), -1.0, place(actual)))
        put(out, i, p)
        if p[2] > 0:
            ideal[i, 0], ideal[i, 1] = p[0] / p[2], p[1] / p[2]
        middle = plus(middle, 1.0, unit(p))
    return out, ideal, unit(turned(believed, middle))


@compiled
def sighted(
    away: Array,
    normals: Array,
    plane: Array,
    travel: Array,
    actual: Array,
    believed: Array,
    focal: tuple[float, float],
    error: Array,
    noise: float,
    pixels: Array,
    there: NDArray[np.bool_],
    hidden: NDArray[np.bool_],
    found: NDArray[np.bool_],
    size: tuple[int, int],
) -> tuple[Array, Array, Array]:
    """Tangent planes (n, 3), their sigma (n,) [rad] and the shift (n, 2) [px] of the edges: see `tangent_planes`, `sigma_of_seen`."""
    planes, per_px, shift = tangent_planes(away, normals, plane, travel, actual, believed, focal, error)
    return planes, sigma_of_seen(noise, per_px, pixels, there, hidden, found, size), shift


@compiled
def tangent_planes(
    away: Array,
    normals: Array,
    plane: Array,
    travel: Array,
    actual: Array,
    believed: Array,
    focal: tuple[float, float],
    error: Array,
) -> tuple[Array, Array, Array]:
    """Tangent planes of edges that are seen off by `error` (n,) [px], in the camera frame.

    Args:
        away: (n, 3) contact points in the camera frame [m]. normals: (n, 3) of the surface there, in the world.
        plane: (n, 3), travel: (3,) epipolar planes and the camera's motion as believed.
        focal: [px].

    Returns:
        Normals (n, 3), to the side that looks along the travel; radians per pixel of error (n,), 0 or less behind the camera;
        and by how much the error moves the edge in the image (n, 2) [px].
    """
    out, per_px, shift = np.empty(away.shape), np.empty(len(away)), np.empty((len(away), 2))
    forwards = turned_back(believed, (travel[0], travel[1], travel[2]))
    for i in range(len(away)):
        ray, n = unit(row(away, i)), turned_back(actual, row(normals, i))
        across = crossed(ray, turned_back(believed, row(plane, i)))
        if dot(across, forwards) * dot(n, across) < 0:
            n = times(-1.0, n)
        x, y = n[0] / focal[0], n[1] / focal[1]
        slope = max(math.sqrt(x * x + y * y), LEAST_SLOPE)
        per_px[i] = slope * ray[2]
        put(out, i, unit(plus(n, error[i] * per_px[i], ray)))
        shift[i, 0], shift[i, 1] = -error[i] / slope * x, -error[i] / slope * y
    return out, per_px, shift


@compiled
def sigma_of_seen(
    noise: float,
    per_px: Array,
    pixels: Array,
    there: NDArray[np.bool_],
    hidden: NDArray[np.bool_],
    found: NDArray[np.bool_],
    size: tuple[int, int],
) -> Array:
    """Sigma (n,) [rad] of `noise` [px], infinite unless an edge is there, not hidden, found, and its pixel (n, 2) within an image of
    that size (width, height)."""
    sigma = np.full(len(pixels), np.inf)
    for i in range(len(pixels)):
        x, y = pixels[i, 0], pixels[i, 1]
        within = -0.5 <= x <= size[0] - 0.5 and -0.5 <= y <= size[1] - 0.5
        if there[i] and found[i] and not hidden[i] and within:
            sigma[i] = noise * per_px[i]
    return sigma


@compiled
def last_pixels(before: Array, now: Array, shift: Array, seen: NDArray[np.bool_]) -> Array:
    """Pixels (n, 2) now, off by `shift` (n, 2), where they were seen (n,), or never before (NaN); elsewhere those before."""
    out = before.copy()
    for i in range(len(seen)):
        for j in range(2):
            if seen[i] or math.isnan(before[i, j]):
                out[i, j] = now[i, j] + shift[i, j]
    return out
