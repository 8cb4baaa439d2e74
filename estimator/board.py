"""A ChArUco board: a chessboard whose white squares carry ArUco markers, which say which corner is which.

In the board's frame the origin is the outer top-left corner, x runs along the columns, y down, z into the board. It lies in
the plane z = 0, and all its edges on two families of straight lines.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from extremal.estimator.camera import Array
from extremal.estimator.errors import InvalidInput


@dataclass(frozen=True)
class Board:
    """A ChArUco board, as OpenCV 4.6 and later lay it out: a black square at the origin.

    Attributes:
        columns, rows: squares along x and y.
        square: side of a square [m].
        marker: side of a marker [m], its black border included.
        dictionary: a name of `cv2.aruco`'s predefined dictionaries.
        first_id: of the markers, numbered row by row.
    """

    columns: int = 9
    rows: int = 6
    square: float = 0.03
    marker: float = 0.0225
    dictionary: str = "DICT_4X4_100"
    first_id: int = 0

    def __post_init__(self) -> None:
        for name, count in (("columns", self.columns), ("rows", self.rows)):
            if not (isinstance(count, int | np.integer) and 3 <= count <= 100):
                raise InvalidInput(f"board {name} is {count!r}; accepted: a whole number from 3 to 100")
        if not (np.isfinite(self.square) and 1e-3 <= self.square <= 10):
            raise InvalidInput(f"board square is {self.square!r}; accepted: a length from 0.001 to 10 m")
        if not 0.3 * self.square <= self.marker <= 0.95 * self.square:
            raise InvalidInput(
                f"board marker is {self.marker!r}; accepted: 0.3 to 0.95 of the square's {self.square} m"
            )
        names = [name for name in dir(cv2.aruco) if name.startswith("DICT_") and "APRIL" not in name]
        if self.dictionary not in names:
            raise InvalidInput(f"board dictionary is {self.dictionary!r}; accepted: {', '.join(names)}")
        known = len(self._dictionary.bytesList)
        if not 0 <= self.first_id <= known - self._markers:
            raise InvalidInput(
                f"board of {self._markers} markers, the first of id {self.first_id!r}: {self.dictionary} has ids 0 to {known - 1}"
            )

    @property
    def _markers(self) -> int:
        return self.columns * self.rows // 2

    @property
    def _dictionary(self) -> cv2.aruco.Dictionary:
        return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))

    @property
    def opencv(self) -> cv2.aruco.CharucoBoard:
        """The same board in OpenCV's terms."""
        ids = self.first_id + np.arange(self._markers)
        return cv2.aruco.CharucoBoard(
            (self.columns, self.rows), self.square, self.marker, self._dictionary, ids
        )

    def scaled(self, factor: float) -> "Board":
        """The same pattern, larger by `factor`."""
        return replace(self, square=self.square * factor, marker=self.marker * factor)

    @property
    def size(self) -> Array:
        """Width and height (2,) [m]."""
        return self.square * np.array([self.columns, self.rows], float)

    @property
    def outline(self) -> Array:
        """Outer corners (4, 3) [m], clockwise from the origin as the viewer sees them."""
        width, height = self.size
        return np.array([[0, 0, 0], [width, 0, 0], [width, height, 0], [0, height, 0.0]])

    @cached_property
    def corners(self) -> Array:
        """Inner corners (N, 3) [m], row by row: OpenCV's ids are their indices."""
        x, y = np.meshgrid(np.arange(1, self.columns), np.arange(1, self.rows))
        return self.square * np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=-1)

    @cached_property
    def module(self) -> float:
        """Side of a marker's cell [m]."""
        return self.marker / (self._dictionary.markerSize + 2)

    def modules(self) -> tuple[Array, Array, NDArray[np.bool_]]:
        """The printed pattern: lines x (X,) and y (Y,) [m], and which cells (Y - 1, X - 1) between them are black."""
        cells = self._dictionary.markerSize + 2
        within = np.concatenate([[0.0], (self.square - self.marker) / 2 + self.module * np.arange(cells + 1)])
        x, y = (
            np.append((self.square * np.arange(n)[:, None] + within).ravel(), self.square * n)
            for n in (self.columns, self.rows)
        )
        i, j = np.meshgrid(np.arange(self.rows), np.arange(self.columns), indexing="ij")
        black = np.zeros((self.rows, cells + 2, self.columns, cells + 2), bool)
        dark = (i + j) % 2 == 0
        black[i[dark], :, j[dark], :] = True
        for k, (row, column) in enumerate(zip(i[~dark], j[~dark], strict=True)):
            marker = self._dictionary.generateImageMarker(self.first_id + k, cells, borderBits=1)
            black[row, 1:-1, column, 1:-1] = marker == 0
        return x, y, black.reshape(self.rows * (cells + 2), -1)
