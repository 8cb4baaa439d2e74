"""How fast the joint adjustment is: numbers for the record, none of them passes or fails a test."""

import time

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from extremal.estimator.adjustment import Adjustment, adjust
from extremal.scripts.spatial_study import pose_errors, random_scene
from extremal.scripts.synthetic import Observation, observe

VIEWS, POINTS = 60, 50
CONTOURS = 2000
SIZES = (500, 1000, 2000, 4000, 8000, 16_000)
EDGE = 0.1 / 800  # [rad]


def observation(contours: int) -> Observation:
    """Spheres and straight lines by halves and fixed points, with pose errors of 1 mm and 1 mrad."""
    rng = np.random.default_rng(contours)
    scene = random_scene(VIEWS, contours, POINTS, rng)
    return observe(scene, pose_errors(scene, common=False), EDGE, rng)


def check(found: Adjustment, contours: int) -> None:
    assert found.converged
    assert found.shapes[0].valid.sum() > 0.95 * contours and found.shapes[1].valid.all()


def test_two_thousand_contour_points(benchmark: BenchmarkFixture) -> None:
    """To be at most 2 s on two idle cores."""
    seen = observation(CONTOURS)
    found = benchmark.pedantic(adjust, (seen.prior, seen.features), rounds=3, warmup_rounds=1)
    benchmark.extra_info["steps"] = found.steps
    check(found, CONTOURS)


@pytest.mark.slow
def test_growth_with_the_number_of_contour_points(benchmark: BenchmarkFixture) -> None:
    """Processor seconds, and those of a point relative to the same among 500: 1 is linear growth, less is slower."""
    seconds, steps = {}, {}
    for contours in SIZES:
        seen = observation(contours)
        started = time.process_time()
        found = adjust(seen.prior, seen.features)
        seconds[contours] = time.process_time() - started
        steps[contours] = found.steps
        check(found, contours)
    each = {n: t / n for n, t in seconds.items()}
    benchmark.extra_info["seconds"] = seconds
    benchmark.extra_info["steps"] = steps
    benchmark.extra_info["seconds_a_point_over_that_of_500"] = {n: each[n] / each[SIZES[0]] for n in SIZES}
    seen = observation(SIZES[0])
    benchmark.pedantic(adjust, (seen.prior, seen.features), rounds=1)
