"""The smallest clearance of a moving sphere, against exact distances of all points of its way."""

from itertools import pairwise

import numpy as np
import pytest

from extremal.scenes import Scene
from extremal.tasks.clearance import Clearance, between
from extremal.tasks.navigate_setup import NavigateSetup
from extremal.tasks.tiers import TRAIN_SEEDS, get_tier

RADIUS = 0.02


def way(scene: Scene, rng: np.random.Generator) -> np.ndarray:
    """Points (n, 3) of straight steps about the scene, outside its objects."""
    turns = scene.target + rng.uniform(-0.4, 0.4, (30, 3)) + [0.0, 0.0, 0.2]
    points = np.concatenate([between(a, b) for a, b in pairwise(turns)])
    return points[np.min([s.signed_distance(points) for s in scene.objects], axis=0) > 1e-3]


@pytest.mark.parametrize("seed", TRAIN_SEEDS[:6])
def test_the_smallest_distance_is_that_of_all_points(seed: int) -> None:
    scene = NavigateSetup.draw(seed, get_tier("standard-v0")).scene
    points = way(scene, np.random.default_rng(seed))
    expected = min(float(np.min(s.signed_distance(points))) for s in scene.objects) - RADIUS
    near = Clearance(scene, RADIUS)
    for part in np.array_split(points, 40):
        near.take_in(part)
    assert near.smallest == pytest.approx(expected, abs=1e-7)
