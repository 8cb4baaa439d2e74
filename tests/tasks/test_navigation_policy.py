"""What Navigate's baselines take for the obstacle: limbs, not edges that pass for round here and there, nor what stands elsewhere."""

import gymnasium as gym
import numpy as np
import pytest

from extremal.estimator.camera import Array
from extremal.tasks.policies.navigation import STRIDE, Around, by_itself
from extremal.tasks.spaces import COLUMNS, SLOTS

GOAL = np.array([0.3, 0.0, 0.2])
POSE = np.array([0.0, 0.0, 0.2, -0.5, 0.5, -0.5, 0.5])  # looks along x
EDGE = np.where(np.arange(20) % 6 == 0, 0.05, 0.004)  # radii along an edge, of which some pass for round


def contour(number: int, x: float, radius: Array, sigma: float, visible: bool = True) -> Array:
    """(n, COLUMNS) of the limb of an upright cylinder of 80 mm about (x, 0.09), as it is seen from (0, 0, 0.2); radii (n,) are told."""
    n, away = len(radius), np.hypot(x, 0.09)
    angle = np.arctan2(0.09, x) - np.arcsin(0.08 / away)
    point = np.sqrt(away**2 - 0.08**2) * np.array([np.cos(angle), np.sin(angle)])
    values = {
        "radius": radius,
        "sigma": sigma,
        "sigma_relative": 1.0,
        "x": point[0],
        "y": point[1],
        "z": 0.2 + np.linspace(-0.02, 0.02, n),
        "sigma_position": 0.001,
        "nx": np.sin(angle),
        "ny": -np.cos(angle),
        "extremal": 1.0 * (radius > 1.96 * sigma),
        "visible": 1.0 * visible,
        "contour": number,
        "looks": 9,
        "plane_z": 1.0,
    }
    told = np.zeros((n, len(COLUMNS)))
    for name, value in values.items():
        told[:, COLUMNS.index(name)] = value
    return told


def observed(*contours: Array) -> dict[str, Array]:
    features = np.zeros((SLOTS, len(COLUMNS)), np.float32)
    told = np.concatenate(contours)
    features[: len(told)] = told
    return {"features": features, "pose": POSE, "goal": GOAL}


def limb(number: int = 0, x: float = 0.15, visible: bool = True) -> Array:
    return contour(number, x, np.full(8, 0.08), 0.002, visible)


def around(again: bool = True, once: bool = False) -> Around:
    """At the start of an episode."""
    found = Around(by_itself, again=again, once=once)
    found.reset(gym.Env(), np.random.default_rng(0))
    return found


@pytest.fixture
def policy() -> Around:
    return around()


def test_edges_that_pass_for_round_here_and_there_are_no_obstacle(policy: Around) -> None:
    edge = contour(1, 0.2, EDGE, 0.01)
    assert np.sum(edge[:, COLUMNS.index("extremal")]) > 3
    policy.act(observed(edge))
    assert policy._beliefs == []
    policy.act(observed(limb(), edge))
    assert [belief.radius for belief in policy._beliefs] == [pytest.approx(0.08)]


def test_the_obstacle_goes_on_where_it_was_seen(policy: Around) -> None:
    """Not at what else is round, and far beyond."""
    policy.act(observed(limb()))
    policy.act(observed(limb(visible=False), limb(1, 0.15 + 1.5 * STRIDE)))
    assert len(policy._beliefs) == 1
    policy.act(observed(limb(visible=False), limb(1, 0.15 + 0.5 * STRIDE)))
    assert len(policy._beliefs) == 2


def test_what_is_out_of_sight_is_passed_at_a_greater_distance(policy: Around) -> None:
    seen = policy.act(observed(limb()))
    unseen = policy.act(observed(limb(visible=False)))
    once = around(again=False)
    np.testing.assert_allclose(once.act(observed(limb())), seen)
    np.testing.assert_allclose(once.act(observed(limb(visible=False))), seen)
    assert unseen[1] < seen[1] - 0.01 and unseen[0] > 0


def test_one_glance_is_the_first_contour(policy: Around) -> None:
    once = around(again=False, once=True)
    for which in (once, policy):
        which.act(observed(limb()))
        which.act(observed(limb(visible=False), limb(1, 0.15 + 0.5 * STRIDE)))
    assert len(once._beliefs) == 1 and len(policy._beliefs) == 2
