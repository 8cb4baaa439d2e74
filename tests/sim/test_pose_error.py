"""Pose errors: their statistics, what is common and what is independent, and where they are applied."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from extremal.estimator import InvalidInput
from extremal.sim import ArmKinematics, PoseErrors
from extremal.sim.kinematics import HOME

ARM = ArmKinematics(RigidTransform.from_components([0.1, 0.2, 0.3], Rotation.from_rotvec([0.3, -0.2, 0.5])))


def errors(model: PoseErrors, q: NDArray[np.floating], seed: int) -> NDArray[np.floating]:
    """(V, 6) = (translation, rotation vector) of actual^-1 believed."""
    difference = ARM.camera_poses(q).inv() * model.believed(q, ARM.camera_poses, np.random.default_rng(seed))
    return np.concatenate([difference.translation, difference.rotation.as_rotvec()], axis=1)


def test_no_errors_no_difference() -> None:
    q = HOME + np.zeros((4, 6))
    assert np.abs(errors(PoseErrors(), q, 0)).max() < 1e-12
    assert not PoseErrors().view_covariance.any()


def test_repeatability_has_the_stated_covariance() -> None:
    count = 4000
    model = PoseErrors(position=1e-3, rotation=2e-3)
    found = errors(model, HOME + np.zeros((count, 6)), 1)
    covariance = found.T @ found / count
    expected = model.view_covariance
    np.testing.assert_array_equal(np.diag(expected), [1e-6] * 3 + [4e-6] * 3)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    # The sd of an estimated variance is sqrt(2 / n) of it, of a correlation 1 / sqrt(n).
    assert np.abs((covariance - expected) / scale).max() < 4.5 * np.sqrt(2 / count)


def test_hand_eye_offset_is_common_to_all_views() -> None:
    q = HOME + np.random.default_rng(0).uniform(-0.5, 0.5, (5, 6))
    model = PoseErrors(hand_eye_position=1e-3, hand_eye_rotation=2e-3)
    assert not model.view_covariance.any()
    offsets = np.array([errors(model, q, seed) for seed in range(300)])
    np.testing.assert_allclose(offsets, np.repeat(offsets[:, :1], 5, axis=1), atol=1e-12)
    sd = offsets[:, 0].std(axis=0)
    np.testing.assert_allclose(sd, [1e-3] * 3 + [2e-3] * 3, rtol=4 / np.sqrt(2 * 300))


def test_joint_bias_goes_through_the_arm() -> None:
    """Against the finite-difference Jacobian of the forward kinematics."""
    rng = np.random.default_rng(3)
    q = HOME + rng.uniform(-0.5, 0.5, (2, 6))
    h, sd, count = 1e-5, 1e-4, 1500
    jacobians = np.empty((2, 6, 6))
    for j in range(6):
        moved = ARM.camera_poses(q).inv() * ARM.camera_poses(q + h * np.eye(6)[j])
        jacobians[:, :, j] = np.concatenate([moved.translation, moved.rotation.as_rotvec()], axis=1) / h
    found = np.array([errors(PoseErrors(joint_bias=sd), q, seed) for seed in range(count)])
    for view in range(2):
        expected = sd**2 * jacobians[view] @ jacobians[view].T
        covariance = found[:, view].T @ found[:, view] / count
        scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
        assert np.abs((covariance - expected) / scale).max() < 5 * np.sqrt(2 / count)


def test_the_prior_knows_what_all_views_share() -> None:
    """Errors without repeatability are few common numbers, of unit variance, times the prior's columns."""
    q = HOME + np.random.default_rng(5).uniform(-0.5, 0.5, (7, 6))
    model = PoseErrors(hand_eye_position=1e-4, hand_eye_rotation=2e-4, joint_bias=1e-4)
    prior = model.prior(ARM.camera_poses(q), q, ARM.camera_poses)
    assert prior.root.shape == (7, 6, 0) and prior.common.shape == (7, 6, 12)
    trials, columns = 400, prior.common.reshape(42, 12)
    found = np.array([errors(model, q, seed).ravel() for seed in range(trials)])
    numbers = np.linalg.lstsq(columns, found.T, rcond=None)[0]
    assert np.abs(columns @ numbers - found.T).max() < 1e-6  # what is of second order
    spread = np.mean(found**2, axis=0) / np.sum(columns**2, axis=1)
    assert np.abs(spread - 1).max() < 5 * np.sqrt(2 / trials)
    assert PoseErrors().prior(ARM.camera_poses(q), q, ARM.camera_poses).exact
    assert PoseErrors(position=1e-3).prior(ARM.camera_poses(q), q, ARM.camera_poses).root.shape == (7, 6, 3)


def test_draws_do_not_depend_on_the_sizes() -> None:
    q = HOME + np.zeros((3, 6))
    small, large = (errors(PoseErrors(position=s, joint_bias=0.0), q, 7) for s in (1e-6, 1e-3))
    np.testing.assert_allclose(large, 1e3 * small, atol=1e-9)


@pytest.mark.parametrize(
    "name", ["position", "rotation", "hand_eye_position", "hand_eye_rotation", "joint_bias"]
)
@pytest.mark.parametrize("value", [-1.0, float("nan"), float("inf")])
def test_bad_values_are_named(name: str, value: float) -> None:
    with pytest.raises(InvalidInput, match=name.replace("_", " ")):
        PoseErrors(**{name: value})
