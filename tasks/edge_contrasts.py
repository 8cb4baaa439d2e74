"""Which edges look other than they did: an edge that is no limb keeps its contrast, where one that is taken for it has its own.

Edges that come near to each other are one edge in the image for a while; and which of them it becomes, geometry alone can't tell as
long as a pose may be off by as much. Behind a limb the background changes, so that its contrast says nothing.
"""

import numpy as np
from numpy.typing import NDArray

from extremal.estimator.camera import Array

ALIKE = 0.1  # share of a contrast by which it may differ
FORGETTING = 0.2  # share of what is known of a contrast that a look replaces: light changes slowly


class EdgeContrasts:
    """What is known of the contrasts of n edges."""

    def __init__(self, n: int) -> None:
        self._usual = np.full(n, np.nan)

    def changed(self, contrast: Array, fixed: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Take in contrasts (n,) [grey levels] of a look, NaN where an edge was not seen, and say which (n,) are others than those
        of the edges so far, where these are believed to be `fixed` (n,)."""
        usual = np.where(np.isnan(self._usual), contrast, self._usual)
        with np.errstate(invalid="ignore"):
            changed = (np.abs(contrast - usual) > ALIKE * np.abs(usual)) & fixed
        taken_in = np.isfinite(contrast) & ~changed
        self._usual = np.where(taken_in, usual + FORGETTING * (contrast - usual), usual)
        return changed
