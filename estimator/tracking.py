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
from extremal.estimator.contours import Contours
from extremal.estimator.epipolar import EpipolarPlanes, Sequence3D
from extremal.estimator.pooling import window_sum

NEAREST, FARTHEST = 0.15, 4.0  # [m] depths that are searched
SWEEP_STEP = 1.5  # [px] between depths of the sweep, in the farthest view it uses
SWEEP_VIEWS = 4
SWEEP_WIDTH = 1.2  # [px] how near to a contour counts in the sweep
REACH = 4  # [px] radius in which an edgel is looked for, where poses are exact
FARTHEST_REACH = 14  # [px] the same at the most
SUPPORT = 7  # edgels along the contour that vote together in the sweep
PARALLEL = (
    0.08  # sine of the angle to its epipolar line below which a contour is followed but not matched along it
)
ALIKE = np.cos(np.deg2rad(30.0))  # directions of a contour that may match
RADIUS_PRIOR = 0.06  # [m] standard deviation of R before anything is seen
GATE = 4.0  # standard deviations
LEAST_GATE = 1.0  # [px]


@dataclass(frozen=True, eq=False)
class Tracks:
    """n tracked contour points over V views.

    Attributes:
        reference: the view in which the points were chosen.
        contour: (n,) the reference view's contour on which each lies, non-decreasing.
        tangents: (n, 2) unit tangents [px] of that contour, its brighter side to their left.
        tangent_planes: (n, 3) unit normals of the tangent planes in the reference view.
        ahead: (n,) component along the travel of the direction to the contour's brighter side.
        planes: their epipolar planes.
        seen: (n, V) whether the point was found in a view.
        pixels: (n, V, 2) the contour's crossing with the epipolar plane [px]; the prediction where not seen.
        rays: (n, V, 3) world rays through them. sigma: (n, V) [rad] of their angle in the epipolar plane; infinite
            where not seen.
        limb: (n, V) photometric evidence of a limb, curvature: (n, V) [1/px] of the contour, as in Contours.
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


class EdgelMap:
    """Which edgel of a view is nearest to a pixel, within `reach` [px]."""

    def __init__(self, contours: Contours, width: int, height: int, reach: int) -> None:
        self.width, self.height, self.reach = width, height, reach
        self.index = np.full((height + 2 * reach, width + 2 * reach), -1, np.int32)
        if len(contours.u) == 0:
            return
        breaks = contours.splines.breaks
        first = np.searchsorted(contours.contour, np.arange(len(breaks) - 1))
        u = np.arange(contours.u[0], contours.u[-1], 1.0)
        nearest = np.clip(np.searchsorted(contours.u, u), 1, len(contours.u) - 1)
        nearest -= (u - contours.u[nearest - 1]) < (contours.u[nearest] - u)
        within = contours.contour[nearest] == contours.splines.contour_of(u)
        u, nearest = u[within & (len(first) > 0)], nearest[within]
        x, y = np.rint(contours.splines.curve(u)).astype(int).T + reach
        inside = (x >= reach) & (x < width + reach) & (y >= reach) & (y < height + reach)
        x, y, nearest = x[inside], y[inside], nearest[inside]
        steps = np.mgrid[-reach : reach + 1, -reach : reach + 1].reshape(2, -1).T
        steps = steps[(steps**2).sum(axis=1) <= reach**2]
        for dy, dx in steps[np.argsort(-(steps**2).sum(axis=1), kind="stable")]:
            self.index[y + dy, x + dx] = nearest

    def lookup(self, pixels: Array) -> np.ndarray:
        """Edgel (...) near pixels (..., 2), -1 where there is none."""
        with np.errstate(invalid="ignore"):
            x, y = np.rint(pixels[..., 0]), np.rint(pixels[..., 1])
            inside = (x >= 0) & (x < self.width) & (y >= 0) & (y < self.height)
        x = np.where(inside, x, 0).astype(np.intp)
        y = np.where(inside, y, 0).astype(np.intp)
        return np.where(inside, self.index[y + self.reach, x + self.reach], -1)


@dataclass(frozen=True, eq=False)
class Crossings:
    """Crossings (n) of contours with epipolar planes: pixels, directions (n, 3) in the world to their brighter sides,
    rays, in-plane sigma [rad], limb, curvature."""

    found: np.ndarray
    directions: Array
    pixels: Array
    rays: Array
    sigma: Array
    limb: Array
    curvature: Array


def track(sequence: Sequence3D, contours: list[Contours], maps: list[EdgelMap], reference: int) -> Tracks:
    """Tracks of the edgels of the reference view whose contour crosses their epipolar plane."""
    edgels = contours[reference]
    rays = sequence.rays(reference, edgels.positions)
    planes = EpipolarPlanes.through(sequence.centres[reference], sequence.travel, rays)
    tangent_planes, tilt, sigma = in_plane_sigma(
        sequence, reference, edgels.positions, edgels.normals, rays, planes, edgels.sigma
    )
    depth, found = _sweep(sequence, contours, maps, reference, rays)
    chosen = np.flatnonzero(found & np.isfinite(planes.normal[:, 0]))
    planes, rays, depth = planes.take(chosen), rays[chosen], depth[chosen]
    loose = np.abs(tilt[chosen]) < PARALLEL
    sigma = np.where(loose, _loose_sigma(sequence, reference), sigma[chosen])
    direction = edgels.normals[chosen] @ sequence.rotations[reference][:, :2].T
    columns = [
        Crossings(
            np.ones(len(chosen), bool),
            direction,
            edgels.positions[chosen],
            rays,
            sigma,
            edgels.limb[chosen],
            edgels.curvature[chosen],
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
        crossing = _cross(sequence, contours[view], maps[view], view, planes, points, latest[ahead], loose)
        sigma = np.hypot(
            crossing.sigma, sequence.pose_sigma(view, np.linalg.norm(points - sequence.centres[view], axis=1))
        )
        gate = LEAST_GATE / sequence.cameras[view].fx + GATE * np.hypot(spread, sigma)
        ok = crossing.found & (np.abs(state.innovation(sequence.centres[view], points, crossing.rays)) < gate)
        state.update(ok, sequence.centres[view], crossing.rays, sigma, points)
        latest[ahead] = np.where(ok[:, None], crossing.directions, latest[ahead])
        columns.append(_where_seen(ok, crossing, sequence, view, points))
    back = np.argsort(order)
    stacked = {
        f.name: np.stack([getattr(c, f.name) for c in columns], axis=1)[:, back] for f in fields(Crossings)
    }
    return Tracks(
        reference,
        edgels.contour[chosen],
        np.stack([-edgels.normals[chosen, 1], edgels.normals[chosen, 0]], axis=1),
        tangent_planes[chosen],
        direction @ sequence.travel,
        planes,
        stacked["found"],
        stacked["pixels"],
        stacked["rays"],
        stacked["sigma"],
        stacked["limb"],
        stacked["curvature"],
    )


def reach_of(sequence: Sequence3D) -> int:
    """Radius [px] in which an edgel has to be looked for, given how well the poses are known."""
    pose = max(float(sequence.pose_sigma(v, np.array(0.5))) for v in range(len(sequence.centres)))
    return int(min(REACH + np.ceil(GATE * pose * sequence.cameras[0].fx), FARTHEST_REACH))


def _loose_sigma(sequence: Sequence3D, view: int) -> float:
    """Standard deviation [rad] along the epipolar line of a point that may lie anywhere near its prediction."""
    return REACH / sequence.cameras[view].fx


def _where_seen(
    ok: np.ndarray, crossing: "Crossings", sequence: Sequence3D, view: int, points: Array
) -> "Crossings":
    """The crossing where it passed the gate, elsewhere the prediction with infinite sigma."""
    expected = points - sequence.centres[view]
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    return Crossings(
        ok,
        crossing.directions,
        np.where(ok[:, None], crossing.pixels, sequence.project(view, points)),
        np.where(ok[:, None], crossing.rays, expected),
        np.where(ok, crossing.sigma, np.inf),
        np.where(ok, crossing.limb, 0.0),
        np.where(ok, crossing.curvature, 0.0),
    )


def in_plane_sigma(
    sequence: Sequence3D,
    view: int,
    pixels: Array,
    normals: Array,
    rays: Array,
    planes: EpipolarPlanes,
    sigma: Array,
) -> tuple[Array, Array, Array]:
    """Tangent planes (n, 3), sine (n,) of the angle between contour and epipolar line, sigma (n,) [rad] in the plane.

    `sigma` (n,) [px] is that of the contour along its image `normals` (n, 2).
    """
    tangents = np.stack([-normals[:, 1], normals[:, 0]], axis=1)
    along = sequence.rays(view, pixels + 0.5 * tangents) - sequence.rays(view, pixels - 0.5 * tangents)
    plane = np.cross(rays, along)  # the tangent plane of the surface: holds the ray and the contour
    plane /= np.linalg.norm(plane, axis=1, keepdims=True)
    shift = sequence.rays(view, pixels + 0.5 * normals) - sequence.rays(view, pixels - 0.5 * normals)
    turn = np.cross(planes.normal, rays)
    tilt = np.sum(plane * turn, axis=1) / np.maximum(np.linalg.norm(turn, axis=1), 1e-12)
    with np.errstate(divide="ignore"):
        return plane, tilt, sigma * np.abs(np.sum(plane * shift, axis=1) / tilt)


def _sweep(
    sequence: Sequence3D, contours: list[Contours], maps: list[EdgelMap], reference: int, rays: Array
) -> tuple[Array, np.ndarray]:
    """Depth (n,) [m] along each ray at which the nearest views show most edges, and whether they do."""
    centre = sequence.centres[reference]
    views = sequence.neighbours(reference)[:SWEEP_VIEWS]
    farthest = max(np.linalg.norm(sequence.centres[v] - centre) for v in views)
    disparity = sequence.cameras[reference].fx * farthest * (1 / NEAREST - 1 / FARTHEST)
    inverse = np.linspace(1 / FARTHEST, 1 / NEAREST, int(np.clip(disparity / SWEEP_STEP, 32, 1024)))
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
        score.ravel()[hit] += alike * np.exp(-0.5 * (off / SWEEP_WIDTH) ** 2)
    total, neighbours = window_sum(score, contours[reference].contour, SUPPORT // 2)
    pooled = total / neighbours[:, None]
    best = np.argmax(pooled, axis=1)
    rows = np.arange(len(rays))
    found = pooled[rows, best] > 0.5 * min(len(views), 2)
    return 1 / inverse[best], found


class CircleFilter:
    """Information filter on (p0, R) in each epipolar plane: eq. 3.23, a row a view."""

    def __init__(self, planes: EpipolarPlanes, rays: Array, depth: Array, sigma: Array) -> None:
        self.planes = planes
        n = len(depth)
        self.information = np.zeros((n, 3, 3))
        self.vector = np.zeros((n, 3))
        self.information[:, 2, 2] = RADIUS_PRIOR**-2
        # the sweep: depth to a few per cent
        x, y = planes.coordinates(rays)
        along = np.stack([x, y, np.zeros(n)], axis=1)
        weight = (0.04 * depth) ** -2.0
        self.information += weight[:, None, None] * along[:, :, None] * along[:, None, :]
        self.vector += (weight * depth)[:, None] * along
        self.update(np.ones(n, bool), planes.origin, rays, sigma, planes.origin + depth[:, None] * rays)

    def _solve(self) -> None:
        self.covariance = np.linalg.inv(self.information)
        self.state = np.einsum("nij,nj->ni", self.covariance, self.vector)

    def predict(self, centre: Array) -> tuple[Array, Array]:
        """Contact points (n, 3) as seen from a centre (3,), and sigma (n,) [rad] of their direction in the plane."""
        x0, y0 = self.planes.coordinates(np.broadcast_to(centre - self.planes.origin, (len(self.state), 3)))
        dx, dy = self.state[:, 0] - x0, self.state[:, 1] - y0
        distance = np.hypot(dx, dy)
        sine = np.clip(-self.state[:, 2] / np.maximum(distance, 1e-6), -0.9, 0.9)
        cosine = np.sqrt(1 - sine**2)
        ux, uy = dx / distance, dy / distance
        nx, ny = sine * ux + cosine * uy, sine * uy - cosine * ux  # the normal on the side of the travel
        row = np.stack([nx, ny, np.ones_like(nx)], axis=1)
        spread = np.sqrt(np.einsum("ni,nij,nj->n", row, self.covariance, row))
        x, y = self.state[:, 0] + self.state[:, 2] * nx, self.state[:, 1] + self.state[:, 2] * ny
        points = self.planes.origin + x[:, None] * self.planes.along + y[:, None] * self.planes.across
        return points, spread / np.maximum(np.hypot(x - x0, y - y0), 1e-6)

    def innovation(self, centre: Array, points: Array, rays: Array) -> Array:
        """Angle (n,) [rad] in the plane from the predicted to the measured ray."""
        ax, ay = self.planes.coordinates(points - centre)
        bx, by = self.planes.coordinates(rays)
        return np.arctan2(ax * by - ay * bx, ax * bx + ay * by)

    def update(self, ok: np.ndarray, centre: Array, rays: Array, sigma: Array, points: Array) -> None:
        """Take in the tangents of one view where `ok`."""
        x, y = self.planes.coordinates(rays)
        length = np.maximum(np.hypot(x, y), 1e-9)
        row = np.stack([y / length, -x / length, np.ones_like(x)], axis=1)
        offset = np.broadcast_to(centre - self.planes.origin, (len(x), 3))
        x0, y0 = self.planes.coordinates(offset)
        support = x0 * row[:, 0] + y0 * row[:, 1]
        distance = np.linalg.norm(points - centre, axis=1)
        # egomotion and the surface's deviation from a circle are not in sigma: a floor keeps the filter humble
        weight = np.where(ok, 1.0 / (np.hypot(np.where(ok, sigma, 1.0), 2e-4) * distance) ** 2, 0.0)
        self.information += weight[:, None, None] * row[:, :, None] * row[:, None, :]
        self.vector += (weight * support)[:, None] * row
        self._solve()


def _cross(
    sequence: Sequence3D,
    contours: Contours,
    edgels: EdgelMap,
    view: int,
    planes: EpipolarPlanes,
    points: Array,
    direction: Array,
    loose: np.ndarray,
) -> Crossings:
    """Where contours of a view near the predicted contact points cross the epipolar planes (Newton along the spline).

    For a centre off the plane, the crossing is that of the contact point, taken at the predicted distance: exact to
    first order for any motion, and the epipolar match itself for linear motion. Where a contour runs along the epipolar
    lines (`loose`), its nearest point stands in, with a sigma that says so.
    """
    predicted = sequence.project(view, points)
    index = edgels.lookup(predicted)
    found = index >= 0
    if len(contours.u) == 0 or not found.any():
        n = len(points)
        nothing = np.zeros(n)
        blank = np.zeros((n, 3))
        return Crossings(nothing > 0, blank, blank[:, :2], blank + 1.0, nothing + np.inf, nothing, nothing)
    index = np.maximum(index, 0)
    contour = contours.contour[index]
    centre, distance = sequence.centres[view], np.linalg.norm(points - sequence.centres[view], axis=1)
    height = np.einsum("nk,nk->n", planes.normal, np.broadcast_to(centre - planes.origin, points.shape))
    u = contours.u[index]
    start = u
    for _ in range(3):
        position, tangent = contours.splines.curve(u), contours.splines.curve(u, 1)
        here = sequence.rays(view, position)
        there = sequence.rays(view, position + tangent)
        error = height + distance * np.einsum("nk,nk->n", planes.normal, here)
        slope = distance * np.einsum("nk,nk->n", planes.normal, there - here)
        step = -error / np.where(np.abs(slope) > 1e-9, slope, 1e-9)
        u = contours.splines.clamp(u + np.where(loose, 0.0, np.clip(step, -8.0, 8.0)), contour)
    position, _, normal, curvature = contours.splines.frame(u)
    rays = sequence.rays(view, position)
    error = height + distance * np.einsum("nk,nk->n", planes.normal, rays)
    _, _, sigma = in_plane_sigma(sequence, view, position, normal, rays, planes, contours.sigma_at(u))
    wanted = direction @ sequence.rotations[view][:, :2]
    found &= loose | (np.abs(error) < 0.05 * distance / sequence.cameras[view].fx)
    found &= np.sum(wanted * normal, axis=1) > ALIKE * np.linalg.norm(wanted, axis=1)
    found &= np.abs(u - start) < 4 * edgels.reach
    sigma = np.where(loose, _loose_sigma(sequence, view), sigma)
    nearest = np.clip(np.searchsorted(contours.u, u), 0, len(contours.u) - 1)
    directions = normal @ sequence.rotations[view][:, :2].T
    return Crossings(
        found, directions, position, rays, np.where(found, sigma, np.inf), contours.limb[nearest], curvature
    )
