"""How fast: numbers for the record, none of them passes or fails a test."""

import time

import numpy as np
from pytest_benchmark.fixture import BenchmarkFixture

from extremal.estimator import Camera, estimate_shape, osculating_circle
from extremal.scenes import load_scene
from extremal.sim import LinearMotion, record

CIRCLES = 1_000_000
VIEWS = 9


def test_a_million_circles_of_three_views(benchmark: BenchmarkFixture) -> None:
    rng = np.random.default_rng(0)
    centres = np.array([[-0.05, 0, 0], [0, 0, 0], [0.05, 0, 0]])
    rays = rng.uniform([-0.1, -0.1, 0.4], [0.1, 0.1, 0.6], (CIRCLES, 1, 3)) - centres
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    started = time.perf_counter()
    assert osculating_circle(centres, rays, 1e-4).valid.all()
    benchmark.extra_info["circles_per_second"] = CIRCLES / (time.perf_counter() - started)
    circles = benchmark.pedantic(osculating_circle, (centres, rays, 1e-4), rounds=2)
    assert np.abs(circles.radius).max() < 1e-6


def test_vision_beside_rendering(benchmark: BenchmarkFixture) -> None:
    scene = load_scene("vase-and-box")
    recording = record(
        scene, Camera(), LinearMotion(views=VIEWS), "preview", rng=np.random.default_rng(0), workers=1
    )
    estimate_shape(recording.views)  # imports and caches
    started = time.perf_counter()
    estimate_shape(recording.views)
    seconds = time.perf_counter() - started
    shape = benchmark.pedantic(estimate_shape, (recording.views,), rounds=3)
    benchmark.extra_info["vision_seconds_per_frame"] = seconds / VIEWS
    benchmark.extra_info["render_seconds_per_frame"] = recording.render_seconds / VIEWS
    benchmark.extra_info["vision_over_rendering"] = seconds / recording.render_seconds
    assert len(shape.pixels) > 100
