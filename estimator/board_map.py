"""A smooth map from a board to its image: a homography, then a cubic of its pixels for what a lens does to them.

Distortion is a polynomial of the pinhole image's coordinates, not of the board's: so bent edges of a slanted board are
straightened as exactly as of one that faces the camera.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from extremal.estimator.camera import Array

BENDING = 0.3  # of the image's width w: a lens moves points of a board that fills a share x of it by about this times w x^3
ROBUST = 3.0  # standard deviations at which a point has lost three quarters of its weight
STENCIL = 0.2  # [squares] of the differences that give derivatives
POWERS = np.array([(i, j) for i in range(4) for j in range(4 - i)])  # of the cubic's two variables
DEGREE = POWERS.sum(axis=1)


@dataclass(frozen=True, eq=False)
class BoardMap:
    """Pixels of points of the board, whose coordinates are counted in squares.

    Attributes:
        homography: (3, 3).
        middle, half: (2,) and scalar [px] of what it was fitted to: the cubic's variables are (pixel - middle) / half, with
            the homography's pixels.
        cubic: (10, 2) coefficients [px].
    """

    homography: Array
    middle: Array
    half: float
    cubic: Array

    @staticmethod
    def fit(points: Array, pixels: Array, sigma: float, tolerance: float, width: int) -> "BoardMap | None":
        """The map of points (n, 2) to pixels (n, 2), some of which may be wrong; None where there is none.

        Args:
            sigma: [px] how exactly the pixels are known, or how well the cubic will do.
            tolerance: [px] from the homography, beyond which a point is certainly wrong: more than distortion explains.
            width: [px] of the image. The smaller the part of it that the points fill, the less a lens can bend it.
        """
        if len(points) < 4 or min(np.ptp(points, axis=0)) == 0:
            return None
        found, inside = cv2.findHomography(points, pixels, cv2.RANSAC, tolerance)
        if found is None or np.sum(inside) < 4 or not np.all(np.isfinite(found)):
            return None
        kept = np.ravel(inside) > 0
        points, pixels = points[kept], pixels[kept]
        middle, half = pixels.mean(axis=0), float(np.ptp(pixels, axis=0).max()) / 2
        plane = BoardMap(np.asarray(found, float), middle, half, np.zeros((len(POWERS), 2)))
        through = plane(points)
        left, basis = pixels - through, _monomials((through - middle) / half)
        share = half / width
        # what two rows of corners leave open is taken to be linear
        expected = BENDING * width * np.where(DEGREE > 1, share**DEGREE, 1.0)
        cubic, weight = plane.cubic, np.ones(len(points))
        for _ in range(8):
            normal = basis.T @ (weight[:, None] * basis) + np.diag((sigma / expected) ** 2)
            cubic = np.linalg.solve(normal, basis.T @ (weight[:, None] * left))
            far = np.sum((left - basis @ cubic) ** 2, axis=1) / (ROBUST * sigma) ** 2
            weight = 1 / (1 + far) ** 2  # Geman and McClure
        return BoardMap(plane.homography, middle, half, cubic)

    def __call__(self, points: Array) -> Array:
        """Pixels (..., 2) of points (..., 2)."""
        h = points @ self.homography[:, :2].T + self.homography[:, 2]
        pixels = h[..., :2] / h[..., 2:]
        return pixels + _monomials((pixels - self.middle) / self.half) @ self.cubic

    def derivatives(self, points: Array) -> tuple[Array, Array]:
        """First (..., 2, 2) and second (..., 2, 2, 2) derivatives of the pixel by the point; the pixel's axis leads."""
        e = STENCIL * np.eye(2)
        here, ahead, behind = self(points), [self(points + d) for d in e], [self(points - d) for d in e]
        first = np.stack([(a - b) / (2 * STENCIL) for a, b in zip(ahead, behind, strict=True)], axis=-1)
        xx, yy = ((a - 2 * here + b) / STENCIL**2 for a, b in zip(ahead, behind, strict=True))
        xy = self(points + e.sum(axis=0)) - ahead[0] - ahead[1] + here
        xy = (xy + self(points - e.sum(axis=0)) - behind[0] - behind[1] + here) / (2 * STENCIL**2)
        return first, np.stack([np.stack([xx, xy], axis=-1), np.stack([xy, yy], axis=-1)], axis=-1)


def _monomials(p: Array) -> Array:
    return np.stack([p[..., 0] ** i * p[..., 1] ** j for i, j in POWERS], axis=-1)
