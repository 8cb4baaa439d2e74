"""What is added to the sigma of looks at a section: errors of edges that repeat, and what a circle leaves of the section."""

import math

import numpy as np

from extremal.estimator.camera import Array
from extremal.tasks.compiled import compiled

SHARE, WITHIN = 0.8, 1.28  # of normal errors, and standard deviations within which they lie
LEAST_LOOKS = 8  # of a section that tell how well a circle fits
MARGIN = 2.5  # times 1 / sqrt(looks): share by which few errors of edges seem to be larger than they are
PIECES = 4.0  # of an arc, within each of which what a circle leaves of it is much the same


@compiled
def repeated(systematic: float, turn: float, first: Array, last: Array, off: Array, sigma: Array) -> Array:
    """Standard deviation (n,) [rad] that is added in quadrature to that of every look.

    Errors that repeat are averaged by as many looks as are independent, not more. The misfit of the circle is what the misses
    are larger than the edges' sigma, judged by most of them: a few false edges do not count.

    Args:
        systematic: [rad] of errors that repeat until the direction has turned by `turn` [rad].
        first, last: (n,) [rad] of the arcs. off: (V, n) [rad] misses of the looks. sigma: (V, n) [rad], infinite where unseen.
    """
    looks, n = off.shape
    out, kept = np.empty(n), np.empty(looks)
    for i in range(n):
        count, edges = 0, 0.0
        for v in range(looks):
            if not math.isinf(sigma[v, i]):
                kept[count] = abs(off[v, i])
                edges += sigma[v, i] * sigma[v, i]
                count += 1
        arc = max(last[i] - first[i], 0.0)
        square = systematic * systematic * max(count / (1 + arc / turn), 1.0)
        if count >= LEAST_LOOKS:
            kept[:count].sort()
            wide = kept[int(SHARE * (count - 1))] / WITHIN
            edges *= (1 + MARGIN / math.sqrt(count)) / count
            square += max(wide * wide - edges, 0.0) * max(count / PIECES, 1.0)
        out[i] = math.sqrt(square)
    return out
