"""Grids of surface points, arcs by columns: their normals, their faces, and sigma along the normal."""

import numpy as np

from extremal.estimator.camera import Array


def grid_normals(points: Array, along: Array, outward: Array, run: np.ndarray) -> Array:
    """Unit normals (S, T, 3) of the surface through a grid of points.

    Where a column crosses the arcs is noisy along the arcs alone, and that does not turn the normal.

    Args:
        points: (S, T, 3) [m]. along: (S, T, 3) unit tangents of the arcs. outward: (S, T, 3) towards the outside.
        run: (S,) non-decreasing; arcs of one number are neighbours in order. Fewer than three have no normal but `outward`.
    """
    across = np.zeros_like(points)
    for k in np.unique(run):
        rows = np.flatnonzero(run == k)
        if len(rows) >= 3:
            across[rows] = np.gradient(points[rows], axis=0, edge_order=2)
    normals = np.cross(along, across)
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    normals = np.where(length > 0, normals / np.where(length > 0, length, 1.0), outward)
    return normals * np.where(np.sum(normals * outward, axis=-1, keepdims=True) < 0, -1.0, 1.0)


def normal_sigma(normals: Array, covariance: Array) -> Array:
    """Standard deviation (...) [m] along normals (..., 3) of points with covariance (..., 3, 3)."""
    variance = np.einsum("...i,...ij,...j->...", normals, covariance, normals)
    return np.sqrt(np.maximum(variance, 0.0))


def grid_faces(points: Array, normals: Array, valid: np.ndarray, run: np.ndarray) -> np.ndarray:
    """Triangles (F, 3) between valid neighbours of a grid, as rows of points.reshape(-1, 3), counter-clockwise from outside."""
    arcs, columns = valid.shape
    index = np.arange(arcs * columns).reshape(arcs, columns)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    near = (run[1:] == run[:-1])[:, None]
    triangles = np.concatenate(
        [
            np.stack(corners, axis=-1)[near & valid.ravel()[np.stack(corners)].all(axis=0)]
            for corners in ((a, b, c), (a, c, d))
        ]
    )
    p, n = points.reshape(-1, 3)[triangles], normals.reshape(-1, 3)[triangles].sum(axis=1)
    turned = np.sum(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]) * n, axis=1) < 0
    triangles[turned] = triangles[turned][:, [0, 2, 1]]
    return triangles
