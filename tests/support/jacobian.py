"""One finite-difference check for every analytic Jacobian."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike


def numeric_jacobian(
    function: Callable[[np.ndarray], ArrayLike], at: ArrayLike, step: ArrayLike = 1e-4
) -> np.ndarray:
    """Derivatives (..., n) of a function of (n,) with values (...), by the five-point central difference.

    `step` is a scalar or (n,), in the parameters' units; the error is of order step^4.
    """
    x = np.asarray(at, float)
    columns = []
    for i, h in enumerate(np.broadcast_to(np.asarray(step, float), x.shape)):
        e = np.zeros_like(x)
        e[i] = h

        def difference(k: int, e: np.ndarray = e) -> np.ndarray:
            return np.asarray(function(x + k * e), float) - np.asarray(function(x - k * e), float)

        columns.append((8 * difference(1) - difference(2)) / (12 * h))
    return np.stack(columns, axis=-1)


def assert_jacobian(
    function: Callable[[np.ndarray], ArrayLike],
    analytic: ArrayLike | Callable[[np.ndarray], ArrayLike],
    at: ArrayLike,
    rtol: float = 1e-7,
    step: ArrayLike = 1e-4,
) -> None:
    """Compare an analytic Jacobian (..., n), given as values or as a function of `at` (n,), with finite differences.

    `rtol` is relative to the largest derivative by the same parameter, so that units may differ between parameters.
    """
    x = np.asarray(at, float)
    expected = numeric_jacobian(function, x, step)
    actual = np.asarray(analytic(x) if callable(analytic) else analytic, float)
    assert actual.shape == expected.shape, f"the Jacobian is {actual.shape}; accepted: {expected.shape}"
    largest = np.abs(expected).reshape(-1, x.size).max(axis=0)
    bound = rtol * np.where(largest > 0, largest, 1.0)
    error = np.abs(actual - expected)
    assert np.all(error <= bound), (
        f"worst relative error {np.max(error / bound) * rtol:.2e}, accepted: {rtol:.1e}\n{actual}\nagainst\n{expected}"
    )
