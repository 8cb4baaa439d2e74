"""Sums over neighbours along contours."""

import numpy as np

from extremal.estimator.camera import Array


def window_sum(values: Array, group: np.ndarray, half: int) -> tuple[Array, Array]:
    """Sum (n, ...) of values (n, ...) from `half` before to `half` after each within its group, and how many (n,).

    Groups (n,) are runs of equal numbers, such as the contour on which each edgel lies, in order.
    """
    first, last = windows(group, half)
    return sum_between(values, first, last), (last - first).astype(float)


def windows(group: np.ndarray, half: int) -> tuple[np.ndarray, np.ndarray]:
    """First (n,) of the rows from `half` before to `half` after each within its group (n,), and the row after the last."""
    n = len(group)
    index = np.arange(n)
    starts = np.concatenate([np.flatnonzero(group[1:] != group[:-1]) + 1, [n]])
    run = np.searchsorted(starts, index, side="right")
    begin = np.concatenate([[0], starts])
    return np.maximum(index - half, begin[run]), np.minimum(index + half + 1, starts[run])


def sum_between(values: Array, first: np.ndarray, last: np.ndarray) -> Array:
    """Sum (n, ...) of values (m, ...) from the row first (n,) to that before last (n,)."""
    total = np.zeros((len(values) + 1, *values.shape[1:]))
    np.cumsum(values, axis=0, out=total[1:])
    return total[last] - total[first]
