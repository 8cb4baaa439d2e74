"""Sums over neighbours along contours."""

import numpy as np

from extremal.estimator.camera import Array


def window_sum(values: Array, group: np.ndarray, half: int) -> tuple[Array, Array]:
    """Sum (n, ...) of values (n, ...) from `half` before to `half` after each within its group, and how many (n,).

    Groups (n,) are runs of equal numbers, such as the contour on which each edgel lies, in order.
    """
    n = len(values)
    index = np.arange(n)
    new = np.flatnonzero(np.diff(group, prepend=group[:1] - 1)) if n else index
    run = np.repeat(np.arange(len(new)), np.diff(new, append=n))
    first = np.maximum(index - half, new[run])
    last = np.minimum(index + half + 1, np.append(new, n)[1:][run])
    total = np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, axis=0, dtype=float)])
    return total[last] - total[first], (last - first).astype(float)
