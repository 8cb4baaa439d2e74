"""Meshes of star-shaped closed surfaces on a grid of latitude and longitude."""

from collections.abc import Callable

import numpy as np

from extremal.scenes.curves import Array, Colour, Piece
from extremal.scenes.grids import Facets, adaptive_grid, grid_triangles, used_only


def radial_piece(
    point: Callable[[Array], Array], normal: Callable[[Array], Array], rgba: Colour, facets: Facets
) -> Piece:
    """Mesh of the surface that meets each direction from the origin once.

    Rows and columns are as dense as the largest bending of the surface across them asks for.

    Args:
        point: maps unit directions (..., 3) to points (..., 3) of the surface [m].
        normal: outward unit normals (..., 3) at points of the surface.
        rgba: colour.
        facets: how finely it is cut.
    """

    def place(latitude: Array, longitude: Array) -> Array:
        cos, sin = np.broadcast_arrays(np.cos(latitude), np.sin(latitude) + 0 * longitude)
        return point(np.stack([cos * np.cos(longitude), cos * np.sin(longitude), sin], axis=-1))

    eps = 1e-3
    latitude = np.linspace(-np.pi / 2, np.pi / 2, 301)
    longitude = np.linspace(0, 2 * np.pi, 601)
    p = place(latitude[:, None], longitude)
    n = normal(p)
    across = place(latitude[:, None] + eps, longitude) + place(latitude[:, None] - eps, longitude) - 2 * p
    along = place(latitude[:, None], longitude + eps) + place(latitude[:, None], longitude - eps) - 2 * p
    rows_bending = np.abs(np.sum(across * n, axis=-1)).max(axis=1) / eps**2
    columns_bending = np.abs(np.sum(along * n, axis=-1)).max(axis=0) / eps**2
    rows = adaptive_grid(latitude, rows_bending, latitude[[0, -1]], facets.columns // 2, facets.chord)
    columns = adaptive_grid(longitude, columns_bending, longitude[[0, -1]], facets.columns, facets.around)
    vertices = place(rows[:, None], columns[:-1]).reshape(-1, 3)
    faces = grid_triangles(np.ones((len(rows) - 1, len(columns) - 1), bool), wrap=True)
    corners = vertices[faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=-1)
    return Piece(*used_only(vertices, normal(vertices), faces[area > 1e-14]), rgba)
