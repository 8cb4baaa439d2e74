"""Corners of a ChArUco board in an image: OpenCV finds the markers, a fit of the blurred pattern localises the corners."""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from extremal.estimator.board import Board
from extremal.estimator.board_map import BoardMap
from extremal.estimator.camera import Array, Camera
from extremal.estimator.corner_fit import CornerFit, Windows, fit_corners
from extremal.estimator.errors import InvalidInput

FEWEST = 6  # corners: with fewer no map tells right from wrong
BLUR = 0.75  # [px] expected at first
REACH = 1.6  # squares from the middle of a marker that was found, within which corners are looked for
MARKER_SIGMA, CORNER_SIGMA = 0.4, 0.05  # [px] from the smooth map through all of them
SYSTEMATIC = 0.003  # [px] what the model leaves, along either axis
MOST_ROUNDS = 6  # fits, each with the map through the corners of the one before
FAINTEST = 8.0  # standard deviations of the noise that white and black differ by
BLURRED = 3.0  # [px] across an edge, from which a window does not show both levels
MISFIT, RELATIVE = (
    3.0,
    0.02,
)  # variance of residuals beyond the image's own, and beyond this share of the contrast
APART = 0.04  # [px] from the map through all corners, beyond its own spread


@dataclass(frozen=True, eq=False)
class Corners:
    """Chessboard corners found in an image.

    Attributes:
        ids: (n,) indices into the board's corners.
        pixels: (n, 2) where they are seen.
        covariance: (n, 2, 2) [px^2] of `pixels`, positive definite.

    Raises InvalidInput for other shapes, negative or repeated ids, and numbers that are none of these.
    """

    ids: NDArray[np.integer]
    pixels: Array
    covariance: Array

    def __post_init__(self) -> None:
        n = len(self.ids)
        if self.ids.shape != (n,) or self.pixels.shape != (n, 2) or self.covariance.shape != (n, 2, 2):
            raise InvalidInput(
                f"corners have ids {self.ids.shape}, pixels {self.pixels.shape} and covariance {self.covariance.shape}; "
                "accepted: (n,), (n, 2) and (n, 2, 2)"
            )
        whole = n == 0 or np.issubdtype(self.ids.dtype, np.integer)
        if not (whole and np.all(self.ids >= 0) and len(np.unique(self.ids)) == n):
            raise InvalidInput(
                f"ids of corners are {self.ids.tolist()!r:.200}; accepted: different whole numbers from 0"
            )
        if not np.all(np.isfinite(self.pixels)):
            raise InvalidInput("pixels of corners hold a number that is not finite")
        (a, b), (c, d) = np.moveaxis(self.covariance, 0, -1)
        if not np.all((a > 0) & (d > 0) & (np.abs(b - c) <= 1e-9 * (a + d)) & (a * d - b * c > 0)):
            raise InvalidInput("a covariance of corners is not symmetric and positive definite")

    def on(self, board: Board) -> Array:
        """(n, 3) [m] where they are on the board; InvalidInput where it has no such corner."""
        most = len(board.corners) - 1
        if np.any(self.ids > most):
            raise InvalidInput(f"a corner has the id {self.ids.max()}; accepted: 0 to {most}, the board's")
        return board.corners[self.ids]

    def __len__(self) -> int:
        return len(self.ids)

    def __getitem__(self, chosen: NDArray[np.integer | np.bool_] | slice) -> "Corners":
        return Corners(self.ids[chosen], self.pixels[chosen], self.covariance[chosen])


NOTHING = Corners(np.zeros(0, int), np.zeros((0, 2)), np.zeros((0, 2, 2)))


def find_corners(image: NDArray[np.uint8], camera: Camera | None, board: Board) -> Corners:
    """All corners of the board that can be localised, with honest covariance; none where the board is not found.

    Corners that are hidden in part, cut by the border or otherwise unlike a corner are left out.

    Args:
        image: grey (height, width) or RGB (height, width, 3).
        camera: whose response to light is undone; None: grey levels are taken to be proportional to light.

    Raises InvalidInput for an image of another shape or type, or without pixels.
    """
    grey = (camera or Camera()).linear(image)
    if grey.size == 0:
        raise InvalidInput(f"image is {image.shape}; accepted: one or more pixels")
    width = grey.shape[1]
    lattice = board.corners[:, :2] / board.square
    markers = _markers(image, board)
    through, blur = markers.map(width), np.full(2, BLUR)
    near, found = markers.middles, NOTHING
    for _ in range(MOST_ROUNDS):  # from the markers outwards, until the corners are the same twice
        if through is None:
            return NOTHING
        ids = np.flatnonzero(np.any(_distances(lattice, near) < REACH, axis=1))
        fit = fit_corners(grey, _windows(board, lattice[ids], through, blur))
        before, good = found, _alike(fit)
        for _ in range(2):  # a wrong corner bends the map: once more without it
            if good.sum() < FEWEST:
                return NOTHING
            through = BoardMap.fit(
                lattice[ids[good]], fit.pixels[good], CORNER_SIGMA, markers.tolerance, width
            )
            if through is None:
                return NOTHING
            good &= _in_place(fit, good, through(lattice[ids]))
        found = Corners(ids[good], fit.pixels[good], _covariance(fit, good)[good])
        if np.array_equal(found.ids, before.ids):
            break
        near, blur = np.concatenate([markers.middles, lattice[found.ids]]), np.median(fit.blur[good], axis=0)
    return found


def _alike(fit: CornerFit) -> NDArray[np.bool_]:
    """Corners (n,) that were found, with residuals like the others'."""
    good = (
        fit.settled & (fit.contrast > FAINTEST * np.sqrt(fit.variance)) & np.all(fit.blur < BLURRED, axis=1)
    )
    usual = np.quantile(fit.variance[good], 0.25) if good.any() else 0.0
    return good & (fit.variance < MISFIT * usual + (RELATIVE * fit.contrast) ** 2)


def _in_place(fit: CornerFit, good: NDArray[np.bool_], expected: Array) -> NDArray[np.bool_]:
    """Corners (n,) that stand where the good ones let expect (n, 2)."""
    if not good.any():
        return good
    apart = np.linalg.norm(fit.pixels - expected, axis=1)
    sigma = np.sqrt(np.trace(_covariance(fit, good), axis1=1, axis2=2))
    return apart < APART + 5 * (1.4826 * np.median(apart[good]) + sigma)


def _covariance(fit: CornerFit, good: NDArray[np.bool_]) -> Array:
    """(n, 2, 2) [px^2] from the noise that the residuals show, at each corner or elsewhere."""
    usual = np.median(fit.variance[good]) if good.any() else 0.0
    return fit.covariance * np.maximum(fit.variance, usual)[:, None, None] + SYSTEMATIC**2 * np.eye(2)


@lru_cache(maxsize=8)
def _detector(board: Board) -> cv2.aruco.ArucoDetector:
    return cv2.aruco.ArucoDetector(board.opencv.getDictionary(), cv2.aruco.DetectorParameters())


@dataclass(frozen=True, eq=False)
class _Markers:
    """Corners of m markers: places (m, 4, 2) [squares] on the board and pixels (m, 4, 2)."""

    places: Array
    pixels: Array

    @property
    def middles(self) -> Array:
        """(m, 2) [squares]."""
        return self.places.mean(axis=1)

    @property
    def tolerance(self) -> float:
        """[px] that a lens may put points away from a homography: a quarter of a marker."""
        sides = np.linalg.norm(np.diff(self.pixels, axis=1), axis=2) if len(self.pixels) else np.zeros(1)
        return 0.25 * float(np.median(sides))

    def map(self, width: int) -> BoardMap | None:
        """The map through the markers."""
        return BoardMap.fit(
            self.places.reshape(-1, 2), self.pixels.reshape(-1, 2), MARKER_SIGMA, self.tolerance, width
        )


def _markers(image: NDArray[np.uint8], board: Board) -> _Markers:
    """The board's markers that OpenCV finds, a few tenths of a pixel exactly."""
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    pattern, detector = board.opencv, _detector(board)
    found, ids, rejected = detector.detectMarkers(grey)[:3]
    if ids is None:
        return _Markers(np.zeros((0, 4, 2)), np.zeros((0, 4, 2)))
    found, ids = detector.refineDetectedMarkers(grey, pattern, found, ids, rejected)[:2]
    rows = np.ravel(ids).astype(int) - board.first_id
    known = (rows >= 0) & (rows < len(pattern.getObjPoints()))
    places = np.array([np.reshape(p, (4, 3))[:, :2] for p in pattern.getObjPoints()], float)
    pixels = np.array([np.reshape(corners, (4, 2)) for corners in found], float)
    return _Markers(places[rows[known]] / board.square, pixels[known])


def _distances(a: Array, b: Array) -> Array:
    return np.linalg.norm(a[:, None] - b, axis=2)


def _windows(board: Board, places: Array, through: BoardMap, blur: Array) -> Windows:
    first, second = through.derivatives(places)
    dark = np.where(np.sum(np.rint(places), axis=1) % 2 == 0, 1.0, -1.0)
    gap = 0.5 * (1 - board.marker / board.square)
    return Windows(through(places), first, second, dark, gap, board.module / board.square, blur)
