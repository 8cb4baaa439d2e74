"""A lathe's meshes: its side split by colour along exact grid lines, and its two caps."""

import numpy as np

from extremal.scenes.curves import Array, Colour, Piece
from extremal.scenes.grids import Facets, adaptive_grid, azimuths, distinct, grid_triangles, used_only
from extremal.scenes.markings import LathePatch
from extremal.scenes.profile import Profile


def lathe_pieces(
    profile: Profile, rgba: Colour, markings: tuple[LathePatch, ...], facets: Facets
) -> list[Piece]:
    """One piece a colour of the side, with exact vertices and smooth normals along the seams, and the caps."""
    z = _rows(profile, np.array([v for m in markings for v in (m.bottom, m.top)]), facets)
    edges = [m.start + offset for m in markings if not m.is_band for offset in (0.0, m.width)]
    theta = azimuths(np.array(edges), facets.columns)
    r, r1, _ = profile.derivatives(z)
    cos, sin = np.cos(theta), np.sin(theta)
    shape = (len(z), len(theta))
    vertices = np.stack(
        [r[:, None] * cos, r[:, None] * sin, np.broadcast_to(z[:, None], shape)], axis=-1
    ).reshape(-1, 3)
    normals = (
        np.stack(
            [np.broadcast_to(cos, shape), np.broadcast_to(sin, shape), np.broadcast_to(-r1[:, None], shape)],
            axis=-1,
        )
        / np.sqrt(1 + r1 * r1)[:, None, None]
    )
    normals = normals.reshape(-1, 3)
    middle_z = (z[:-1] + z[1:]) / 2
    middle_theta = theta + np.mod(np.roll(theta, -1) - theta, 2 * np.pi) / 2
    colours, paint = [rgba], np.zeros((len(z) - 1, len(theta)), int)
    for m in markings:
        if m.rgba not in colours:
            colours.append(m.rgba)
        within = m.is_band | (np.mod(middle_theta - m.start, 2 * np.pi) < m.width)
        rows = (middle_z > m.bottom) & (middle_z < m.top)
        paint[np.ix_(rows, np.broadcast_to(within, theta.shape))] = colours.index(m.rgba)
    pieces = [
        Piece(*used_only(vertices, normals, grid_triangles(paint == i, wrap=True)), colour)
        for i, colour in enumerate(colours)
        if np.any(paint == i)
    ]
    return [*pieces, _cap(vertices[: len(theta)], -1, rgba), _cap(vertices[-len(theta) :], 1, rgba)]


def _rows(profile: Profile, bounds: Array, facets: Facets) -> Array:
    samples = np.linspace(0, profile.height, 4001)
    _, r1, r2 = profile.derivatives(samples)
    bending = np.abs(r2) / np.sqrt(1 + r1 * r1)
    bounds = distinct(np.concatenate([[0, profile.height], bounds]))
    return adaptive_grid(samples, bending, bounds, facets.rows, facets.chord)


def _cap(ring: Array, up: int, rgba: Colour) -> Piece:
    """Flat disc: a fan from the centre to the ring (N, 3), facing along z (`up` = 1) or against it."""
    n = len(ring)
    vertices = np.concatenate([ring, [[0, 0, ring[0, 2]]]])
    i = np.arange(n)
    faces = np.stack([i, np.roll(i, -1), np.full(n, n)], axis=1)[:, ::up]
    return Piece(vertices, np.tile([0.0, 0.0, float(up)], (n + 1, 1)), faces, rgba)
