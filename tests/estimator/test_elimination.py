"""Derivatives and reduced normal equations against finite differences and dense algebra."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from jacobian import assert_jacobian
from scipy.spatial.transform import RigidTransform

from extremal.estimator.camera import Array
from extremal.estimator.elimination import Cameras, Linearised, Reduced, linearise, linearise_all
from extremal.estimator.poses import PosePrior
from extremal.estimator.support import Features
from extremal.scripts.spatial_study import random_scene
from extremal.scripts.synthetic import TangentScene, observe

SIGMA = 1e-4
VIEWS = 5


def exact(seed: int) -> tuple[TangentScene, list[Features]]:
    """Spheres and lines, then points, without any error."""
    rng = np.random.default_rng(seed)
    scene = random_scene(VIEWS, 6, 4, rng)
    known = PosePrior(scene.T_world_camera, np.zeros((VIEWS, 6, 0)))
    features = observe(scene, known, 1e-15, rng).features
    return scene, [replace(f, sigma=np.full_like(f.sigma, SIGMA)) for f in features]


def uncertain(T: RigidTransform) -> PosePrior:
    """Correlated errors of all kinds."""
    rng = np.random.default_rng(1)
    root, common = 1e-3 * rng.normal(size=(VIEWS, 6, 4)), 1e-3 * rng.normal(size=(VIEWS, 6, 2))
    return PosePrior(T, root, common, focal_sigma=3e-3)


def linearised(features: Features, cameras: Cameras, passes: int = 4) -> Linearised:
    """With theta settled."""
    rows = np.arange(len(features))
    theta = np.zeros((len(features), features.width))
    robust = np.ones(features.sigma.shape)
    for _ in range(passes - 1):
        theta = linearise(features, rows, cameras, theta, robust).theta
    return linearise(features, rows, cameras, theta, robust)


@pytest.mark.parametrize("kind", [0, 1])
def test_derivatives_by_poses_common_errors_and_focal_length(kind: int) -> None:
    scene, sets = exact(2)
    features, prior = sets[kind], uncertain(scene.T_world_camera)
    block = linearised(features, Cameras.at(prior, np.zeros(prior.unknowns)))
    assert np.abs(block.residuals).max() < 1e-6 and block.ahead.all() and block.resolved.all()
    targets = scene.contacts[:, None] if kind == 0 else scene.points[:, None, None]
    distance = np.linalg.norm(targets - scene.T_world_camera.translation, axis=-1)

    def residuals(u: Array) -> Array:
        """n . (v - o) - h(n) over its standard deviation, from the planes that the cameras make of the images."""
        poses = (
            prior.T_world_camera.as_matrix()
            @ RigidTransform.from_exp_coords(prior.errors(u)[:, [3, 4, 5, 0, 1, 2]]).as_matrix()
        )
        stretched = features.normals * ([1 + prior.focal_sigma * u[-1]] * 2 + [1])
        world = np.einsum("vjk,nlvk->nlvj", poses[:, :3, :3], stretched)
        world /= np.linalg.norm(world, axis=-1, keepdims=True)
        lever = poses[:, :3, 3] - features.origin[:, None]
        local = np.einsum("njk,nlvk->nlvj", features.frame, world)
        h = np.einsum("nlvk,nk->nlv", features.columns(local), block.theta)
        return (np.einsum("nlvk,nvk->nlv", world, lever) - h) / (SIGMA * distance)

    own = np.zeros((*block.residuals.shape, VIEWS, block.by_view.shape[-1]))
    own[..., np.arange(VIEWS), np.arange(VIEWS), :] = block.by_view
    analytic = np.concatenate([own.reshape(*block.residuals.shape, -1), block.by_common], axis=-1)
    # the residual is bent by errors of 1e-3: small steps, for which rounding of 1e-16 in 1e-4 still is no matter
    assert_jacobian(residuals, analytic, np.zeros(prior.unknowns), rtol=1e-6, step=1e-2)


def dense(block: Linearised) -> Reduced:
    """J' (I - P) J and J' (I - P) r, with P the projector onto the columns of X = Q C."""
    n, planes, views, own = block.by_view.shape
    common = block.by_common.shape[-1]
    unknowns = views * own + common
    information, gradient = np.zeros((unknowns, unknowns)), np.zeros(unknowns)
    for j in range(n):
        J = np.zeros((planes, views, unknowns))
        for i in range(views):
            J[:, i, i * own : (i + 1) * own] = block.by_view[j, :, i]
        J[..., views * own :] = block.by_common[j]
        J = J.reshape(-1, unknowns)
        X = block.Q[j].reshape(planes * views, -1)
        left = J - X @ np.linalg.lstsq(X, J, rcond=None)[0]
        information += J.T @ left
        gradient += left.T @ block.residuals[j].ravel()
    return Reduced(information, gradient)


def test_reduced_equations_are_those_of_dense_algebra() -> None:
    scene, sets = exact(3)
    prior = uncertain(scene.T_world_camera)
    cameras = Cameras.at(prior, 0.5 * np.random.default_rng(4).standard_normal(prior.unknowns))
    for features in sets:
        block = linearised(features, cameras, passes=2)
        theta = linearised(features, cameras, passes=1).theta
        with ThreadPoolExecutor(1) as pool:
            _, reduced = linearise_all(features, cameras, theta, np.ones(features.sigma.shape), pool)
        expected = dense(block)
        size = np.abs(expected.information).max()
        np.testing.assert_allclose(reduced.information, expected.information, atol=1e-9 * size)
        np.testing.assert_allclose(
            reduced.gradient, expected.gradient, atol=1e-9 * np.abs(expected.gradient).max()
        )
        assert np.linalg.eigvalsh(reduced.information).min() > -1e-9 * size


def test_features_that_are_not_determined_say_nothing() -> None:
    """One view shows nothing of a fixed curve, two views nothing of a circle, whatever their planes are."""
    scene, sets = exact(5)
    prior = uncertain(scene.T_world_camera)
    cameras = Cameras.at(prior, np.full(prior.unknowns, 0.5))
    sigma = sets[0].sigma.copy()
    sigma[sets[0].order == 2, :, 1:] = np.inf
    sigma[sets[0].order == 3, :, 2:] = np.inf
    features = replace(sets[0], sigma=sigma)
    with ThreadPoolExecutor(1) as pool:
        blocks, reduced = linearise_all(
            features, cameras, np.zeros((6, 3)), np.ones(features.sigma.shape), pool
        )
    assert not any(block.resolved.any() for block in blocks)
    assert np.all(reduced.information == 0) and np.all(reduced.gradient == 0)


def test_planes_that_are_not_seen_or_weigh_nothing_are_left_out() -> None:
    scene, sets = exact(6)
    prior = uncertain(scene.T_world_camera)
    cameras = Cameras.at(prior, np.full(prior.unknowns, 0.3))
    features, rows = sets[1], np.arange(4)
    sigma, robust = features.sigma.copy(), np.ones(features.sigma.shape)
    sigma[:, 0, 2], robust[:, 1, 3] = np.inf, 0.0
    theta = np.zeros((4, 3))
    block = linearise(replace(features, sigma=sigma), rows, cameras, theta, robust)
    for values in (block.residuals, block.by_view, block.by_common, block.Q):
        assert np.all(values[:, 0, 2] == 0) and np.all(values[:, 1, 3] == 0)
        assert np.all(np.isfinite(values))
