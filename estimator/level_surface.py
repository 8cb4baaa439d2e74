"""The closed surface on which a function on a grid is zero, as triangles (surface nets, Gibson 1998, MICCAI).

Every grid cell that the surface crosses has one vertex, the mean of the points where its edges are crossed; every edge that
is crossed joins the vertices of the four cells around it. There are none of the slivers of marching cubes among its triangles.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from extremal.estimator.camera import Array
from extremal.estimator.errors import DegenerateGeometry


def level_surface(values: ArrayLike) -> tuple[Array, NDArray[np.integer]]:
    """Vertices (V, 3) in grid indices and faces (F, 3), counter-clockwise seen from where values (I, J, K) are positive.

    Raises:
        DegenerateGeometry: no value is negative, or one on the grid's border is: the surface would not be closed.
    """
    f = np.asarray(values, float)
    inside = f < 0
    if not inside.any():
        raise DegenerateGeometry("nothing lies inside; accepted: values of which some are negative")
    core = np.zeros_like(inside)
    core[1:-1, 1:-1, 1:-1] = inside[1:-1, 1:-1, 1:-1]
    if not np.array_equal(core, inside):
        raise DegenerateGeometry("the surface leaves the grid; accepted: values that are positive all around")
    cells = tuple(n - 1 for n in f.shape)
    total, count = np.zeros((int(np.prod(cells)), 3)), np.zeros(int(np.prod(cells)))
    quads = []
    for axis in range(3):
        lower = np.argwhere(np.diff(inside, axis=axis))
        upper = lower + np.eye(3, dtype=int)[axis]
        a, b = f[tuple(lower.T)], f[tuple(upper.T)]
        crossing = lower + ((a / (a - b))[:, None] * np.eye(3)[axis])
        p, q = np.eye(3, dtype=int)[(axis + 1) % 3], np.eye(3, dtype=int)[(axis + 2) % 3]
        # counter-clockwise about the axis
        around = np.stack([lower - p - q, lower - q, lower, lower - p], axis=1)
        index = np.asarray(np.ravel_multi_index(tuple(np.moveaxis(around, -1, 0)), cells))
        for corner in index.T:
            np.add.at(total, corner, crossing)
            np.add.at(count, corner, 1.0)
        quads.append(np.where((a < 0)[:, None], index, index[:, ::-1]))
    quad = np.concatenate(quads)
    used, quad = np.unique(quad, return_inverse=True)
    vertices = total[used] / count[used, None]
    return vertices, _triangles(vertices, quad.reshape(-1, 4))


def _triangles(vertices: Array, quads: NDArray[np.integer]) -> NDArray[np.integer]:
    """Quads (Q, 4) cut along the shorter diagonals: (2 Q, 3)."""
    corner = vertices[quads]
    first = np.linalg.norm(corner[:, 0] - corner[:, 2], axis=1) <= np.linalg.norm(
        corner[:, 1] - corner[:, 3], axis=1
    )
    turned = np.where(first[:, None], quads, np.roll(quads, -1, axis=1))
    return np.concatenate([turned[:, [0, 1, 2]], turned[:, [0, 2, 3]]])
