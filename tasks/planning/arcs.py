"""Around a curved obstacle by what is seen of it: tangent, circular or helical arc, tangent.

Every observation of an extremal boundary gives a contact point, its normal, and the circle that osculates the
surface there. Inflated by the clearance, the circles of the contacts seen so far, each between the normals
half-way to its neighbours', are a strip of the obstacle's offset; the newest goes on beyond, which is all that
is known of the far side. In the plane across the axis the path is the string pulled taut around the strip; its
height changes in proportion to its length, which makes the arc a helix (the approximation to the geodesic of
Blake et al. that Cipolla, sec. 3.6.1, cites).

With the contact r and its normal fixed, a circle of a larger radius has the larger support function
h(psi) = r.n(psi) + R (1 - cos psi), so R + k sigma_R with r moved out by k sigma_r bounds the strip at k sigma.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from extremal.estimator.errors import InvalidInput
from extremal.scenes.curves import Array
from extremal.tasks.planning.belief import ArcBelief, Caution

FINEST = float(np.radians(3))  # [rad] between samples of the strip
BACK = float(np.radians(100))  # [rad] that the oldest circle reaches back from its contact


@dataclass(frozen=True, eq=False)
class ArcPlan:
    """A planned path of the sphere's centre.

    Attributes:
        waypoints: (n, 3) [m], world frame, from the position to the goal.
        length: [m], with arcs as arcs.
        depth: how far [m] the position is within the believed clearance; 0 outside.
        arc: angle [rad] that the path wraps around the obstacle; 0 where it goes straight.
    """

    waypoints: Array
    length: float
    depth: float = 0.0
    arc: float = 0.0


def plan_arc(
    position: Array, goal: Array, beliefs: ArcBelief | Sequence[ArcBelief], caution: Caution
) -> ArcPlan:
    """Path from position to goal around one side of an obstacle.

    Straight where the strip is not in the way. Out along the normal first where the position is within the
    clearance. A circle that would reach over the goal is shrunk until it doesn't: the goal is known to be free.

    Args:
        position: (3,) [m] of the sphere's centre.
        goal: (3,) [m].
        beliefs: of one side of one obstacle, the newest last; earlier ones are the strip already passed, along
            which the sphere still has to go. None (empty): the path is straight.
        caution: clearance and number of standard deviations.

    Raises:
        InvalidInput: position or goal is not three finite numbers.
    """
    position, goal = _checked("position", position), _checked("goal", goal)
    beliefs = [beliefs] if isinstance(beliefs, ArcBelief) else list(beliefs)
    straight = ArcPlan(np.stack([position, goal]), float(np.linalg.norm(goal - position)))
    if not beliefs or straight.length < 1e-12:
        return straight
    plans = [
        _planned(position, goal, beliefs, caution, plane)
        for plane in _section_planes(position, goal, beliefs[-1])
    ]
    return min(plans, key=lambda plan: plan.length)


def _planned(
    position: Array, goal: Array, beliefs: Sequence[ArcBelief], caution: Caution, plane: Array
) -> ArcPlan:
    """The plan in one section plane (3, 3), whose second row is the direction of travel past the contact."""
    x, g = plane @ (position - beliefs[-1].point), plane @ (goal - beliefs[-1].point)
    strip = _strip(beliefs, plane, x, g, caution)
    if strip is None:
        return ArcPlan(np.stack([position, goal]), float(np.linalg.norm(goal - position)))
    q, normals, advance = strip
    outside = normals @ x[:2] - np.sum(normals * q, axis=1)
    nearest = int(np.argmax(outside))
    depth = max(-float(outside[nearest]), 0.0)
    start = x[:2] + depth * normals[nearest]
    chain, arcs = _taut(start, *_between(start, g[:2], q, normals, advance), g[:2])
    steps = np.where(arcs > 0, arcs, np.linalg.norm(np.diff(chain, axis=0), axis=1))
    arc = _wrapped(chain)
    if depth > 0:
        chain, steps = np.concatenate([x[None, :2], chain]), np.append(depth, steps)
    run = np.append(0.0, np.cumsum(steps))
    height = x[2] + (g[2] - x[2]) * run / max(run[-1], 1e-12)
    waypoints = np.concatenate([chain, height[:, None]], axis=1) @ plane + beliefs[-1].point
    waypoints[0], waypoints[-1] = position, goal
    return ArcPlan(waypoints, float(np.hypot(run[-1], g[2] - x[2])), depth, arc)


def plan_around(
    position: Array, goal: Array, sides: Sequence[Sequence[ArcBelief]], caution: Caution
) -> tuple[ArcPlan, int]:
    """The shorter of the paths around the sides of an obstacle for which there is evidence, and its index.

    Args:
        position, goal: (3,) [m].
        sides: for each side (left, right) its beliefs, newest last; sides without any are left out. If there
            is none at all the path is straight and the index -1.
        caution: clearance and number of standard deviations.
    """
    plans = [(plan_arc(position, goal, side, caution), i) for i, side in enumerate(sides) if len(side)]
    if not plans:
        return plan_arc(position, goal, [], caution), -1
    return min(plans, key=lambda plan: plan[0].length)


def _checked(name: str, value: Array) -> Array:
    p = np.asarray(value, float)
    if p.shape != (3,) or not np.all(np.isfinite(p)):
        raise InvalidInput(f"{name} is {value!r}; accepted: three finite numbers")
    return p


def _section_planes(position: Array, goal: Array, newest: ArcBelief) -> list[Array]:
    """Rows (3, 3): the newest contact's normal across the axis, the direction of travel across it, the axis.

    The path passes the contact on the normal's side, in the direction of the ray from the position to the
    contact. Where that is not towards the goal (the contact is already passed, or there is far to go around)
    both directions are returned.
    """
    axis = newest.axis
    across = newest.normal - (newest.normal @ axis) * axis
    across = across / np.linalg.norm(across)
    travel = np.cross(axis, across)
    sides = {1.0 if travel @ (p - position) > 0 else -1.0 for p in (newest.point, goal)}
    return [np.stack([across, side * travel, side * axis]) for side in sorted(sides)]


def _strip(
    beliefs: Sequence[ArcBelief], plane: Array, x: Array, g: Array, caution: Caution
) -> tuple[Array, Array, Array] | None:
    """The inflated strip in the section plane: points (M, 2), normals (M, 2), arcs (M,) [m] from the point before
    (0 between different circles), in the order of travel. None where no belief is usable."""
    tilted = np.array([b.normal for b in beliefs]) @ plane.T
    n, size = tilted[:, :2], np.linalg.norm(tilted[:, :2], axis=1)
    angle = np.arctan2(n[:, 1], n[:, 0])
    usable = (size > 0.5) & (np.abs(angle) < np.pi * 0.9)
    order = np.nonzero(usable)[0]
    if not len(order):
        return None
    order = order[np.argsort(angle[order], kind="stable")]
    angle, n, size = angle[order], n[order] / size[order, None], size[order]
    # Where the surface leans against the axis, the section across it is moved by the slope to the path's height
    # there, and its offset is wider than the clearance: exact for cones.
    r = (np.array([beliefs[i].point for i in order]) - beliefs[-1].point) @ plane.T
    way = g[:2] - x[:2]
    part = np.clip((r[:, :2] - x[:2]) @ way / max(float(way @ way), 1e-12), 0, 1)
    rise = x[2] + part * (g[2] - x[2]) - r[:, 2]
    r = r[:, :2] - (rise * tilted[order, 2] / size)[:, None] * n
    margin = (caution.clearance + caution.k * np.array([beliefs[i].sigma_point for i in order])) / size
    margin = np.maximum(np.minimum(margin, np.linalg.norm(g[:2] - r, axis=1)), caution.clearance / size)
    believed = np.array([(beliefs[i].radius, caution.k * beliefs[i].sigma_radius) for i in order])
    likely, most = np.clip([believed[:, 0], believed.sum(axis=1)], 0, caution.largest_radius)
    # Uncertainty alone does not put the position inside.
    radius = np.maximum(likely, np.minimum(most, _free(x[:2] - r, n, margin)))
    radius = np.minimum(radius, _free(g[:2] - r, n, margin))
    centre, rho = r - radius[:, None] * n, radius + margin
    cuts = (angle[1:] + angle[:-1]) / 2
    psi = _angles(angle, cuts, centre, rho, x[:2], g[:2])
    piece = np.searchsorted(cuts, psi)
    normals = np.stack([np.cos(psi), np.sin(psi)], axis=1)
    q = centre[piece] + rho[piece, None] * normals
    advance = np.append(0.0, np.where(piece[1:] == piece[:-1], rho[piece[1:]] * np.diff(psi), 0.0))
    return q, normals, advance


def _between(x: Array, g: Array, q: Array, normals: Array, advance: Array) -> tuple[Array, Array]:
    """Those points (m, 2) of a strip that are ahead of x and have g ahead of them, and the arcs between them."""
    travel = np.stack([-normals[:, 1], normals[:, 0]], axis=1)
    ahead = np.sum((q - x) * travel, axis=1) > -1e-9
    before = np.sum((g - q) * travel, axis=1) > -1e-9
    kept = np.nonzero(ahead & before)[0]
    return q[kept], np.where(np.diff(kept, prepend=-2) > 1, 0.0, advance[kept])


def _free(goal: Array, n: Array, margin: Array) -> Array:
    """Largest radii (K) of circles tangent at contacts, inflated by margins (K), that leave the goal free.

    With the contact as origin and the centre at -R n: |g + R n| >= R + m, linear in R as |g + R n|^2 is
    g.g + 2 R g.n + R^2. A goal nearer than the margin to the contact leaves no circle, but its point.
    """
    outward = np.sum(goal * n, axis=1)
    room = np.sum(goal * goal, axis=1) - margin**2
    with np.errstate(divide="ignore", invalid="ignore"):
        most = np.where(outward < margin, room / (2 * (margin - outward)), np.inf)
    return np.maximum(most, 0.0)


def _angles(angle: Array, cuts: Array, centre: Array, rho: Array, x: Array, g: Array) -> Array:
    """Angles (M,) of the strip's samples: regular ones, and where tangents from x and to g touch exactly."""
    exact = []
    for p, side in ((x, 1.0), (g, -1.0)):
        away = p - centre
        distance = np.hypot(away[:, 0], away[:, 1])
        opening = np.arccos(np.clip(rho / np.maximum(distance, 1e-12), -1, 1))
        touch = np.arctan2(away[:, 1], away[:, 0]) + side * opening
        touch = np.remainder(touch + np.pi, 2 * np.pi) - np.pi
        inside = np.append(-np.inf, cuts) <= touch
        exact.append(touch[inside & (touch <= np.append(cuts, np.inf))])
    low, high = angle[0] - BACK, max(angle[-1] + np.pi, float(np.max(np.concatenate(exact), initial=0.0)))
    regular = np.linspace(low, high, int(np.ceil((high - low) / FINEST)) + 1)
    psi = np.sort(np.concatenate([regular, *exact]))
    return psi[np.append(True, np.diff(psi) > 1e-12)]


def _taut(start: Array, q: Array, advance: Array, goal: Array) -> tuple[Array, Array]:
    """The string from start to goal that keeps points q (M, 2), given in order, on its left: (m, 2), and the
    arcs (m - 1,) [m] over its steps, 0 for straight ones. Graham's scan."""
    points = [tuple(start), *map(tuple, q.tolist()), tuple(goal)]
    run = np.concatenate([[0.0], np.cumsum(advance), [0.0]]).tolist()
    kept: list[int] = []
    for i, (px, py) in enumerate(points):
        while len(kept) >= 2:
            (ax, ay), (bx, by) = points[kept[-2]], points[kept[-1]]
            if (bx - ax) * (py - by) - (by - ay) * (px - bx) > 0:
                break
            kept.pop()
        kept.append(i)
    last = len(points) - 1
    arcs = [run[j] - run[i] if j == i + 1 and i > 0 and j < last else 0.0 for i, j in pairwise(kept)]
    return np.array([points[i] for i in kept]), np.array(arcs)


def _wrapped(chain: Array) -> float:
    """Angle [rad] by which a polyline (m, 2) turns to its left in all."""
    steps = np.diff(chain, axis=0)
    steps = steps[np.hypot(steps[:, 0], steps[:, 1]) > 1e-9]
    turn = steps[:-1, 0] * steps[1:, 1] - steps[:-1, 1] * steps[1:, 0]
    return float(np.sum(np.arctan2(turn, np.sum(steps[:-1] * steps[1:], axis=1))))
