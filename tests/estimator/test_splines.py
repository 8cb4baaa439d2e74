"""Splines through contours against exact curves and Monte Carlo."""

import numpy as np
import pytest

from extremal.estimator.camera import Array
from extremal.estimator.splines import Splines, arc_length, fit, knots

SPACING = 8.0  # [px] between knots
WIDEST = 7.5  # [px] that a gap counts for


def through(chains: list[Array], weights: Array | None = None) -> tuple[Splines, Array, np.ndarray, Array]:
    """Splines through ordered points (n, 2) of each chain; their parameters, contours and variance there."""
    positions = np.concatenate(chains)
    contour = np.repeat(np.arange(len(chains)), [len(c) for c in chains])
    u, breaks = arc_length(positions, contour)
    most = np.maximum(np.bincount(contour) - 3, 1)
    t = knots(u, contour, breaks, np.full(len(u), SPACING), most, WIDEST)
    weights = np.ones(len(u)) if weights is None else weights
    found = fit(u, positions, weights, t, breaks)
    return found.splines, u, contour, found.variance()


def circle(radius: float, turn: float = 5.0, step: float = 2.0) -> Array:
    angle = np.arange(0.0, turn, step / radius)
    return np.array([300.0, 200.0]) + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def line(length: float, angle: float = 0.4, step: float = 2.0) -> Array:
    along = np.arange(0.0, length, step)
    return np.array([50.0, 70.0]) + along[:, None] * np.array([np.cos(angle), np.sin(angle)])


@pytest.mark.parametrize("radius", [30.0, 100.0, 400.0])
@pytest.mark.parametrize("reverse", [False, True])
def test_circles(radius: float, reverse: bool) -> None:
    points = circle(radius)[:: -1 if reverse else 1]
    splines, u, *_ = through([points])
    inner = np.linspace(u[0], u[-1], 999)
    position, tangent, normal, curvature = splines.frame(inner)
    outward = (position - [300.0, 200.0]) / radius
    assert np.abs(np.linalg.norm(outward, axis=1) - 1).max() * radius < 2e-3
    np.testing.assert_allclose(np.linalg.norm(tangent, axis=1), 1, atol=1e-12)
    # the left of the increasing angle, with y down, is the outside
    np.testing.assert_allclose(normal, -outward if reverse else outward, atol=2e-3)
    middle = (inner > u[0] + SPACING) & (inner < u[-1] - SPACING)
    np.testing.assert_allclose(curvature[middle], (1 if reverse else -1) / radius, rtol=0.03)


def test_a_fit_again_is_a_fit() -> None:
    chains, rng = [circle(60.0), line(120.0)], np.random.default_rng(2)
    positions, contour = np.concatenate(chains), np.repeat([0, 1], [len(c) for c in chains])
    u, breaks = arc_length(positions, contour)
    t = knots(u, contour, breaks, np.full(len(u), SPACING), np.bincount(contour) - 3, WIDEST)
    weights, noisy = rng.uniform(1, 20, len(u)), positions + 0.1 * rng.standard_normal(positions.shape)
    again = fit(u, positions, np.ones(len(u)), t, breaks).again(noisy, weights)
    anew = fit(u, noisy, weights, t, breaks)
    np.testing.assert_array_equal(again.splines.curve(u), anew.splines.curve(u))
    np.testing.assert_array_equal(again.variance(), anew.variance())


@pytest.mark.parametrize("angle", [0.0, 0.4, np.pi / 2, 3.0])
def test_lines(angle: float) -> None:
    points = line(150.0, angle)
    splines, u, *_ = through([points])
    position, tangent, normal, curvature = splines.frame(u)
    np.testing.assert_allclose(position, points, atol=1e-6)
    np.testing.assert_allclose(tangent, np.tile([np.cos(angle), np.sin(angle)], (len(u), 1)), atol=1e-6)
    np.testing.assert_allclose(normal, np.tile([np.sin(angle), -np.cos(angle)], (len(u), 1)), atol=1e-6)
    np.testing.assert_allclose(curvature, 0, atol=1e-6)


@pytest.mark.parametrize("points", [line(120.0), circle(60.0, 2.0)], ids=["line", "circle"])
def test_variance_by_monte_carlo(points: Array) -> None:
    rng = np.random.default_rng(1)
    trials = 600
    sigma = rng.uniform(0.01, 0.05, len(points))
    contour = np.zeros(len(points), int)
    u, breaks = arc_length(points, contour)
    t = knots(u, contour, breaks, np.full(len(u), SPACING), np.array([len(u)]), WIDEST)
    found = fit(u, points, 1 / sigma, t, breaks)
    exact, variance = found.splines, found.variance()
    _, _, normal, _ = exact.frame(u)
    error = np.empty((trials, len(u)))
    for k in range(trials):
        noisy = points + (sigma * rng.normal(size=len(u)))[:, None] * normal
        again = fit(u, noisy, 1 / sigma, t, breaks)
        np.testing.assert_array_equal(again.variance(), variance)
        error[k] = np.sum((again.splines.curve(u) - exact.curve(u)) * normal, axis=1)
    ratio = np.mean(error**2, axis=0) / variance
    # standard error of a variance from n samples: sqrt(2 / n); normals turn by little within a basis function's support
    assert np.abs(ratio - 1).max() < 5 * np.sqrt(2 / trials) + 0.05
    assert np.all(variance <= sigma**2 * (1 + 1e-9))
    assert variance.mean() < 0.7 * np.mean(sigma**2)


def test_a_contour_does_not_see_the_others_data() -> None:
    rng = np.random.default_rng(2)
    chains = [line(90.0), circle(50.0, 3.0), line(40.0, 2.0)]
    positions = np.concatenate(chains)
    contour = np.repeat(np.arange(3), [len(c) for c in chains])
    u, breaks = arc_length(positions, contour)
    t = knots(u, contour, breaks, np.full(len(u), SPACING), np.bincount(contour), WIDEST)
    weights = rng.uniform(20, 100, len(u))
    moved = positions + np.where(contour == 1, 30.0, 0.0)[:, None] * rng.normal(size=positions.shape)
    before, after = (fit(u, p, weights, t, breaks).splines.curve(u) for p in (positions, moved))
    others = contour != 1
    np.testing.assert_allclose(after[others], before[others], atol=1e-9)
    assert np.abs(after[~others] - before[~others]).max() > 1


def test_a_contour_is_the_same_alone_and_among_others() -> None:
    points = circle(50.0, 3.0)
    alone, u, _, variance = through([points])
    among, v, contour, all_variance = through([line(77.0), points, line(33.0, 1.0)])
    np.testing.assert_allclose(among.curve(v[contour == 1]), alone.curve(u), atol=1e-4)
    np.testing.assert_allclose(all_variance[contour == 1], variance, rtol=1e-3)
    np.testing.assert_array_equal(among.contour_of(v), contour)
    clamped = among.clamp(v + 1e4, contour)
    np.testing.assert_array_equal(among.contour_of(clamped), contour)


@pytest.mark.parametrize("gap", [10.0, 40.0, 120.0])
def test_gaps_in_the_data_are_bridged(gap: float) -> None:
    points = line(400.0)
    along = 2.0 * np.arange(len(points))
    splines, u, *_, variance = through([points[np.abs(along - 200) > gap / 2]])
    everywhere = np.linspace(u[0], u[-1], 2000)
    position, _, normal, curvature = splines.frame(everywhere)
    off = (position - [50.0, 70.0]) @ [np.sin(0.4), -np.cos(0.4)]
    assert np.abs(off).max() < 1e-3
    assert np.all(np.isfinite(normal)) and np.abs(curvature).max() < 1e-3
    assert np.all(np.isfinite(variance)) and np.all(variance > 0)


def test_a_gap_takes_no_more_knots_than_a_datum() -> None:
    def count(points: Array) -> int:
        contour = np.zeros(len(points), int)
        u, breaks = arc_length(points, contour)
        t = knots(u, contour, breaks, np.full(len(u), SPACING), np.array([len(u)]), WIDEST)
        assert np.all(np.diff(t) >= 0) and t[0] == breaks[0] and t[-1] == breaks[-1]
        return len(t)

    points = line(200.0)
    far = points + np.where(np.arange(len(points)) < 50, 0.0, 500.0)[:, None] * np.array(
        [np.cos(0.4), np.sin(0.4)]
    )
    assert count(points) <= count(far) <= count(points) + 1


def test_contours_of_two_points_stay_finite() -> None:
    rng = np.random.default_rng(3)
    start = rng.uniform(0, 400, (30, 2))
    step = rng.normal(size=(30, 2)) * 4
    chains = [np.array([a, a + s]) for a, s in zip(start, step, strict=True)]
    chains.insert(7, line(60.0))
    splines, u, contour, variance = through(chains)
    assert np.all(np.isfinite(variance)) and np.all(variance >= 0)
    for part in splines.frame(u):
        assert np.all(np.isfinite(part))
    np.testing.assert_allclose(splines.curve(u), np.concatenate(chains), atol=1e-3)
    np.testing.assert_array_equal(splines.contour_of(u), contour)
