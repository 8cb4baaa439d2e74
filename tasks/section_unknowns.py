"""The unknowns theta = (s, q, R, c) of n sections, rows of (n, 4): where they are, their radius, and how it changes along their arcs.

In equations they stand in the order c of all sections, then s, q, R of one section after the other.
"""

import math

import numpy as np

from extremal.estimator.camera import Array
from extremal.tasks.compiled import compiled

Unknowns = tuple[float, float, float, float]  # s, q, R [m], c [m/rad]


@compiled
def unknowns(theta: Array, i: int) -> Unknowns:
    """Row i of theta (n, 4)."""
    return theta[i, 0], theta[i, 1], theta[i, 2], theta[i, 3]


@compiled
def stacked(theta: Array) -> Array:
    """(4 n,) unknowns in their order, of theta (n, 4)."""
    n = len(theta)
    out = np.empty(4 * n)
    out[:n] = theta[:, 3]
    for i in range(n):
        for j in range(3):
            out[n + 3 * i + j] = theta[i, j]
    return out


@compiled
def changed(phi: float, middle: float) -> tuple[float, float]:
    """f and f' of `section_rows` at phi, of arcs with that `middle` [rad]."""
    cosine, sine = math.cos(phi), math.sin(phi)
    return phi - middle + middle * cosine - sine, 1 - middle * sine - cosine


@compiled
def moved(theta: Array, before: Array, far: float) -> int:
    """How many sections have moved by more than `far` [m] since theta (n, 4) was `before`."""
    count = 0
    for i in range(len(theta)):
        largest = 0.0
        for j in range(3):
            largest = max(largest, abs(theta[i, j] - before[i, j]))
        count += largest > far
    return count


@compiled
def within(theta: Array, reach: Array) -> Array:
    """theta (n, 3), none of it larger than `reach` (n, 3)."""
    out = np.empty(theta.shape)
    for i in range(len(theta)):
        for j in range(3):
            out[i, j] = min(max(theta[i, j], -reach[i, j]), reach[i, j])
    return out


@compiled
def without_change(blocks: Array, prior: Array) -> Array:
    """Information (n, 3, 3) on s, q, R, of that on s, q, R, c (n, 4, 4) and the prior's (n,) on c."""
    out = np.empty((len(blocks), 3, 3))
    for i in range(len(blocks)):
        for j in range(3):
            share = blocks[i, j, 3] / (blocks[i, 3, 3] + prior[i])
            for k in range(3):
                out[i, j, k] = blocks[i, j, k] - share * blocks[i, 3, k]
    return out
