"""The surface beyond a strip: its arcs continued to both sides of what was seen (Cipolla ch. 3, figure 3.15).

The book continues computed curvatures. Here every arc goes on with its own terms, the higher ones as large as evidence
allows; what is not known of them makes sigma grow with the angle beyond the last view. That sigma marks how far the surface
can be trusted.
"""

from dataclasses import dataclass

import numpy as np

from extremal.estimator.camera import Array
from extremal.estimator.errors import InvalidInput
from extremal.estimator.strip import Strip
from extremal.estimator.strip_arcs import FARTHEST
from extremal.estimator.strip_grid import grid_faces, normal_sigma

STEP = 0.025  # [rad] between columns beyond the strip: about 1 mm of a vase
COLUMNS = 15  # of the strip itself


@dataclass(frozen=True, eq=False)
class Extrapolation:
    """S arcs by K columns, from before a strip's first view to beyond its last.

    Attributes:
        phi: (S, K) [rad]; points: (S, K, 3) [m]; covariance: (S, K, 3, 3) [m^2]; normals: (S, K, 3) unit, out of the surface.
        sigma: (S, K) [m] along the normal.
        shape_sigma: (S, K) [m] the same without what moves the strip and all cameras together (`Strip.world`).
        seen: (S, K) columns within the strip.
        valid: (S, K) whether the surface still bends as a visible one does, from the strip to there.
        run: (S,) as in `Strip`.
    """

    phi: Array
    points: Array
    covariance: Array
    normals: Array
    sigma: Array
    shape_sigma: Array
    seen: np.ndarray
    valid: np.ndarray
    run: np.ndarray

    def trusted(self, sigma: float) -> np.ndarray:
        """Vertices (S, K) whose shape is known to `sigma` [m] along the normal, as is all between them and the strip.

        Raises InvalidInput for a sigma that is not positive.
        """
        if not sigma > 0:
            raise InvalidInput(f"sigma is {sigma!r}; accepted: a positive standard deviation [m]")
        return _connected(self.valid & (self.shape_sigma < sigma), self.seen)

    def faces(self, chosen: np.ndarray) -> np.ndarray:
        """(F, 3) triangles between chosen vertices (S, K): rows of points.reshape(-1, 3), counter-clockwise from outside."""
        return grid_faces(self.points, self.normals, chosen, self.run)


def extrapolate(strip: Strip, angle: float = 0.7) -> Extrapolation:
    """The strip's surface and what lies beyond it.

    Args:
        angle: [rad] by which normals turn beyond the first and the last view; up to 1.5 from the reference view.

    Raises:
        InvalidInput: an angle that is not positive.
    """
    if not (np.isfinite(angle) and angle > 0):
        raise InvalidInput(f"angle is {angle!r}; accepted: a positive angle [rad]")
    first, last = strip.arcs.first[:, None], strip.arcs.last[:, None]
    beyond = STEP * np.arange(1, int(np.ceil(angle / STEP)) + 1)
    inside = first + (last - first) * np.linspace(0, 1, COLUMNS)
    phi = np.concatenate([first - beyond[::-1], inside, last + beyond], axis=1)
    seen = np.zeros(phi.shape, bool)
    seen[:, len(beyond) : -len(beyond)] = True
    points, covariance, normals = strip.at(phi)
    radius, _ = strip.arcs.radius(phi)
    bent = (radius * strip.side[:, None] > 0) & (np.abs(phi) < FARTHEST)
    return Extrapolation(
        phi,
        points,
        covariance,
        normals,
        normal_sigma(normals, covariance),
        normal_sigma(normals, strip.arcs.points(phi)[1]),
        seen,
        _connected(bent, seen),
        strip.run,
    )


def _connected(good: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Columns (S, K) that are good, as are all from the strip to there."""
    first, last = int(np.argmax(seen[0])), seen.shape[1] - int(np.argmax(seen[0, ::-1]))
    out = good.copy()
    out[:, :first] = np.logical_and.accumulate(good[:, first::-1], axis=1)[:, :0:-1]
    out[:, last - 1 :] = np.logical_and.accumulate(good[:, last - 1 :], axis=1)
    return out
