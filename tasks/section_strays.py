"""Which matches of a look are of other contours, by what is known of the sections.

A plane misses its section by r = X dtheta + O z + noise, in standard deviations: dtheta ~ N(0, P) is what is not known of
the sections, z ~ N(0, I) the error of the pose, common to all. So r ~ N(0, inv(G)), inv(G) = X P X' + O O' + D: the pose may be
many pixels off, and yet a track that has gone over to another contour is told from a fraction of one. If matches are off by U a,
with any a, r'G r falls by (U'G r)' inv(U'G U) (U'G r), chi^2 of as many degrees of freedom as U has columns. U is one match; or,
as neighbours on a contour go over together and would speak for each other, a contour that is shifted and turned.
"""

import numpy as np
from numpy.typing import NDArray

from extremal.estimator.camera import Array

# chi^2 from which a match is left out, of one degree of freedom, and a contour, of two
ALONE, TOGETHER = 14.0, 16.0
MOST = 0.5  # of the matches are left out


def strays(
    X: Array,
    O: Array,
    r: Array,
    covariance: Array,
    variance: Array,
    common: Array,
    contour: NDArray[np.integer],
) -> NDArray[np.bool_]:
    """Which (m,) of m matches are left out, worst first, until the others agree.

    Args:
        X: (m, 3), O: (m, K), r: (m,) as of `section_rows.missed`. covariance: (m, 3, m, 3) of the sections' theta.
        variance: (m,) of the noise. common: (m,) standard deviation of errors that are common to a contour; contour: (m,).
    """
    alike = contour[:, None] == contour
    spread = np.einsum("ijb,jb->ij", np.einsum("ia,iajb->ijb", X, covariance), X)
    B = spread + O @ O.T
    G = np.linalg.inv(B + np.diag(variance) + common[:, None] * common * alike)
    left = np.arange(len(r))
    while len(left) > (1 - MOST) * len(r):
        out = _worst(G, G @ r[left], contour[left])
        if len(out) == 0:
            break
        stay = np.setdiff1d(np.arange(len(left)), out)
        told = np.linalg.solve(G[np.ix_(out, out)], G[np.ix_(out, stay)])
        G = G[np.ix_(stay, stay)] - G[np.ix_(stay, out)] @ told
        left = left[stay]
    strayed = np.ones(len(r), bool)
    strayed[left] = False
    return strayed


def _worst(G: Array, told: Array, contour: NDArray[np.integer]) -> NDArray[np.integer]:
    """The set without which the others, of G (m, m) and G r (m,), agree best; empty where all do."""
    single = told**2 / np.diagonal(G) - ALONE
    worst = int(np.argmax(single))
    out, most = np.array([worst]), single[worst]
    for number in np.unique(contour):
        rows = np.flatnonzero(contour == number)
        if len(rows) > 1:
            U = np.stack([np.ones(len(rows)), np.linspace(-1.0, 1.0, len(rows))], axis=1)
            along = U.T @ told[rows]
            gain = along @ np.linalg.solve(U.T @ G[np.ix_(rows, rows)] @ U, along) - TOGETHER
            if gain > most:
                out, most = rows, gain
    return out if most > 0 else np.zeros(0, int)
