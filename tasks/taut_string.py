"""Shortest paths around any surface: a discrete string pulled taut against its exact signed distance.

With N + 1 points p_i, ends fixed, minimise 1/2 sum |p_{i+1} - p_i|^2 subject to d(p_i) >= clearance, d the
signed distance: the minimum has equal steps and is the shortest such polygon. Newton's iteration on the
conditions of Karush, Kuhn and Tucker, with l_i >= 0 the multipliers, n = grad d and H = grad grad d:

    (2 - l_i H_i) x_i - x_{i-1} - x_{i+1} - n_i l_i = -(2 p_i - p_{i-1} - p_{i+1}),   n_i.x_i = clearance - d_i

for the nodes that touch, l_i = 0 for the others: one banded system with four unknowns a node. No offset
surface is built, so a waist needs no care and rims and edges are rounded as the distance rounds them.

Chords between touching nodes are shorter than the arcs above them by O(1/N^2); Richardson's extrapolation
from two numbers of nodes removes that.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_banded

from extremal.estimator.errors import NotConverged
from extremal.scenes.curves import Array
from extremal.scenes.surface import Surface, tangent_basis

COARSE, LEVELS = 32, (48, 96)  # numbers of steps
STEP = 1e-4  # [m] of the central differences for n and H
TRUST = 0.02  # [m] a node moves at most in one iteration
NEAR = 0.05  # [m] beyond the clearance: nodes that are further out don't come to touch in one iteration


def string_path(surface: Surface, start: Array, goal: Array, clearance: float) -> tuple[Array, float]:
    """The shortest path to left, right and over a surface: points (n, 3) [m] and length [m].

    Ways below (world -z) are left out: objects stand on something.

    Args:
        surface: the obstacle.
        start, goal: (3,) world, at least `clearance` [m] from it.
        clearance: [m], positive.

    Raises:
        NotConverged: no way settled.
    """
    strings = []
    for p in _around(surface, start, goal, clearance):
        try:
            strings.append(_pulled(surface, p, clearance))
        except NotConverged:
            continue
    if not strings:
        raise NotConverged(
            f"no path around {surface.name!r} from {start.tolist()} to {goal.tolist()} settled"
        )
    p = min(strings, key=_length)
    lengths = []
    for steps in LEVELS:
        p = _pulled(surface, _resampled(p, steps), clearance)
        lengths.append(_length(p))
    # The errors go with the square of the step.
    ratio = (LEVELS[1] / LEVELS[0]) ** 2
    return _filled(surface, p, clearance), lengths[1] + (lengths[1] - lengths[0]) / (ratio - 1)


def _sides(start: Array, goal: Array) -> Array:
    """Unit vectors (K, 3) across the line from start to goal: left, right and up."""
    along = (goal - start) / np.linalg.norm(goal - start)
    up = np.array([0.0, 0.0, 1.0]) - along[2] * along
    if np.linalg.norm(up) < 1e-3:
        u, v = tangent_basis(along)
        return np.stack([u, -u, v, -v])
    up /= np.linalg.norm(up)
    left = np.cross(up, along)
    return np.stack([left, -left, up])


def _around(surface: Surface, start: Array, goal: Array, clearance: float) -> list[Array]:
    """Paths (N + 1, 3) that keep the clearance: the line to the goal, raised over the surface to each side.

    From far out, each point comes in by its distance from the surface (sphere tracing) until it touches.
    """
    line, sides = start + np.linspace(0, 1, COARSE + 1)[:, None] * (goal - start), _sides(start, goal)
    away = np.abs(surface.signed_distance(line))
    far = 2 * float(away.max() + np.linalg.norm(goal - start)) + clearance
    height = np.full((len(sides), len(line), 1), far)
    height[:, [0, -1]] = 0
    for _ in range(30):
        gap = surface.signed_distance(line + height * sides[:, None])[..., None] - clearance
        height = np.maximum(height - np.maximum(gap, 0), 0)
        if np.all((gap < 1e-3) | (height == 0)):
            break
    return [_resampled(p, COARSE) for p in line + height * sides[:, None]]


def _length(p: Array) -> float:
    return float(np.sum(np.linalg.norm(np.diff(p, axis=0), axis=1)))


def _resampled(p: Array, steps: int) -> Array:
    """The polyline's points at equal steps of its length, (steps + 1, 3)."""
    s = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(p, axis=0), axis=1))])
    at = np.linspace(0, s[-1], steps + 1)
    return np.stack([np.interp(at, s, x) for x in p.T], axis=1)


def _pulled(surface: Surface, p: Array, clearance: float) -> Array:
    """The string (N + 1, 3) pulled taut.

    Levenberg's damping, with the energy plus a penalty for what cuts into the clearance as merit. Trial points
    are moved onto the offset along their normals, without which the merit would refuse Newton's own steps.

    Raises:
        NotConverged: it settles neither to 1e-8 m nor, over the kinks of a mesh, to 1e-8 of its energy.
    """
    multipliers, damping = np.zeros(len(p) - 2), 0.1
    d = surface.signed_distance(p[1:-1])
    n, bend = _form(surface, p, d, clearance)
    settled, energies = np.inf, []
    for _ in range(200):
        x, new = _step(p, d - clearance, n, bend, multipliers, damping)
        settled = float(np.abs(x).max())
        energies.append(_merit(p, d - clearance, 0.0))
        still = len(energies) > 25 and abs(energies[-25] - energies[-1]) < 1e-8 * energies[-1]
        if still or (settled < 1e-8 and damping < 1e-4):
            return p
        x *= min(1.0, TRUST / max(settled, 1e-300))
        trial, d_trial = _onto(surface, p[1:-1] + x, n, new > 0, clearance)
        trial = np.concatenate([p[:1], trial, p[-1:]])
        penalty = 2 * float(np.max(new))
        before, after = _merit(p, d - clearance, penalty), _merit(trial, d_trial - clearance, penalty)
        if after <= before * (1 + 1e-13):
            p, d, multipliers, damping = trial, d_trial, new, damping / 8
            n, bend = _form(surface, p, d, clearance)
        else:
            damping = max(4 * damping, 1e-4)
    raise NotConverged(f"a path around {surface.name!r} still moves by {settled:.2g} m an iteration")


def _merit(p: Array, gap: Array, penalty: float) -> float:
    return float(np.sum(np.diff(p, axis=0) ** 2) / 2 - penalty * np.sum(np.minimum(gap, 0)))


def _onto(
    surface: Surface, p: Array, n: Array, touching: NDArray[np.bool_], clearance: float
) -> tuple[Array, Array]:
    """Points (M, 3), those that touch or cut moved along n (M, 3) to the clearance, and their distances."""
    gap = surface.signed_distance(p) - clearance
    move = np.where(touching, np.minimum(gap, TRUST), np.minimum(gap, 0))
    p = p - move[:, None] * n
    return p, surface.signed_distance(p)


def _form(surface: Surface, p: Array, d: Array, clearance: float) -> tuple[Array, Array]:
    """Gradients (M, 3) and Hessians (M, 3, 3) of the distances d of the inner nodes; 0 far from the clearance.

    Central differences along the axes and the diagonals between them, in one call.
    """
    n, H = np.zeros((len(d), 3)), np.zeros((len(d), 3, 3))
    near = d - clearance < NEAR
    if not near.any():
        return n, H
    i, j = [0, 0, 1], [1, 2, 2]
    axes = np.eye(3)
    e = STEP * np.concatenate([axes, axes[i] + axes[j]])
    ahead, behind = surface.signed_distance(p[1:-1][near] + np.stack([e, -e])[:, :, None])
    n[near] = (ahead[:3] - behind[:3]).T
    n[near] /= np.maximum(np.linalg.norm(n[near], axis=1, keepdims=True), 1e-300)
    second = (ahead + behind - 2 * d[near]) / STEP**2
    form = np.zeros((int(near.sum()), 3, 3))
    form[:, [0, 1, 2], [0, 1, 2]] = second[:3].T
    form[:, i, j] = form[:, j, i] = (second[3:] - second[i] - second[j]).T / 2
    # At a distance d from any body the level surface is at most as curved as a sphere of that radius; the other
    # way, towards the centre of curvature of a waist, there is no bound.
    most = 1 / np.maximum(d[near], 1e-3)[:, None]
    values, vectors = np.linalg.eigh(form)
    H[near] = np.einsum("mik,mk,mjk->mij", vectors, np.clip(values, -50 * most, most), vectors)
    return n, H


def _step(
    p: Array, gap: Array, n: Array, bend: Array, multipliers: Array, damping: float
) -> tuple[Array, Array]:
    """Step (M, 3) [m] and new multipliers (M,), by changes of the set of touching nodes until it is stable."""
    touching = (multipliers > 0) | (gap < 0)
    form = (2 + damping) * np.eye(3) - multipliers[:, None, None] * bend
    force = p[:-2] + p[2:] - 2 * p[1:-1]
    for _ in range(20):
        x, new = _solve(force, gap, n, form, touching)
        wanted = np.where(touching, new > 0, gap + np.sum(n * x, axis=1) < -1e-12)
        if np.array_equal(wanted, touching):
            break
        touching = wanted
    return x, np.maximum(new, 0)  # pyright: ignore[reportPossiblyUnboundVariable]


def _solve(
    force: Array, gap: Array, n: Array, form: Array, touching: NDArray[np.bool_]
) -> tuple[Array, Array]:
    """The banded system of one Newton step for a given set of touching nodes."""
    m = len(gap)
    blocks = np.zeros((m, 4, 4))
    active = touching[:, None]
    blocks[:, :3, :3] = form
    blocks[:, :3, 3] = -np.where(active, n, 0)
    blocks[:, 3, :3] = np.where(active, n, 0)
    blocks[:, 3, 3] = np.where(touching, 0, 1)
    bands = np.zeros((9, 4 * m))
    for i in range(4):
        for j in range(4):
            bands[4 + i - j, j::4] = blocks[:, i, j]
    for k in range(3):  # neighbours: four columns away
        bands[0, 4 + k :: 4] = bands[8, k:-4:4] = -1
    right = np.concatenate([force, np.where(touching, -gap, 0)[:, None]], axis=1)
    answer = solve_banded((4, 4), bands, right.ravel()).reshape(m, 4)
    return answer[:, :3], answer[:, 3]


def _filled(surface: Surface, p: Array, clearance: float) -> Array:
    """The polyline with midpoints, moved out where they cut into the clearance, four points to a step."""
    for _ in range(2):
        middle = (p[:-1] + p[1:]) / 2
        gap = surface.signed_distance(middle) - clearance
        n, _ = _form(surface, np.concatenate([p[:1], middle, p[-1:]]), gap + clearance, clearance)
        middle -= np.minimum(gap, 0)[:, None] * n
        filled = np.empty((2 * len(p) - 1, 3))
        filled[::2], filled[1::2] = p, middle
        p = filled
    return p
