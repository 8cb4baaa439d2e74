"""Scores by hand, intervals by coverage."""

import numpy as np
import pytest

from extremal.estimator.errors import InvalidInput
from extremal.scenes import Sphere
from extremal.tasks.metrics import (
    bootstrap_interval,
    normalised_score,
    path_ratio,
    regret,
    smallest_clearance,
    spl,
    travelled_length,
    violation_mm,
    wilson_interval,
)


def test_scores_by_hand() -> None:
    np.testing.assert_allclose(spl([True, True, False], [2.0, 0.9, 1.0], [1.0, 1.0, 1.0]), [0.5, 1.0, 0.0])
    np.testing.assert_allclose(path_ratio([1.2, 0.9], [1.0, 1.0]), [1.2, 0.9])
    np.testing.assert_allclose(regret([1.3, 1.0], [1.1, 1.0], [1.0, 1.0]), [2.0, np.nan])
    np.testing.assert_allclose(normalised_score([0.1, 0.5, 0.9], 0.1, 0.9), [0.0, 0.5, 1.0])
    np.testing.assert_allclose(violation_mm([0.012, 0.03], 0.02), [8.0, 0.0])
    assert travelled_length([[0, 0, 0], [3, 4, 0], [3, 4, 1]]) == 6


def test_smallest_clearance_is_found_between_the_vertices() -> None:
    line = [[-1, 0.08, 0], [1, 0.08, 0]]
    assert smallest_clearance(Sphere(0.05), line, 0.02) == pytest.approx(0.01, abs=1e-6)
    assert smallest_clearance(Sphere(0.05), [[0, 0.06, 0]], 0.02) == pytest.approx(-0.01)


def test_intervals_cover_as_often_as_they_say() -> None:
    rng = np.random.default_rng(21)
    trials, n = 300, 60
    held = {"bootstrap": 0, "wilson": 0}
    for _ in range(trials):
        low, high = bootstrap_interval(rng.exponential(size=n), rng, resamples=500)
        held["bootstrap"] += low <= 1 <= high
        low, high = wilson_interval(int(rng.binomial(n, 0.9)), n)
        held["wilson"] += low <= 0.9 <= high
    # Nominal 95 %; percentile intervals of skewed means cover about 93 % at n = 60. Four standard errors.
    assert held["bootstrap"] / trials > 0.93 - 4 * np.sqrt(0.93 * 0.07 / trials)
    assert held["wilson"] / trials > 0.95 - 4 * np.sqrt(0.95 * 0.05 / trials)


def test_wilson_by_the_published_formula_and_at_the_ends() -> None:
    z, n, p = 1.959963984540054, 300, 290 / 300
    centre = (p + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * np.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    np.testing.assert_allclose(wilson_interval(290, 300), [centre - half, centre + half], rtol=1e-9)
    assert wilson_interval(0, 10)[0] == 0
    assert wilson_interval(10, 10)[1] == 1


def test_the_same_seed_gives_the_same_interval() -> None:
    values = np.arange(20.0)
    first, second = (bootstrap_interval(values, np.random.default_rng(3)) for _ in range(2))
    assert first == second


def test_what_is_refused() -> None:
    with pytest.raises(InvalidInput, match="shortest"):
        spl([True], [1.0], [0.0])
    with pytest.raises(InvalidInput, match="different"):
        normalised_score(0.5, 0.3, 0.3)
    with pytest.raises(InvalidInput, match="successes"):
        wilson_interval(3, 2)
    with pytest.raises(InvalidInput, match="values"):
        bootstrap_interval([np.nan], np.random.default_rng(0))
    with pytest.raises(InvalidInput, match="confidence"):
        wilson_interval(1, 2, confidence=1.0)
    with pytest.raises(InvalidInput, match="points"):
        smallest_clearance(Sphere(0.05), np.zeros((0, 3)), 0.02)
