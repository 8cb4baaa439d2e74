"""Level lines of a function on a closed triangle mesh."""

import numpy as np
from numpy.typing import NDArray

from extremal.scenes.curves import Array, arc_samples


def zero_polylines(vertices: Array, faces: NDArray[np.integer], level: Array) -> list[Array]:
    """Closed polylines (N, 3) on which a function, linear in every triangle, is zero.

    Points are at most 0.5 mm apart. A value of 0 counts as positive, so every triangle is crossed
    through two of its sides or not at all.

    Args:
        vertices: (V, 3) [m]; faces: (F, 3) of a closed mesh; level: (V,) values at the vertices.
    """
    positive = level >= 0
    crossed = faces[positive[faces].any(axis=1) & ~positive[faces].all(axis=1)]
    sides = np.sort(np.stack([crossed, np.roll(crossed, -1, axis=1)], axis=-1), axis=-1)
    cut = positive[sides[..., 0]] != positive[sides[..., 1]]
    ends, inverse = np.unique(sides[cut], axis=0, return_inverse=True)
    weight = level[ends[:, 0]] / (level[ends[:, 0]] - level[ends[:, 1]])
    points = vertices[ends[:, 0]] + weight[:, None] * (vertices[ends[:, 1]] - vertices[ends[:, 0]])
    neighbours: list[list[int]] = [[] for _ in ends]
    for a, b in inverse.reshape(-1, 2):
        neighbours[a].append(int(b))
        neighbours[b].append(int(a))
    return [_refined(points[loop]) for loop in _loops(neighbours)]


def _loops(neighbours: list[list[int]]) -> list[list[int]]:
    """Cycles of a graph in which every node has two neighbours, the first node repeated at the end."""
    loops, visited = [], [False] * len(neighbours)
    for start in range(len(neighbours)):
        if visited[start]:
            continue
        loop, node = [], start
        while not visited[node]:
            visited[node] = True
            loop.append(node)
            node = next((n for n in neighbours[node] if not visited[n]), start)
        loops.append([*loop, start])
    return loops


def _refined(points: Array) -> Array:
    """The polyline with its segments divided to 0.5 mm or less, without repeated points."""
    length = np.linalg.norm(np.diff(points, axis=0), axis=1)
    keep = np.append(True, length > 1e-12)
    points, length = points[keep], length[length > 1e-12]
    parts = [
        np.linspace(a, b, arc_samples(float(step)))[:-1]
        for a, b, step in zip(points[:-1], points[1:], length, strict=True)
    ]
    return np.concatenate([*parts, points[-1:]])
