"""The compiled search for references against the estimator's."""

import numpy as np
import pytest

from extremal.estimator.references import bootstrap
from extremal.tasks.section_references import MOST, references


@pytest.mark.parametrize("poses", [1e-4, 1e-3, 4e-3])
def test_references_are_those_of_the_estimator(poses: float) -> None:
    """Of fixed and other features on contours of several lengths, some not known, under errors they have in common."""
    rng, some, trials = np.random.default_rng(7), 0, 60
    for _ in range(trials):
        contour = np.repeat(np.arange(8), rng.integers(1, 9, 8))
        n = len(contour)
        true = np.where(rng.random(8) < rng.random(), 0.0, rng.uniform(0.004, 0.1, 8))[contour]
        own = rng.uniform(0.3e-3, 3e-3, n) ** 2
        shared = poses * (rng.normal(size=6) + 0.3 * rng.normal(size=(n, 6)))
        radius = true + shared @ rng.standard_normal(6) + np.sqrt(own) * rng.standard_normal(n)
        own[rng.random(n) < 0.1] = np.inf
        found = references(radius, own, shared, contour)
        np.testing.assert_array_equal(found, bootstrap(radius, own, shared, contour, most=MOST).fixed)
        some += found.any()
    assert trials / 6 < some


def test_more_features_than_are_tried_and_none_at_all() -> None:
    rng, n = np.random.default_rng(1), 130
    contour = np.arange(n) // 5
    own, shared = np.full(n, 1e-6), 1e-3 * rng.normal(size=(n, 3))
    radius = np.where(contour % 3 > 0, 0.03, 0.0) + shared @ rng.standard_normal(3)
    radius += 1e-3 * rng.standard_normal(n)
    found = references(radius, own, shared, contour)
    assert 20 < found.sum() < 60
    np.testing.assert_array_equal(found, bootstrap(radius, own, shared, contour, most=MOST).fixed)
    assert not references(radius, np.full(n, np.inf), shared, contour).any()


def test_a_long_limb_does_not_outvote_short_edges() -> None:
    """Errors of a pose make all radii of a limb, 12 tracks, zero as well as those of 3 edges, of 3 tracks each, somewhere else."""
    rng, right = np.random.default_rng(3), 0
    contour = np.repeat(np.arange(4), [12, 3, 3, 3])
    slope = np.concatenate([np.linspace(1.0, 1.4, 12), np.repeat([-0.8, 0.9, -0.7], 3)])
    own, shared = np.full(len(contour), 1e-6), 0.05 * slope[:, None]
    trials = 40
    for _ in range(trials):
        true = np.where(contour == 0, 0.06 * slope, 0.0)
        found = references(true + 1e-3 * rng.standard_normal(len(contour)), own, shared, contour)
        right += np.array_equal(found, contour > 0)
        assert not found[contour == 0].any()
    assert right > 0.7 * trials
