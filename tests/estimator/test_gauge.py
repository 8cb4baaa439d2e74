"""The rigid part of common errors: split off exactly, given back to views and positions with its covariance."""

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from extremal.estimator.gauge import Gauge
from extremal.estimator.poses import PosePrior, pose_exp, pose_log
from extremal.estimator.projection import adjoint

V, C = 9, 4


def prior(common: np.ndarray, rng: np.random.Generator) -> PosePrior:
    poses = RigidTransform.from_components(0.5 * rng.normal(size=(V, 3)), Rotation.random(V, rng))
    return PosePrior(poses, 1e-4 * rng.normal(size=(V, 6, 6)), common)


def test_the_split_is_the_same_motion() -> None:
    """T exp(A c) = exp(G c) T exp(A' c), up to the product of both parts: ten times smaller errors agree a hundred times better."""
    rng = np.random.default_rng(0)
    before = prior(rng.normal(size=(V, 6, C)), rng)
    gauge, c = Gauge.of(before), rng.normal(size=C)
    off = []
    for size in (1e-3, 1e-4):
        whole = before.T_world_camera * pose_exp(before.common @ (size * c))
        split = (
            pose_exp(gauge.motion @ (size * c))
            * before.T_world_camera
            * pose_exp(gauge.still.common @ (size * c))
        )
        off.append(np.max(np.abs(pose_log(whole.inv() * split))))
    assert off[0] < 1e-4 and off[1] < 2e-2 * off[0]


def test_a_rigid_motion_leaves_nothing() -> None:
    rng = np.random.default_rng(1)
    poses = prior(np.zeros((V, 6, 0)), rng).T_world_camera
    motion = rng.normal(size=(6, C))
    gauge = Gauge.of(PosePrior(poses, np.zeros((V, 6, 0)), adjoint(poses.inv()) @ motion))
    np.testing.assert_allclose(gauge.motion, motion, atol=1e-12)
    np.testing.assert_allclose(gauge.still.common, 0, atol=1e-12)


def test_the_world_moves_by_what_was_found() -> None:
    rng = np.random.default_rng(2)
    before = prior(rng.normal(size=(V, 6, C)), rng)
    gauge, u = Gauge.of(before), np.zeros(before.unknowns)
    u[-C:] = [0.01, 0, 0, 0]
    root = rng.normal(size=(len(u), len(u)))
    world, spread = gauge.world(u, root)
    np.testing.assert_allclose(pose_log(world), 0.01 * gauge.motion[:, 0], atol=1e-12)
    covariance = gauge.motion @ (root.T @ root)[-C:, -C:] @ gauge.motion.T
    np.testing.assert_allclose(spread @ spread.T, covariance, rtol=1e-10)
