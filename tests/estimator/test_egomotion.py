"""Robot and board together: errors against stated covariance by Monte Carlo, and against the dense Gaussian solution."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from extremal.estimator import Camera, DegenerateGeometry, InvalidInput
from extremal.estimator.board_pose import BoardPose
from extremal.estimator.egomotion import board_egomotion, combined, fused_egomotion
from extremal.estimator.poses import PosePrior, pose_exp, square_root
from extremal.estimator.projection import INTRINSICS, focal_sigma, turning

V = 12


def random_poses(rng: np.random.Generator, count: int = V) -> RigidTransform:
    return RigidTransform.from_components(rng.normal(size=(count, 3)), Rotation.random(count, rng))


def random_root(rng: np.random.Generator, columns: int, size: float) -> np.ndarray:
    return size * rng.normal(size=(V, 6, columns))


def logarithm(poses: RigidTransform) -> np.ndarray:
    x = poses.as_exp_coords()
    return np.concatenate([x[:, 3:], x[:, :3]], axis=1)


def test_combined_is_the_dense_gaussian_posterior() -> None:
    """All 6 V errors at once, by conditioning one large normal distribution."""
    rng = np.random.default_rng(0)
    truth = random_poses(rng)
    r, s = random_root(rng, 6, 1e-5), random_root(rng, 6, 1e-5)
    A, B = random_root(rng, 4, 1e-5), random_root(rng, 4, 1e-5)
    errors = (
        np.einsum("vik,vk->vi", r, rng.normal(size=(V, 6))),
        np.einsum("vik,vk->vi", s, rng.normal(size=(V, 6))),
    )
    robot = PosePrior(truth * pose_exp(-errors[0]), r, A)
    board = PosePrior(truth * pose_exp(-errors[1]), s, B)
    both = combined(robot, board, np.ones(V, bool))

    def dense(root: np.ndarray, common: np.ndarray) -> np.ndarray:
        stacked = np.zeros((6 * V, 6 * V + common.shape[2]))
        for i in range(V):
            stacked[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] = root[i]
        stacked[:, 6 * V :] = common.reshape(6 * V, -1)
        return stacked

    e, n = dense(r, A), dense(s, B)
    d = logarithm(robot.T_world_camera.inv() * board.T_world_camera).ravel()
    own = np.concatenate([e, np.zeros((6 * V, 6 * V))], axis=1)  # z, c, w
    measured = np.concatenate([n[:, : 6 * V] * 0, e[:, 6 * V :] - n[:, 6 * V :], -n[:, : 6 * V]], axis=1)
    measured[:, : 6 * V] = e[:, : 6 * V]
    W = measured @ measured.T
    mean = own @ measured.T @ np.linalg.solve(W, d)
    covariance = own @ own.T - own @ measured.T @ np.linalg.solve(W, measured @ own.T)
    found = dense(both.root, both.common)
    moved = logarithm(robot.T_world_camera.inv() * both.T_world_camera).ravel()
    assert np.allclose(moved, mean, rtol=1e-4, atol=1e-8)
    assert np.allclose(found @ found.T, covariance, rtol=1e-6, atol=1e-4 * np.abs(covariance).max())


def test_errors_are_as_large_as_stated_where_the_board_stands_anywhere() -> None:
    rng = np.random.default_rng(1)
    trials, nees, excess = 200, [], 0
    for _ in range(trials):
        truth = random_poses(rng)
        r, A = random_root(rng, 6, 1e-4), random_root(rng, 3, 1e-3)
        s, B = random_root(rng, 6, 3e-5), random_root(rng, 2, 3e-5)
        c = rng.normal(size=3)
        k = np.append(c[:1], rng.normal(size=1))  # the first common error is one and the same
        e = np.einsum("vik,vk->vi", r, rng.normal(size=(V, 6))) + A @ c
        n = np.einsum("vik,vk->vi", s, rng.normal(size=(V, 6))) + B @ k
        robot = PosePrior(truth * pose_exp(-e), r, A)
        place = random_poses(rng, 1)[0]
        seen: list[BoardPose | None] = [None if i in (2, 7) else object() for i in range(V)]  # pyright: ignore[reportAssignmentType]
        known = np.array([pose is not None for pose in seen])
        board = PosePrior((place * truth * pose_exp(-n))[np.flatnonzero(known)], s[known], B[known])
        both = fused_egomotion(robot, seen, board, shared=1)
        left = logarithm(both.T_world_camera.inv() * truth).ravel()
        stacked = np.concatenate([both.root.swapaxes(1, 2), np.zeros((V, 0, 6))], axis=1)
        covariance = both.common.reshape(6 * V, -1) @ both.common.reshape(6 * V, -1).T
        for i in range(V):
            block = slice(6 * i, 6 * i + 6)
            covariance[block, block] += stacked[i].T @ stacked[i]
        nees.append(left @ np.linalg.solve(covariance, left) / (6 * V))
        robot_size = np.sqrt(np.mean(np.diagonal(robot.covariance[known], axis1=1, axis2=2)))
        assert np.sqrt(np.mean(np.diagonal(both.covariance[known], axis1=1, axis2=2))) < robot_size
        excess += np.mean(nees[-1]) > 2
    bound = 4 * np.sqrt(2 / (6 * V * trials))
    assert abs(np.mean(nees) - 1) < bound + 0.02  # inflation in the rare surprising trial
    assert excess == 0


def test_a_robot_worse_than_stated_is_found_out() -> None:
    rng = np.random.default_rng(2)
    truth, r, s = random_poses(rng), random_root(rng, 6, 1e-4), random_root(rng, 6, 1e-6)
    e = 4 * np.einsum("vik,vk->vi", r, rng.normal(size=(V, 6)))
    honest = combined(PosePrior(truth * pose_exp(-e / 4), r), PosePrior(truth, s), np.ones(V, bool))
    wrong = combined(PosePrior(truth * pose_exp(-e), r), PosePrior(truth, s), np.ones(V, bool))
    ratio = np.diagonal(wrong.covariance, axis1=1, axis2=2) / np.diagonal(honest.covariance, axis1=1, axis2=2)
    assert np.all(ratio > 6)


def test_views_without_board_keep_what_the_robot_says() -> None:
    rng = np.random.default_rng(3)
    truth, r, s = random_poses(rng), random_root(rng, 6, 1e-3), random_root(rng, 6, 1e-5)
    known = np.arange(V) != 4
    both = combined(PosePrior(truth, r), PosePrior(truth[np.flatnonzero(known)], s[known]), known)
    assert np.allclose(both.covariance[4], PosePrior(truth, r).covariance[4])
    assert np.all(np.trace(both.covariance[known], axis1=1, axis2=2) < 1e-2 * np.trace(both.covariance[4]))


def test_a_wrong_principal_point_turns_the_rays_near_the_axis() -> None:
    camera, step = Camera(), 0.5
    middle = [camera.cx, camera.cy]
    for name in ("cx", "cy"):
        actual = Camera(**{name: getattr(camera, name) + step})
        twist = turning(camera)[:, INTRINSICS.index(name)] * step
        believed = pose_exp(twist).apply(camera.rays(middle))
        assert np.allclose(believed, actual.rays(middle), atol=1e-6)


def test_focal_sigma_is_that_of_the_mean() -> None:
    root = np.zeros((9, 2))
    root[0, 0], root[1, 0] = 0.8, 0.8
    assert focal_sigma(Camera(), root) == pytest.approx(1e-3)
    root[1] = (0.0, 0.8)
    assert focal_sigma(Camera(), root) == pytest.approx(1e-3 / np.sqrt(2))


def test_missing_boards_are_named() -> None:
    with pytest.raises(DegenerateGeometry, match="views 0, 1 of 2"):
        board_egomotion([None, None], RigidTransform.identity(), Camera())
    exact = PosePrior(random_poses(np.random.default_rng(0)), np.zeros((V, 6, 0)))
    with pytest.raises(DegenerateGeometry, match="no view saw the board"):
        fused_egomotion(exact, [None] * V, None)
    with pytest.raises(InvalidInput, match="both exact"):
        combined(exact, exact, np.ones(V, bool))


def test_square_root_is_used_for_each_view() -> None:
    covariance = np.diag([1e-8] * 3 + [1e-9] * 3)
    assert np.allclose(square_root(covariance[None])[0] @ square_root(covariance[None])[0].T, covariance)
