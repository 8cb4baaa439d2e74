"""Which contours run beside others in the image: there, as in rendered frames, one may be taken for the other."""

import math

import numpy as np
from numpy.typing import NDArray

from extremal.estimator.camera import Array
from extremal.estimator.matching import ALIKE
from extremal.estimator.sequential import COMPANY
from extremal.tasks.compiled import compiled
from extremal.tasks.triples import row, turned_back

BEYOND = 0.5  # of the chord between two tracks, by which their contour goes on to either side
LEAST_SLOPE = 1e-12


@compiled
def in_company(
    pixels: Array,
    normals: Array,
    pose: Array,
    focal: tuple[float, float],
    contour: NDArray[np.integer],
    there: NDArray[np.bool_],
) -> NDArray[np.bool_]:
    """Beside which of n tracks another contour runs, within COMPANY pixels across: the geometry of `sequential.in_company`.

    Args:
        pixels: (n, 2) of tracks, in order along their contours (n,). normals: (n, 3) of the tangent planes, in the world.
        pose: (4, 4) of the camera. focal: [px]. there: (n,) which the scene has, hidden by nothing.
    """
    n = len(pixels)
    out = np.zeros(n, np.bool_)
    for i in range(n):
        if not there[i]:
            continue
        normal = turned_back(pose, row(normals, i))
        px, py = normal[0] / focal[0], normal[1] / focal[1]
        slope = max(math.sqrt(px * px + py * py), LEAST_SLOPE)
        x, y = px / slope, py / slope  # across the contour; along it: -y, x
        for j in range(n - 1):
            if contour[j] != contour[j + 1] or contour[j] == contour[i] or not (there[j] and there[j + 1]):
                continue
            dx, dy = pixels[j, 0] - pixels[i, 0], pixels[j, 1] - pixels[i, 1]
            cx, cy = pixels[j + 1, 0] - pixels[j, 0], pixels[j + 1, 1] - pixels[j, 1]
            along = x * cy - y * cx
            if along * along <= ALIKE * ALIKE * (cx * cx + cy * cy):
                continue
            share = (y * dx - x * dy) / along
            across = x * (dx + share * cx) + y * (dy + share * cy)
            if -BEYOND <= share <= 1 + BEYOND and abs(across) < COMPANY:
                out[i] = True
                break
    return out
