"""Parameter grids whose facets stay within a chord error, and their triangles."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from extremal.estimator.errors import InvalidInput
from extremal.scenes.curves import Array

# Chord error [m] accepted along curved directions: 0.0015 px at 0.5 m with f = 800 px.
CHORD = 9.4e-7


@dataclass(frozen=True)
class Facets:
    """How finely curved surfaces are cut into triangles.

    Attributes:
        columns: around a lathe; of other shapes as many at most, and half as many rows.
        rows: of a lathe, at most.
        chord: error [m] of a facet across the rows, where these numbers allow it; around: across the columns of other
            shapes than lathes.
    """

    columns: int = 1024
    rows: int = 256
    chord: float = CHORD
    around: float = 2e-7

    def __post_init__(self) -> None:
        for name, least in (("columns", 16), ("rows", 8)):
            if not (isinstance(getattr(self, name), int) and least <= getattr(self, name) <= 4096):
                raise InvalidInput(
                    f"facets' {name} is {getattr(self, name)!r}; accepted: a whole number from {least} to 4096"
                )
        for name in ("chord", "around"):
            if not 1e-9 <= getattr(self, name) <= 1e-2:
                raise InvalidInput(f"facets' {name} is {getattr(self, name)!r}; accepted: 1e-9 to 0.01 m")


MEASURED = Facets()  # facets masquerade as curvature: what is measured finely needs these
# For frames of quality `preview`, whose edges are off by 0.03 to 0.06 px: a sixth of the vertices, which take most of a frame's
# time, and edges that differ by 0.01 px from view to view at 0.14 m, by less from farther away.
QUICK = Facets(256, 192, 2e-6, 5e-6)


def adaptive_grid(
    samples: Array, bending: Array, bounds: Array, most: int = 256, chord: float = CHORD
) -> Array:
    """Parameters between which chords leave a curve by about `chord` [m].

    A chord over du leaves the curve by |x_uu . n| du^2 / 8, so rows are dense as sqrt(bending / (8 chord)).

    Args:
        samples: (M,) increasing parameters.
        bending: (M,) |x_uu . n| [m] there (the largest of a family of curves).
        bounds: (B,) increasing parameters that must be rows, first and last those of the curve.
        most: number of intervals at most; the chord error is then larger.
    """
    density = np.sqrt(bending / (8 * chord))
    density = np.maximum(density, 8 / (samples[-1] - samples[0]))
    total = np.concatenate([[0.0], np.cumsum((density[1:] + density[:-1]) / 2 * np.diff(samples))])
    total *= min(1.0, most / total[-1])
    rows = [bounds[:1]]
    for lo, hi in pairwise(bounds):
        begin, end = np.interp([lo, hi], samples, total)
        levels = np.linspace(begin, end, int(np.ceil(end - begin - 1e-9)) + 1)
        rows.append(np.append(np.interp(levels[1:-1], total, samples), hi))
    return np.concatenate(rows)


def azimuths(bounds: Array, columns: int) -> Array:
    """Angles (N,) from 0 up to 2 pi (excluded) that include `bounds` (B,) [rad] exactly.

    Regular columns nearer than a tenth of the spacing to a bound give way to it.
    """
    spacing = 2 * np.pi / columns
    regular = np.arange(columns) * spacing
    bounds = distinct(np.mod(bounds, 2 * np.pi))
    bounds = bounds[bounds < 2 * np.pi - 1e-9] if len(bounds) and bounds[0] < 1e-9 else bounds
    if len(bounds):
        gap = np.abs(np.mod(regular[:, None] - bounds + np.pi, 2 * np.pi) - np.pi).min(axis=1)
        regular = regular[gap > spacing / 10]
    return np.sort(np.concatenate([regular, bounds]))


def distinct(values: Array) -> Array:
    """The values (N,) in order, without those within 1e-9 of the one before (rounding of equal bounds)."""
    values = np.sort(values)
    return values[np.diff(values, prepend=-np.inf) > 1e-9]


def grid_triangles(cells: NDArray[np.bool_], wrap: bool) -> NDArray[np.integer]:
    """Triangles (F, 3) of the chosen cells of a grid of vertices numbered row by row.

    Args:
        cells: (rows - 1, columns or columns - 1) bool, which cells to draw.
        wrap: whether the last column is joined to the first.

    Facing: (column direction) x (row direction) is outward.
    """
    columns = cells.shape[1] + (0 if wrap else 1)
    i, j = np.nonzero(cells)
    k = (j + 1) % columns
    a, b, c, d = i * columns + j, i * columns + k, (i + 1) * columns + k, (i + 1) * columns + j
    return np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])


def used_only(
    vertices: Array, normals: Array, faces: NDArray[np.integer]
) -> tuple[Array, Array, NDArray[np.integer]]:
    """The same triangles without the vertices that none of them uses."""
    used, inverse = np.unique(faces, return_inverse=True)
    return vertices[used], normals[used], inverse.reshape(faces.shape)
