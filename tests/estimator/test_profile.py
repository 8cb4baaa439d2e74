"""Edge localisation in profiles against exact models, the Cramer-Rao bound and Monte Carlo."""

import numpy as np
import pytest
from scipy.integrate import quad

from extremal.estimator.camera import Array
from extremal.estimator.profile import PIXEL_VARIANCE, blurred_power, fit_profiles, offsets

BLUR, NOISE, ROWS = 0.7, 2.0, 5
SPREAD = float(np.sqrt(BLUR**2 + PIXEL_VARIANCE))


def profiles(edge: Array, coefficients: tuple[float, ...], side: int, rng: np.random.Generator) -> Array:
    """Level 100 and step, square root, slope inside, at an edge (n,), with the noise of a mean of ROWS lines."""
    s = side * (offsets() - edge[:, None])
    exact = 100 + np.sum([c * blurred_power(s, k, SPREAD) for k, c in enumerate(coefficients)], axis=0)
    return exact + rng.normal(size=exact.shape) * NOISE / np.sqrt(ROWS)


def bound(step: float) -> float:
    """Cramer-Rao bound [px] for a blurred step between two unknown levels."""
    s = offsets()
    slope = step * np.exp(-0.5 * (s / SPREAD) ** 2) / (np.sqrt(2 * np.pi) * SPREAD)
    levels = np.stack([np.ones_like(s), blurred_power(s, 0, SPREAD)], axis=1)
    left = slope - levels @ np.linalg.lstsq(levels, slope, rcond=None)[0]
    return NOISE / np.sqrt(ROWS) / np.linalg.norm(left)


@pytest.mark.parametrize("power", [0, 1, 2, 3])
@pytest.mark.parametrize("at", [-3.0, -0.4, 0.0, 0.7, 5.0])
def test_blurred_powers_against_quadrature(power: int, at: float) -> None:
    def integrand(t: float) -> float:
        kernel = np.exp(-0.5 * ((at - t) / SPREAD) ** 2) / (np.sqrt(2 * np.pi) * SPREAD)
        return kernel * t ** (power / 2)

    exact = quad(integrand, 0, at + 10, points=[max(at, 0.01)], epsabs=1e-12)[0]
    assert float(blurred_power(np.array([at]), power, SPREAD)[0]) == pytest.approx(exact, abs=1e-7)


@pytest.mark.parametrize("step", [100.0, -60.0, 30.0])
def test_step_edges_are_unbiased_at_the_bound(step: float) -> None:
    rng = np.random.default_rng(1)
    edge = rng.uniform(-0.8, 0.8, 4000)
    fit = fit_profiles(profiles(edge, (step,), 1, rng), NOISE, ROWS, BLUR, np.zeros(len(edge), int))
    error = fit.offset - edge
    assert abs(error.mean()) < 0.003
    assert error.std() < 1.15 * bound(step)
    assert np.mean(np.abs(error) < 1.96 * fit.sigma) == pytest.approx(0.95, abs=0.025)


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("coefficients", [(50, 20, 0), (50, 20, -2), (-60, 15, -1), (80, -20, 1)])
def test_shaded_limbs_are_unbiased(side: int, coefficients: tuple[float, ...]) -> None:
    rng = np.random.default_rng(2)
    edge = rng.uniform(-0.5, 0.5, 4000)
    fit = fit_profiles(profiles(edge, coefficients, side, rng), NOISE, ROWS, BLUR, np.zeros(len(edge), int))
    error = fit.offset - edge
    assert abs(np.median(error)) < 0.02
    assert np.mean(np.abs(error) < 1.96 * fit.sigma) == pytest.approx(0.95, abs=0.045)
    assert np.mean(fit.limb) * side > 0.9


def test_sigma_grows_where_the_limb_has_no_contrast() -> None:
    rng = np.random.default_rng(3)
    edge = rng.uniform(-0.3, 0.3, 2000)
    fit = fit_profiles(profiles(edge, (0, 20, 0), 1, rng), NOISE, ROWS, BLUR, np.zeros(len(edge), int))
    known = np.isfinite(fit.sigma)
    assert np.median(fit.sigma) > 0.1
    covered = np.abs(fit.offset - edge)[known] < 1.96 * fit.sigma[known]
    assert 0.88 < covered.mean() <= 1.0
