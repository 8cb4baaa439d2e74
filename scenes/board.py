"""A ChArUco board as an object: a thin plate with the printed pattern as exact geometry."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from extremal.estimator.board import Board
from extremal.scenes.box import Box
from extremal.scenes.curves import (
    Appearance,
    Array,
    Colour,
    Piece,
    SurfaceCurve,
    arc_samples,
    check_colour,
    check_length,
)
from extremal.scenes.grids import MEASURED, Facets, grid_triangles, used_only
from extremal.scenes.markings import FACES
from extremal.scenes.surface import Surface

OUTWARD = np.array([0.0, 0.0, -1.0])  # of the printed face: z points into the board


@dataclass(frozen=True, kw_only=True, eq=False)
class CalibrationBoard(Surface):
    """A plate whose printed face is the plane z = 0 of the board's frame, with a white margin of one module around the pattern.

    Every line between black and white is a fixed feature; those of the markers, too.

    Attributes:
        board: what is printed.
        thickness: [m] of the plate.
        ink: colour of the black cells; the plate has the appearance's.

    Raises:
        SceneError: for a thickness or a colour that is not acceptable.
    """

    board: Board = field(default_factory=Board)
    thickness: float = 0.004
    ink: Colour = (0.05, 0.05, 0.05, 1.0)
    appearance: Appearance = field(default_factory=lambda: Appearance((0.9, 0.9, 0.9, 1.0)))

    def _check(self) -> None:
        check_length(f"{self.name}: thickness", self.thickness)
        check_colour(f"{self.name}: ink", self.ink)

    @cached_property
    def _middle(self) -> Array:
        """Centre (3,) of the plate."""
        return np.append(self.board.size, self.thickness) / 2

    @cached_property
    def _plate(self) -> Box:
        margin = 2 * self.board.module
        return Box((*(self.board.size + margin), self.thickness), name=self.name, appearance=self.appearance)

    # The plate, about its own centre, answers all that colours have no part in.

    @property
    def _bounds(self) -> tuple[Array, float]:
        return self._middle, self._plate._bounds[1]

    def _frame(self, p: Array) -> tuple[Array, Array]:
        return self._plate._frame(p - self._middle)

    def _level(self, p: Array) -> Array:
        return self._plate._level(p - self._middle)

    def _signed_distance(self, p: Array) -> Array:
        return self._plate._signed_distance(p - self._middle)

    def _intersect(self, origins: Array, directions: Array) -> Array:
        return self._plate._intersect(origins - self._middle, directions)

    def _contour(self, centre: Array) -> list[Array]:
        return []

    @cached_property
    def _cells(self) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Lines x (X,) and y (Y,) of the printed face, its margin included, and which cells (Y - 1, X - 1) are black."""
        x, y, black = self.board.modules()
        x, y = (np.concatenate([[-self.board.module], v, [v[-1] + self.board.module]]) for v in (x, y))
        return x, y, np.pad(black, 1)

    def _fixed(self) -> list[SurfaceCurve]:
        x, y, black = self._cells
        creases = [replace(curve, points=curve.points + self._middle) for curve in self._plate._fixed()]
        upright = self._lines("x", x[1:-1], y, np.diff(black, axis=1).T)
        return [*creases, *upright, *self._lines("y", y[1:-1], x, np.diff(black, axis=0))]

    def _lines(self, axis: str, at: Array, along: Array, changes: NDArray[np.bool_]) -> list[SurfaceCurve]:
        """Unbroken stretches on the lines `at` (n,) where colours change: (n, m - 1), between the m nodes `along`."""
        ends = np.diff(np.pad(changes.astype(int), ((0, 0), (1, 1))), axis=1)
        curves = []
        for (line, start), (_, stop) in zip(np.argwhere(ends > 0), np.argwhere(ends < 0), strict=True):
            count = arc_samples(float(along[stop] - along[start]))
            points = np.zeros((count, 3))
            points[:, "xy".index(axis)] = at[line]
            points[:, "yx".index(axis)] = np.linspace(along[start], along[stop], count)
            name = f"{self.name}/{axis}{line}.{start}"
            normals, visible = np.tile(OUTWARD, (count, 1)), np.ones(count, bool)
            curves.append(SurfaceCurve(name, self.name, "marking", points, normals, visible))
        return curves

    def _pieces(self, facets: Facets = MEASURED) -> list[Piece]:
        """The ink, and the paper with the other faces; on the printed face both share the nodes of one grid: no seams."""
        x, y, black = self._cells
        grid = np.stack([*np.meshgrid(x, y), np.zeros((len(y), len(x)))], axis=-1).reshape(-1, 3)
        normals = np.tile(OUTWARD, (len(grid), 1))
        ink, paper = (
            Piece(*used_only(grid, normals, grid_triangles(cells, wrap=False)[:, ::-1]), colour)
            for cells, colour in ((black, self.ink), (~black, self.appearance.rgba))
        )
        sides = [piece for face in FACES if face != "-z" for piece in self._plate._face_pieces(face)]
        sides = [replace(side, vertices=side.vertices + self._middle) for side in sides]
        return [_joined([paper, *sides]), ink]


def _joined(pieces: Sequence[Piece]) -> Piece:
    first = np.cumsum([0, *(len(piece.vertices) for piece in pieces[:-1])])
    return Piece(
        np.concatenate([piece.vertices for piece in pieces]),
        np.concatenate([piece.normals for piece in pieces]),
        np.concatenate([piece.faces + start for piece, start in zip(pieces, first, strict=True)]),
        pieces[0].rgba,
    )
