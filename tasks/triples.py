"""Vectors of three numbers in compiled loops, as tuples: no memory, no calls."""

import math

from extremal.estimator.camera import Array
from extremal.tasks.compiled import compiled

Vector = tuple[float, float, float]
LEAST = 1e-300  # length below which a vector has no direction


@compiled
def row(a: Array, i: int) -> Vector:
    """Row i of an array (n, 3)."""
    return a[i, 0], a[i, 1], a[i, 2]


@compiled
def row_in(a: Array, v: int, i: int) -> Vector:
    """Row i of part v of an array (V, n, 3), without a view of the part, which costs as much as what is done with the row."""
    return a[v, i, 0], a[v, i, 1], a[v, i, 2]


@compiled
def put(a: Array, i: int, v: Vector) -> None:
    """Row i of an array (n, 3) becomes v."""
    a[i, 0], a[i, 1], a[i, 2] = v


@compiled
def plus(a: Vector, t: float, b: Vector) -> Vector:
    """a + t b."""
    return a[0] + t * b[0], a[1] + t * b[1], a[2] + t * b[2]


@compiled
def times(t: float, a: Vector) -> Vector:
    """t a."""
    return t * a[0], t * a[1], t * a[2]


@compiled
def dot(a: Vector, b: Vector) -> float:
    """a . b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled
def crossed(a: Vector, b: Vector) -> Vector:
    """a x b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@compiled
def unit(a: Vector) -> Vector:
    """a / |a|; 0 stays 0."""
    return times(1 / max(math.sqrt(dot(a, a)), LEAST), a)


@compiled
def turned(R: Array, a: Vector) -> Vector:
    """R a, of the upper left (3, 3) of R."""
    x, y, z = a
    return (
        R[0, 0] * x + R[0, 1] * y + R[0, 2] * z,
        R[1, 0] * x + R[1, 1] * y + R[1, 2] * z,
        R[2, 0] * x + R[2, 1] * y + R[2, 2] * z,
    )


@compiled
def turned_back(R: Array, a: Vector) -> Vector:
    """R' a, of the upper left (3, 3) of R."""
    x, y, z = a
    return (
        R[0, 0] * x + R[1, 0] * y + R[2, 0] * z,
        R[0, 1] * x + R[1, 1] * y + R[2, 1] * z,
        R[0, 2] * x + R[1, 2] * y + R[2, 2] * z,
    )
