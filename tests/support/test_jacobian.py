"""The shared check of Jacobians finds what it should."""

import numpy as np
import pytest
from jacobian import assert_jacobian


def polar(x: np.ndarray) -> np.ndarray:
    return x[0] * np.array([np.cos(x[1]), np.sin(x[1])])


def analytic(x: np.ndarray) -> np.ndarray:
    c, s = np.cos(x[1]), np.sin(x[1])
    return np.array([[c, -x[0] * s], [s, x[0] * c]])


def test_accepts_the_right_one() -> None:
    assert_jacobian(polar, analytic, [800.0, 0.3], rtol=1e-9, step=[1e-1, 1e-3])
    assert_jacobian(polar, analytic(np.array([2.0, 0.3])), [2.0, 0.3])


@pytest.mark.parametrize("column", [0, 1])
def test_finds_a_small_error_in_either_column(column: int) -> None:
    wrong = analytic(np.array([800.0, 0.3]))
    wrong[:, column] *= 1 + 1e-5
    with pytest.raises(AssertionError, match="worst relative error"):
        assert_jacobian(polar, wrong, [800.0, 0.3], step=[1e-1, 1e-3])


def test_wants_the_shape() -> None:
    with pytest.raises(AssertionError, match="accepted"):
        assert_jacobian(polar, np.eye(3), [1.0, 2.0])
