"""The arm's Denavit-Hartenberg chain in compiled code: pose and Jacobian of its flange, for Newton's method in small steps."""

import math
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import RigidTransform

from extremal.estimator.camera import Array
from extremal.sim import ArmGeometry
from extremal.sim.chain import DH_A, DH_ALPHA, DH_D
from extremal.tasks.compiled import compiled
from extremal.tasks.rigid import exponential, inverse, product, put_product, rotation_vector
from extremal.tasks.triples import Vector, crossed, dot, plus, times, turned_back

ITERATIONS = 8


class Chain(NamedTuple):
    """The arm of `ArmGeometry` at a base (4, 4): T_base_flange = prod_i Rz(q_i + offset_i) Tz(d_i) Tx(a_i) Rx(alpha_i), each (6,)."""

    base: Array
    offset: Array
    a: Array
    d: Array
    alpha: Array

    @staticmethod
    def of(T_world_base: RigidTransform, geometry: ArmGeometry) -> "Chain":
        a, d = np.array(DH_A) + geometry.link_a, np.array(DH_D) + geometry.link_d
        return Chain(T_world_base.as_matrix(), geometry.joint_offset, a, d, np.array(DH_ALPHA))


@compiled
def flange_frames(chain: Chain, q: Array) -> Array:
    """T_world_i (7, 4, 4) of the chain's frames 0 to 6 at joint positions (6,) [rad]; the last is the flange."""
    out, link = np.empty((7, 4, 4)), np.empty((4, 4))
    for i in range(4):
        for j in range(4):
            out[0, i, j] = chain.base[i, j]
            link[i, j] = 1.0 if i == j else 0.0
    for i in range(6):
        ct, st = math.cos(q[i] + chain.offset[i]), math.sin(q[i] + chain.offset[i])
        ca, sa = math.cos(chain.alpha[i]), math.sin(chain.alpha[i])
        link[0, 0], link[0, 1], link[0, 2], link[0, 3] = ct, -st * ca, st * sa, chain.a[i] * ct
        link[1, 0], link[1, 1], link[1, 2], link[1, 3] = st, ct * ca, -ct * sa, chain.a[i] * st
        link[2, 1], link[2, 2], link[2, 3] = sa, ca, chain.d[i]
        put_product(out[i + 1], out[i], link)
    return out


@compiled
def missing(chain: Chain, q: Array, goal: Array) -> tuple[Array, Array]:
    """What a flange at joint positions (6,) misses of a pose (4, 4): the twist (6,), its rotation to first order, and the arm's
    Jacobian (6, 6): twists (translation, rotation vector) in the flange frame."""
    frames = flange_frames(chain, q)
    flange, jacobian, twist = frames[6], np.empty((6, 6)), np.empty(6)
    end = _column(flange, 3)
    for i in range(6):
        axis = _column(frames[i], 2)
        moved = turned_back(flange, crossed(axis, plus(end, -1.0, _column(frames[i], 3))))
        about = turned_back(flange, axis)
        for j in range(3):
            jacobian[j, i], jacobian[3 + j, i] = moved[j], about[j]
    x = turned_back(flange, _column(goal, 0))
    y = turned_back(flange, _column(goal, 1))
    z = turned_back(flange, _column(goal, 2))
    about = ((y[2] - z[1]) / 2, (z[0] - x[2]) / 2, (x[1] - y[0]) / 2)
    moved = turned_back(flange, plus(_column(goal, 3), -1.0, end))
    for j in range(3):
        twist[j], twist[3 + j] = moved[j], about[j]
    return twist, jacobian


@compiled
def reached(chain: Chain, q: Array, goal: Array, residual: float, longest: float) -> tuple[Array, bool]:
    """Joint positions (6,) near q at which the flange is at a pose (4, 4) up to a residual [m], [rad], by Newton's method in steps
    shorter than `longest` [rad], and whether there are any.

    Raises LinAlgError at a singularity.
    """
    for _ in range(ITERATIONS):
        twist, jacobian = missing(chain, q, goal)
        if np.abs(twist).max() < residual:
            return q, True
        step = np.linalg.solve(jacobian, twist)
        if not np.abs(step).max() < longest:
            return q, False
        q = q + step
    return q, False


@compiled
def straight(
    chain: Chain,
    q: Array,
    poses: Array,
    limits: Array,
    residual: float,
    longest: float,
) -> tuple[Array, int]:
    """Joint positions (K + 1, 6) from q (6,) on, at which the flange goes through poses (K, 4, 4), and how many of these it reaches: up to
    a residual [m], [rad], in steps shorter than `longest` [rad], within limits (6, 2).

    Raises LinAlgError at a singularity.
    """
    path = np.empty((len(poses) + 1, 6))
    path[0] = q
    for i in range(len(poses)):
        after, found = reached(chain, path[i], poses[i], residual, 2 * longest)
        for j in range(6):
            found = (
                found and limits[j, 0] <= after[j] <= limits[j, 1] and abs(after[j] - path[i, j]) <= longest
            )
        if not found:
            return path, i
        path[i + 1] = after
    return path, len(poses)


@compiled
def line(start: Array, end: Array, spacing: float, turn: float) -> Array:
    """Poses (K, 4, 4) after `start` on the straight line to `end`, both (4, 4), `spacing` [m] and `turn` [rad] apart at most."""
    way = plus(_column(end, 3), -1.0, _column(start, 3))
    turned = rotation_vector(product(inverse(start), end))
    count = math.ceil(max(math.sqrt(dot(way, way)) / spacing, math.sqrt(dot(turned, turned)) / turn, 1.0))
    out = np.empty((count, 4, 4))
    for i in range(count):
        s = (i + 1) / count
        put_product(out[i], start, exponential((0.0, 0.0, 0.0), times(s, turned)))
        for j in range(3):
            out[i, j, 3] = start[j, 3] + s * way[j]
    return out


@compiled
def straight_to(
    chain: Chain,
    q: Array,
    tool: Array,
    goal: Array,
    spacing: float,
    turn: float,
    limits: Array,
    residual: float,
    longest: float,
) -> tuple[Array, bool]:
    """The path (K + 1, 6) from q (6,) on which a tool, T_flange_tool (4, 4), goes along a `line` to a pose (4, 4), and whether it gets
    there: see `straight`.

    Raises LinAlgError at a singularity.
    """
    poses = line(product(flange_frames(chain, q)[6], tool), goal, spacing, turn)
    flange, back = np.empty(poses.shape), inverse(tool)
    for i in range(len(poses)):
        put_product(flange[i], poses[i], back)
    path, count = straight(chain, q, flange, limits, residual, longest)
    return path, count == len(poses)


@compiled
def _column(m: Array, j: int) -> Vector:
    return m[0, j], m[1, j], m[2, j]
