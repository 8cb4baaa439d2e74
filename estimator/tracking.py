"""Tracking of contour points over a sequence by prediction from egomotion.

Every edgel of a reference view is one track. Its depth is found by sweeping it over the nearest views, with the
support of its neighbours on the contour; then the views are visited from near to far. An information filter on the
circle of eq. 3.23 predicts where the contour must cross the epipolar plane in the next view, so that an extremal
boundary, which slips over the surface, is followed as well as a fixed feature. What is not seen where it should be is
left out of that view only: a T-junction or a short occlusion does not end a track.
"""

from dataclasses import dataclass, fields

import numpy as np

from extremal.estimator.camera import Array
from extremal.estimator.circle_filter import CircleFilter
from extremal.estimator.contours import Contours
from extremal.estimator.epipolar import EpipolarPlanes, Sequence3D
from extremal.estimator.matching import ALIKE, Crossings, EdgelMap, cross, in_plane_sigma, loose_sigma
from extremal.estimator.pooling import window_sum
from extremal.estimator.slant import smoothed_tangent_planes

NEAREST, FARTHEST = 0.15, 4.0  # [m] depths that are searched
SWEEP_STEP = 1.5  # [px] between depths of the sweep, in the farthest view it uses
SWEEP_VIEWS = 4
SWEEP_WIDTH = 1.2  # [px] how near to a contour counts in the sweep, where poses are exact
SUPPORT = 7  # edgels along the contour that vote together in the sweep
PARALLEL = (
    0.08  # sine of the angle to its epipolar line below which a contour is followed, but not matched along it
)
GATE = 4.0  # standard deviations
LEAST_GATE = 1.0  # [px]


@dataclass(frozen=True, eq=False)
class Tracks:
    """n tracked contour points over V views.

    Attributes:
        reference: the view in which the points were chosen.
        contour: (n,) the reference view's contour on which each lies, non-decreasing.
        tangents: (n, 2) unit tangents [px] of that contour, its brighter side to their left.
        tangent_planes: (n, V, 3) unit normals of the tangent planes, of any sign, their slant smoothed over the views.
        ahead: (n,) component along the travel of the direction to the contour's brighter side.
        planes: their epipolar planes.
        seen: (n, V) whether the point was found in a view.
        pixels: (n, V, 2) the contour's crossing with the epipolar plane [px]; the prediction where not seen.
        rays: (n, V, 3) world rays through them. sigma: (n, V) [rad] of their angle in the epipolar plane; infinite
            where not seen.
        limb: (n, V) photometric evidence of a limb, curvature: (n, V) [1/px] of the contour, contrast: (n, V) [grey levels],
            as in Contours.
    """

    reference: int
    contour: np.ndarray
    tangents: Array
    tangent_planes: Array
    ahead: Array
    planes: EpipolarPlanes
    seen: np.ndarray
    pixels: Array
    rays: Array
    sigma: Array
    limb: Array
    curvature: Array
    contrast: Array


def track(
    sequence: Sequence3D,
    contours: list[Contours],
    maps: list[EdgelMap],
    reference: int,
    nearest: float = NEAREST,
) -> Tracks:
    """Tracks of the edgels of the reference view whose contour crosses their epipolar plane, from a depth `nearest` [m] on."""
    edgels = contours[reference]
    rays = sequence.rays(reference, edgels.positions)
    planes = EpipolarPlanes.through(sequence.centres[reference], sequence.travel, rays)
    tangent_planes, tilt, sigma = in_plane_sigma(
        sequence, reference, edgels.positions, edgels.normals, rays, planes, edgels.sigma
    )
    depth, found = _sweep(sequence, contours, maps, reference, rays, nearest)
    chosen = np.flatnonzero(found & np.isfinite(planes.normal[:, 0]))
    planes, rays, depth = planes.take(chosen), rays[chosen], depth[chosen]
    loose = np.abs(tilt[chosen]) < PARALLEL
    sigma = np.where(loose, loose_sigma(sequence, reference), sigma[chosen])
    direction = edgels.normals[chosen] @ sequence.rotations[reference][:, :2].T
    columns = [
        Crossings(
            np.ones(len(chosen), bool),
            direction,
            edgels.positions[chosen],
            rays,
            tangent_planes[chosen],
            sigma,
            edgels.limb[chosen],
            edgels.curvature[chosen],
            edgels.contrast[chosen],
        )
    ]
    order = [reference, *sequence.neighbours(reference)]
    latest = {
        True: direction,
        False: direction,
    }  # a contour turns in the image as the camera travels to either side
    state = CircleFilter(planes, rays, depth, np.hypot(sigma, sequence.pose_sigma(reference, depth)))
    for view in order[1:]:
        points, spread = state.predict(sequence.centres[view])
        ahead = bool((sequence.centres[view] - sequence.centres[reference]) @ sequence.travel > 0)
        crossing = cross(sequence, contours[view], maps[view], view, planes, points, latest[ahead], loose)
        sigma = np.hypot(
            crossing.sigma, sequence.pose_sigma(view, np.linalg.norm(points - sequence.centres[view], axis=1))
        )
        gate = LEAST_GATE / sequence.cameras[view].fx + GATE * np.hypot(spread, sigma)
        ok = crossing.found & (np.abs(state.innovation(sequence.centres[view], points, crossing.rays)) < gate)
        state.update(ok, sequence.centres[view], crossing.rays, sigma, points)
        latest[ahead] = np.where(ok[:, None], crossing.directions, latest[ahead])
        columns.append(_where_seen(ok, crossing, sequence, view, points, planes))
    back = np.argsort(order)
    stacked = {
        f.name: np.stack([getattr(c, f.name) for c in columns], axis=1)[:, back] for f in fields(Crossings)
    }
    return Tracks(
        reference,
        edgels.contour[chosen],
        np.stack([-edgels.normals[chosen, 1], edgels.normals[chosen, 0]], axis=1),
        smoothed_tangent_planes(
            stacked["tangent_planes"], stacked["rays"], planes.normal, stacked["found"], reference
        ),
        direction @ sequence.travel,
        planes,
        stacked["found"],
        stacked["pixels"],
        stacked["rays"],
        stacked["sigma"],
        stacked["limb"],
        stacked["curvature"],
        stacked["contrast"],
    )


def _sweep(
    sequence: Sequence3D,
    contours: list[Contours],
    maps: list[EdgelMap],
    reference: int,
    rays: Array,
    nearest: float,
) -> tuple[Array, np.ndarray]:
    """Depth (n,) [m] along each ray at which the nearest views show most edges, and whether they do."""
    centre = sequence.centres[reference]
    views = sequence.neighbours(reference)[:SWEEP_VIEWS]
    farthest = max(np.linalg.norm(sequence.centres[v] - centre) for v in views)
    disparity = sequence.cameras[reference].fx * farthest * (1 / nearest - 1 / FARTHEST)
    inverse = np.linspace(1 / FARTHEST, 1 / nearest, int(np.clip(disparity / SWEEP_STEP, 32, 1024)))
    direction = contours[reference].normals @ sequence.rotations[reference][:, :2].T
    # a point at inverse depth w projects like p + w (v_ref - v_view): linear in w
    score = np.zeros((len(rays), len(inverse)), np.float32)
    for view in views:
        rotation = sequence.rotations[view]
        ray, shift = rays @ rotation, (centre - sequence.centres[view]) @ rotation
        at = sequence.cameras[view].project(ray[:, None] + inverse[:, None] * shift)
        index = maps[view].lookup(at)
        hit = np.flatnonzero(index >= 0)
        there = index.ravel()[hit]
        wanted = direction @ rotation[:, :2]
        normal = contours[view].normals[there]
        alike = np.sum(wanted[hit // len(inverse)] * normal, axis=1) > ALIKE
        off = np.sum((at.reshape(-1, 2)[hit] - contours[view].positions[there]) * normal, axis=1)
        pose = np.hypot(*(sequence.pose_sigma(v, 1 / inverse) for v in (reference, view)))
        width = np.hypot(SWEEP_WIDTH, pose * sequence.cameras[view].fx)[hit % len(inverse)]
        score.ravel()[hit] += alike * np.exp(-0.5 * (off / width) ** 2)
    total, neighbours = window_sum(score, contours[reference].contour, SUPPORT // 2)
    pooled = total / neighbours[:, None]
    best = np.argmax(pooled, axis=1)
    rows = np.arange(len(rays))
    found = pooled[rows, best] > 0.5 * min(len(views), 2)
    return 1 / inverse[best], found


def _where_seen(
    ok: np.ndarray,
    crossing: Crossings,
    sequence: Sequence3D,
    view: int,
    points: Array,
    planes: EpipolarPlanes,
) -> Crossings:
    """The crossing where it passed the gate, elsewhere the prediction with infinite sigma."""
    expected = points - sequence.centres[view]
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    return Crossings(
        ok,
        crossing.directions,
        np.where(ok[:, None], crossing.pixels, sequence.project(view, points)),
        np.where(ok[:, None], crossing.rays, expected),
        np.where(ok[:, None], crossing.tangent_planes, planes.normal),
        np.where(ok, crossing.sigma, np.inf),
        np.where(ok, crossing.limb, 0.0),
        np.where(ok, crossing.curvature, 0.0),
        np.where(ok, crossing.contrast, 0.0),
    )
