"""What is known of poses: square roots of covariances, whitened errors, their scatter."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from extremal.estimator import Camera, InvalidInput, View
from extremal.estimator.camera import Array
from extremal.estimator.poses import PosePrior, pose_exp, square_root

UNITS = np.array([1e-3, 2e-3, 1e-3, 1e-4, 2e-4, 5e-5])


def covariances(ranks: list[int]) -> Array:
    rng = np.random.default_rng(len(ranks))
    roots = [UNITS[:, None] * rng.normal(size=(6, rank)) for rank in ranks]
    return np.array([root @ root.T for root in roots])


def poses(views: int) -> RigidTransform:
    rng = np.random.default_rng(views)
    return pose_exp(rng.normal(size=(views, 6)))


@pytest.mark.parametrize("ranks", [[6, 6], [3, 3, 3], [1, 6, 0], [0, 0]])
def test_square_roots(ranks: list[int]) -> None:
    covariance = covariances(ranks)
    root = square_root(covariance)
    assert root.shape == (len(ranks), 6, max(ranks))
    error = root @ np.swapaxes(root, 1, 2) - covariance
    assert np.all(np.abs(error) <= 1e-9 * np.outer(UNITS, UNITS))


def test_square_roots_of_one_kind_of_error_alone() -> None:
    for sigma in ([1e-3] * 3 + [0] * 3, [0] * 3 + [1e-6] * 3, [0, 0, 1e-9, 0, 0.1, 0]):
        covariance = np.diag(np.square(sigma))[None]
        root = square_root(covariance)
        assert root.shape[2] == np.count_nonzero(sigma)
        np.testing.assert_allclose(root @ np.swapaxes(root, 1, 2), covariance, rtol=1e-9, atol=1e-30)


@pytest.mark.parametrize("bad", ["negative", "lopsided", "too correlated"])
def test_covariances_that_are_none(bad: str) -> None:
    covariance = np.diag(UNITS**2)
    if bad == "negative":
        covariance[3, 3] *= -1
    elif bad == "lopsided":
        covariance[0, 1] = 0.5 * UNITS[0] * UNITS[1]
    else:
        covariance[0, 1] = covariance[1, 0] = 1.1 * UNITS[0] * UNITS[1]
    with pytest.raises(InvalidInput, match="not symmetric and positive semi-definite"):
        square_root(np.array([np.diag(UNITS**2), covariance]))


def test_prior_of_views() -> None:
    covariance, T = covariances([6, 3, 0]), poses(3)
    image = np.zeros((8, 8), np.uint8)
    camera = Camera(width=8, height=8)
    prior = PosePrior.of([View(camera, T[i], image, covariance[i]) for i in range(3)])
    np.testing.assert_allclose(prior.covariance, covariance, atol=1e-14)
    np.testing.assert_allclose(prior.T_world_camera.as_matrix(), T.as_matrix(), atol=1e-15)
    assert not prior.exact and prior.unknowns == 18
    exact = PosePrior.of([View(camera, T[i], image) for i in range(3)])
    assert exact.exact and exact.root.shape == (3, 6, 0) and exact.unknowns == 0
    assert not PosePrior.of([View(camera, T[0], image)], focal_sigma=1e-3).exact


def test_errors_scatter_as_the_covariance_says() -> None:
    rng = np.random.default_rng(3)
    common = UNITS[:, None] * rng.normal(size=(4, 6, 2))
    prior = PosePrior(poses(4), square_root(covariances([6, 3, 1, 0])), common, focal_sigma=1e-3)
    assert prior.unknowns == 4 * 6 + 2 + 1
    trials = 20_000
    errors = np.array([prior.errors(u) for u in rng.standard_normal((trials, prior.unknowns))])
    found = np.einsum("tvi,tvj->vij", errors, errors) / trials
    sigma = np.sqrt(np.diagonal(prior.covariance, axis1=1, axis2=2))
    # the standard error of a covariance of n samples is at most sqrt(2 / n) in units of the two sigma
    bound = 5 * np.sqrt(2 / trials) * sigma[:, :, None] * sigma[:, None] + 1e-20
    assert np.all(np.abs(found - prior.covariance) < bound)
    # what is common moves the views together
    shared = np.einsum("ti,tj->ij", errors[:, 2], errors[:, 3]) / trials - common[2] @ common[3].T
    assert np.all(np.abs(shared) < 5 * np.sqrt(2 / trials) * np.outer(sigma[2], sigma[3]))


def test_errors_move_the_camera_in_its_own_frame() -> None:
    T = poses(2)
    prior = PosePrior(T, np.tile(np.eye(6), (2, 1, 1)))
    moved = prior.moved(np.array([[0.1, 0.2, 0.3, 0, 0, 0], [0, 0, 0, 0.1, -0.2, 0.3]]))
    expected = T[0].translation + T[0].rotation.apply([0.1, 0.2, 0.3])
    np.testing.assert_allclose(moved[0].translation, expected, atol=1e-14)
    np.testing.assert_allclose(moved[1].translation, T[1].translation, atol=1e-14)
    turn = T[1].rotation.inv() * moved[1].rotation
    np.testing.assert_allclose(turn.as_rotvec(), [0.1, -0.2, 0.3], atol=1e-14)


@pytest.mark.parametrize(
    "change, message",
    [
        ({"root": np.zeros((3, 6, 2))}, "root is"),
        ({"root": np.full((2, 6, 2), np.nan)}, "root is"),
        ({"common": np.ones((2, 5, 1))}, "common is"),
        ({"focal_sigma": -1e-3}, "focal_sigma is -0.001"),
        ({"focal_sigma": np.nan}, "focal_sigma is nan"),
        ({"focal_sigma": 0.5}, "below 0.5"),
    ],
)
def test_what_is_refused(change: dict, message: str) -> None:
    with pytest.raises(InvalidInput, match=message):
        PosePrior(**({"T_world_camera": poses(2), "root": np.zeros((2, 6, 1))} | change))
