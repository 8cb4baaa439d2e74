"""A carried camera: what stays through an episode, and what is drawn anew in every look."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform
from scipy.stats import chi2

from extremal.estimator.poses import pose_log
from extremal.sim import get_arm
from extremal.tasks.carried import CarriedCamera, repeatability, whole_error

START = RigidTransform.from_translation([0.1, -0.4, 0.3])


def robot(bias: str, scatter: str, seed: int = 0) -> CarriedCamera:
    return CarriedCamera.draw(
        get_arm(bias), whole_error(get_arm(scatter)), START, np.random.default_rng(seed)
    )


def errors(camera: CarriedCamera, looks: int) -> np.ndarray:
    rng = np.random.default_rng(5)
    actual = np.array([camera.actual(START.as_matrix(), rng) for _ in range(looks)])
    return pose_log(START.inv() * RigidTransform.from_matrix(actual))


def test_an_ideal_robot_goes_where_it_is_told() -> None:
    assert np.abs(errors(robot("ideal", "ideal"), 3)).max() < 1e-12


def test_bias_alone_is_the_same_in_every_look_and_differs_between_robots() -> None:
    first, other = (errors(robot("typical", "ideal", seed), 3) for seed in (0, 1))
    assert np.ptp(first, axis=0).max() < 1e-12 and np.abs(first - other).max() > 1e-5


@pytest.mark.parametrize("scatter", ["calibrated", "typical", "poor"])
def test_scatter_is_as_large_as_told(scatter: str) -> None:
    camera, n = robot("ideal", scatter), 400
    found = errors(camera, n)
    nees = np.einsum("vi,ij,vj->v", found, np.linalg.inv(camera.covariance), found)
    low, high = chi2.ppf((1e-5, 1 - 1e-5), 6 * n) / n
    assert low < nees.mean() < high


def test_a_typical_robot_is_off_by_a_millimetre_and_a_milliradian() -> None:
    sigma = 1e3 * np.sqrt(np.diag(robot("typical", "typical").covariance)).reshape(2, 3)
    assert np.all(np.abs(np.sqrt(np.mean(sigma**2, axis=1)) - 1) < 0.25)


def test_what_repeats_is_a_small_part_of_the_error() -> None:
    whole, repeated = (np.sqrt(np.diag(of(get_arm("typical")))) for of in (whole_error, repeatability))
    assert np.all(repeated < 0.2 * whole) and np.all(repeated > 0)
