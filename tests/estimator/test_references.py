"""Bootstrapped references in exactly Gaussian errors: how often they are false, and radii given them against dense algebra."""

from collections.abc import Callable
from dataclasses import fields

import numpy as np
import pytest

from extremal.estimator import InvalidInput
from extremal.estimator.camera import Array
from extremal.estimator.references import FALSE, References, bootstrap

POSES = 0.02  # [m] standard deviation of what uncertain poses add to all radii together
DIFFERENT = 0.1  # of it: in this the features differ
TRIALS = 300
Radii = Callable[[np.random.Generator], Array]


def either_side(least: float, most: float, count: int) -> Radii:
    return lambda rng: rng.choice([-1, 1], count) * rng.uniform(least, most, count)


class Errors:
    """n radii with own errors of about `own` [m] and the shared ones of six camera unknowns."""

    def __init__(self, truth: Array, own: Array | float, rng: np.random.Generator) -> None:
        n = len(truth)
        self.truth = truth
        self.shared = POSES * (np.eye(6)[0] + DIFFERENT * rng.normal(size=(n, 6)))
        self.own = own * np.exp(0.3 * rng.normal(size=n))
        self.radius = truth + self.own * rng.normal(size=n) + self.shared @ rng.normal(size=6)
        self.contour = np.arange(n)

    def found(self, prior: Array | float = 0.5, overlap: float = 1.0) -> References:
        return bootstrap(self.radius, self.own**2, self.shared, self.contour, prior, overlap)


def shuffled(fixed: int, radii: Array, own: float, rng: np.random.Generator) -> Errors:
    return Errors(rng.permutation(np.concatenate([np.zeros(fixed), radii])), own, rng)


def from_shading(truth: Array, rng: np.random.Generator) -> Array:
    """What shading says of a feature, right in nine cases of ten; the numbers are those of `estimates`."""
    shaded = np.where(truth != 0, 0.9, 0.1) > rng.random(len(truth))
    return np.where(shaded, 0.1, 0.6)


def mixture(seed: int) -> Errors:
    rng = np.random.default_rng(seed)
    return shuffled(25, either_side(0.02, 0.06, 20)(rng), 5e-4, rng)


# Which are found.


def test_fixed_features_are_found_among_extremal_ones() -> None:
    errors = mixture(11)
    found = errors.found()
    assert np.abs(np.median(errors.radius[errors.truth == 0])) > POSES  # not by their radii as they are
    np.testing.assert_array_equal(found.fixed, errors.truth == 0)
    np.testing.assert_array_equal(found.probability > 0.5, found.fixed)
    z = (found.radius - errors.truth) / found.sigma_radius
    assert np.abs(z).max() < 4 and found.sigma_radius.max() < 0.1 * POSES


@pytest.mark.parametrize(
    ("fixed", "radii", "own", "power"),
    [
        pytest.param(40, either_side(0.02, 0.06, 20), 5e-4, 0.98, id="many fixed"),
        pytest.param(12, either_side(0.02, 0.06, 40), 5e-4, 0.9, id="few fixed"),
        pytest.param(5, either_side(0.02, 0.06, 40), 5e-4, 0.2, id="very few fixed"),
        pytest.param(20, lambda rng: rng.uniform(0.02, 0.06, 20), 1e-3, 0.9, id="one side"),
        pytest.param(30, either_side(0.005, 0.01, 20), 1e-3, 0.2, id="small radii"),
        pytest.param(20, either_side(0.001, 0.01, 40), 1e-3, 0.1, id="radii within noise"),
        pytest.param(20, lambda rng: 0.08 * rng.standard_cauchy(20), 1e-3, 0.8, id="any radii"),
        pytest.param(30, lambda _: np.repeat([0.04, -0.03], 15), 1e-3, 0.9, id="two clusters"),
    ],
)
def test_few_references_are_false(fixed: int, radii: Radii, own: float, power: float) -> None:
    rng = np.random.default_rng(1)
    shares, hits, nees = [], [], []
    for _ in range(TRIALS):
        errors = shuffled(fixed, radii(rng), own, rng)
        found = errors.found(from_shading(errors.truth, rng))
        false = np.sum(found.fixed & (errors.truth != 0))
        shares.append(false / max(found.fixed.sum(), 1))
        hits.append(np.sum(found.fixed & (errors.truth == 0)) / fixed)
        nees.append(np.mean(((found.radius - errors.truth) / found.sigma_radius) ** 2))
    assert np.mean(shares) <= FALSE + 3 * np.std(shares) / np.sqrt(TRIALS)
    assert np.mean(hits) > power
    assert np.median(nees) < 1.15  # of 45 to 60 features: a median over trials has no tail


def test_a_reference_that_is_none_is_not_kept_for_the_sake_of_its_many_fellows() -> None:
    """One false reference in forty is a small share, but R = 20 to 60 mm held at zero bends all others."""
    rng = np.random.default_rng(2)
    nees = []
    for _ in range(100):
        errors = shuffled(40, either_side(0.02, 0.06, 20)(rng), 5e-4, rng)
        found = errors.found()
        assert not np.any(found.fixed & (found.probability < 0.5))
        nees.append(np.mean(((found.radius - errors.truth) / found.sigma_radius) ** 2))
    assert 0.85 < np.median(nees) < 1.15


@pytest.mark.parametrize(
    ("radii", "shaded", "most"),
    [  # measured over 1500 trials: 12 %, 21 %, 37 %; 6 %, 5 %, 26 %
        pytest.param(either_side(0.02, 0.06, 40), False, 0.2, id="either side"),
        pytest.param(lambda rng: rng.uniform(0.02, 0.06, 100), False, 0.3, id="one side"),
        pytest.param(lambda _: np.full(20, 0.04), False, 0.5, id="all alike"),
        pytest.param(either_side(0.02, 0.06, 40), True, 0.1, id="either side, shaded"),
        pytest.param(lambda rng: rng.uniform(0.02, 0.06, 15), True, 0.1, id="one side, shaded"),
        pytest.param(lambda _: np.full(20, 0.04), True, 0.35, id="all alike, shaded"),
    ],
)
def test_without_any_fixed_feature_sigma_stays_that_of_uncertain_poses(
    radii: Radii, shaded: bool, most: float
) -> None:
    """But for chance: radii that are alike explain themselves as a fixed feature's would, and then all are false."""
    rng, false = np.random.default_rng(3), 0
    for _ in range(TRIALS):
        errors = Errors(radii(rng), 1e-3, rng)
        found = errors.found(from_shading(errors.truth, rng) if shaded else 0.5)
        if found.fixed.any():
            false += 1
            continue
        np.testing.assert_array_equal(found.radius, errors.radius)
        absolute = np.sqrt(errors.own**2 + np.sum(errors.shared**2, axis=1))
        np.testing.assert_allclose(found.sigma_radius, absolute)
    assert false / TRIALS < most


def test_a_rival_as_good_leaves_the_question_open() -> None:
    """Two clusters alike but for 40 mm: which of them is fixed is for what poses make likely to say, or for nobody."""
    rng, right = np.random.default_rng(4), 0
    for _ in range(TRIALS):
        errors = shuffled(20, np.full(20, 0.04), 1e-3, rng)
        found = errors.found()
        assert not np.any(found.fixed & (errors.truth != 0))
        right += found.fixed.any()
    assert 0.5 < right / TRIALS < 0.9


# Radii given the references.


def conditioned(errors: Errors, fixed: np.ndarray, overlap: float) -> tuple[Array, Array]:
    """Mean and sigma (n,) of all radii given that those of `fixed` are zero, of these given the others: dense Gaussians."""
    common = errors.shared @ errors.shared.T
    of_references = common + overlap * np.diag(errors.own**2)
    mean, sigma = np.empty(len(fixed)), np.empty(len(fixed))
    for i in range(len(fixed)):
        given = np.flatnonzero(fixed & (np.arange(len(fixed)) != i))
        gain = np.linalg.solve(of_references[np.ix_(given, given)], common[given, i])
        mean[i] = errors.radius[i] - gain @ errors.radius[given]
        sigma[i] = np.sqrt(errors.own[i] ** 2 + common[i, i] - gain @ common[given, i])
    return mean, sigma


@pytest.mark.parametrize("overlap", [1.0, 3.0])
def test_radii_against_dense_conditioning(overlap: float) -> None:
    rng = np.random.default_rng(5)
    errors = Errors(np.repeat([0.0, 0.04, 0.0, 0.0, -0.03, 0.05], 15), 5e-4, rng)
    errors.contour = np.arange(90) // 15
    found = errors.found(overlap=overlap)
    assert 10 < found.fixed.sum() < len(found.fixed)
    mean, sigma = conditioned(errors, found.fixed, overlap)
    np.testing.assert_allclose(found.radius, mean, atol=1e-9)
    np.testing.assert_allclose(found.sigma_radius, sigma, rtol=1e-7)


def test_references_that_repeat_each_other_count_once() -> None:
    """Three neighbours share each error of theirs: with that overlap, sigma is right, without it too small."""
    rng, trials = np.random.default_rng(6), 200
    thrice = np.repeat(np.arange(40), np.repeat([3, 1], [30, 10]))
    contour = np.where(thrice < 30, thrice // 6, thrice)
    nees: dict[float, list[float]] = {1.0: [], 3.0: []}
    for _ in range(trials):
        errors = Errors(np.repeat([0.0, 0.04, -0.03], [30, 5, 5]), np.repeat([1e-3, 1e-4], [30, 10]), rng)
        for overlap, values in nees.items():
            own, shared = errors.own[thrice] ** 2, errors.shared[thrice]
            found = bootstrap(errors.radius[thrice], own, shared, contour, overlap=overlap)
            assert not found.fixed[-10:].any()
            if found.fixed.sum() > 80:
                z = (found.radius[-10:] - errors.truth[-10:]) / found.sigma_radius[-10:]
                values.append(float(np.mean(z**2)))
    assert min(len(v) for v in nees.values()) > 0.8 * trials
    assert np.mean(nees[3.0]) == pytest.approx(1, abs=5 * np.std(nees[3.0]) / np.sqrt(trials))
    assert np.mean(nees[1.0]) > 1.5


# What goes in.


def test_features_of_infinite_variance_are_left_out() -> None:
    errors = mixture(7)
    unknown = np.arange(len(errors.truth)) % 5 == 0
    with_all = bootstrap(
        np.where(unknown, 0.0, errors.radius),
        np.where(unknown, np.inf, errors.own**2),
        np.where(unknown[:, None], 1e3, errors.shared),
        errors.contour,
    )
    known = ~unknown
    alone = bootstrap(
        errors.radius[known], errors.own[known] ** 2, errors.shared[known], errors.contour[known]
    )
    assert alone.fixed.any()
    for name in (f.name for f in fields(References)):
        np.testing.assert_array_equal(getattr(with_all, name)[known], getattr(alone, name), name)
    assert not with_all.fixed[unknown].any() and np.all(with_all.probability[unknown] == 0)
    assert np.all(with_all.sigma_radius[unknown] == np.inf)


@pytest.mark.parametrize("count", [0, 4])
def test_nothing_known(count: int) -> None:
    found = bootstrap(np.zeros(count), np.full(count, np.inf), np.zeros((count, 6)), np.arange(count))
    assert len(found.fixed) == count and not found.fixed.any()
    assert np.all(found.sigma_radius == np.inf) and np.all(np.isfinite(found.radius))


def test_exact_poses_share_nothing() -> None:
    """Radii are then what they are, and zero ones fixed."""
    truth = np.repeat([0.0, 0.04], 10)
    radius = truth + 1e-3 * np.random.default_rng(8).normal(size=20)
    found = bootstrap(radius, np.full(20, 1e-6), np.zeros((20, 0)), np.arange(20))
    np.testing.assert_array_equal(found.fixed, truth == 0)
    np.testing.assert_array_equal(found.radius, radius)
    np.testing.assert_allclose(found.sigma_radius, 1e-3)


@pytest.mark.parametrize("wrong", range(3))
def test_shapes_that_do_not_fit_are_refused(wrong: int) -> None:
    given = [np.zeros(4), np.ones(4), np.zeros((4, 6)), np.arange(4)]
    given[wrong + 1] = given[wrong + 1][:3]
    with pytest.raises(InvalidInput, match=r"do not fit; accepted: \(n,\), \(n,\), \(n, any\), \(n,\)"):
        bootstrap(*given)


def test_the_same_radii_give_the_same_references() -> None:
    for name in (f.name for f in fields(References)):
        np.testing.assert_array_equal(getattr(mixture(9).found(), name), getattr(mixture(9).found(), name))
