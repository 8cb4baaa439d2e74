"""The contour bundle adjustment against dense algebra, exact theory, and Monte Carlo."""

from dataclasses import replace

import numpy as np
import pytest
from jacobian import numeric_jacobian
from scipy.spatial.transform import RigidTransform

from extremal.estimator import osculating_circle
from extremal.estimator.adjustment import Adjustment, adjust
from extremal.estimator.camera import Array
from extremal.estimator.poses import PosePrior, pose_exp
from extremal.estimator.support import CIRCLE, Features
from extremal.scripts import joint_study, spatial_study
from extremal.scripts.joint_study import (
    NORMAL,
    POSITION,
    RADIUS,
    ROTATION,
    angle_derivatives,
    joint_row,
    planar_trials,
)
from extremal.scripts.spatial_study import random_scene
from extremal.scripts.synthetic import TangentScene, observe

SIGMA = 1e-4
PLANAR = joint_study.CASES[1]  # 15 views over 400 mm at 600 mm
VIEWS = 5


def noise_free(scene: TangentScene, sigma: float = SIGMA) -> list[Features]:
    """Features as the true cameras see them, without errors but with the sigma of some."""
    views = len(scene.T_world_camera)
    known = PosePrior(scene.T_world_camera, np.zeros((views, 6, 0)))
    features = observe(scene, known, 1e-15, np.random.default_rng(0)).features
    return [replace(f, sigma=np.full_like(f.sigma, sigma)) for f in features]


def independent(T: RigidTransform, position: float = 1e-3, rotation: float = 1e-3) -> PosePrior:
    return PosePrior(T, np.tile(np.diag(np.repeat([position, rotation], 3)), (len(T), 1, 1)))


# Marginals.


def dense_covariance(
    scene: TangentScene, prior: PosePrior, features: list[Features], found: Adjustment
) -> Array:
    """Inverse of the normal matrix of all unknowns at once: u, then theta of one set after the other."""
    targets = [scene.contacts[:, None], scene.points[:, None, None]]
    spots = [np.linalg.norm(t - scene.T_world_camera.translation, axis=-1) for t in targets]
    sizes = [s.theta.size for s in found.shapes]

    def residuals(x: Array) -> Array:
        u, rest = x[: prior.unknowns], x[prior.unknowns :]
        poses = (prior.T_world_camera * pose_exp(prior.errors(u))).as_matrix()
        out = [u]
        for f, theta, distance in zip(features, np.split(rest, np.cumsum(sizes)[:-1]), spots, strict=True):
            stretched = f.normals * ([1 + prior.focal_sigma * u[-1]] * 2 + [1])
            world = np.einsum("vjk,nlvk->nlvj", poses[:, :3, :3], stretched)
            world /= np.linalg.norm(world, axis=-1, keepdims=True)
            local = np.einsum("njk,nlvk->nlvj", f.frame, world)
            lever = poses[:, :3, 3] - f.origin[:, None]
            h = np.einsum("nlvk,nk->nlv", f.columns(local), theta.reshape(len(f), -1))
            out.append(((np.einsum("nlvk,nvk->nlv", world, lever) - h) / (f.sigma * distance)).ravel())
        return np.concatenate(out)

    at = np.concatenate([np.zeros(prior.unknowns), *(s.theta.ravel() for s in found.shapes)])
    step = np.concatenate([np.full(prior.unknowns, 1e-2), np.full(sum(sizes), 1e-4)])
    J = numeric_jacobian(residuals, at, step)
    used = np.abs(J).max(axis=0) > 0  # not the radii of lines
    covariance = np.zeros((len(at), len(at)))
    covariance[np.ix_(used, used)] = np.linalg.inv(J[:, used].T @ J[:, used])
    return covariance


@pytest.mark.parametrize("kind", ["independent", "common"])
def test_marginal_covariances_are_those_of_all_unknowns_at_once(kind: str) -> None:
    rng = np.random.default_rng(7)
    scene = random_scene(VIEWS, 6, 5, rng)
    prior = independent(scene.T_world_camera)
    if kind == "common":
        prior = replace(prior, common=1e-3 * rng.normal(size=(VIEWS, 6, 2)), focal_sigma=2e-3)
    features = noise_free(scene)
    found = adjust(prior, features)
    assert found.converged and all(s.valid.all() for s in found.shapes)
    dense = dense_covariance(scene, prior, features, found)
    U = prior.unknowns
    tilts = np.zeros((VIEWS, 6, U))
    for i in range(VIEWS):
        tilts[i, :, 6 * i : 6 * i + 6] = prior.root[i]
    tilts[:, :, 6 * VIEWS : U - bool(prior.focal_sigma)] = prior.common
    expected = tilts @ dense[:U, :U] @ np.swapaxes(tilts, 1, 2)
    np.testing.assert_allclose(found.pose_covariance, expected, atol=1e-6 * expected.max())
    assert found.focal_sigma == pytest.approx(
        prior.focal_sigma * np.sqrt(dense[U - 1, U - 1]) if prior.focal_sigma else 0, rel=1e-6
    )
    at = U
    for shape in found.shapes:
        n, k = shape.theta.shape
        for j in range(n):
            block = dense[at + k * j : at + k * (j + 1), at + k * j : at + k * (j + 1)]
            np.testing.assert_allclose(shape.covariance[j], block, atol=1e-6 * np.abs(block).max())
        at += n * k
    sections, free = found.shapes[0], np.flatnonzero(scene.radii)
    radii = U + 3 * free + 2
    covariance = sections.shared[free] @ sections.shared[free].T + np.diag(sections.own_variance[free])
    np.testing.assert_allclose(covariance, dense[np.ix_(radii, radii)], rtol=1e-5)
    np.testing.assert_allclose(sections.sigma_radius[free], np.sqrt(np.diag(dense)[radii]), rtol=1e-6)


@pytest.mark.parametrize("overlap", [1.0, 3.0])
def test_radius_of_a_section_held_fixed_is_what_it_would_be_if_free(overlap: float) -> None:
    rng = np.random.default_rng(8)
    scene = random_scene(VIEWS, 8, 6, rng)
    seen = observe(scene, independent(scene.T_world_camera, 1e-4, 1e-4), 1e-6, rng)  # small: nearly linear
    sections, points = seen.features
    held = adjust(seen.prior, [sections, points], overlap).shapes[0]
    for j in np.flatnonzero(scene.radii == 0):
        order = sections.order.copy()
        order[j] = CIRCLE
        free = adjust(seen.prior, [replace(sections, order=order), points], overlap).shapes[0]
        assert held.sigma_radius[j] == pytest.approx(free.sigma_radius[j], rel=1e-2)
        assert held.own_variance[j] == pytest.approx(free.own_variance[j], rel=1e-2)
        assert abs(held.radius[j] - free.radius[j]) < 0.02 * free.sigma_radius[j]


def test_overlap_weakens_what_features_say_of_the_cameras_alone() -> None:
    rng = np.random.default_rng(9)
    scene = random_scene(VIEWS, 6, 5, rng)
    prior = independent(scene.T_world_camera)
    once, repeated = adjust(prior, noise_free(scene)), adjust(prior, noise_free(scene), overlap=4.0)
    weaker = adjust(prior, noise_free(scene, 2 * SIGMA))
    np.testing.assert_allclose(repeated.pose_covariance, weaker.pose_covariance, atol=1e-12)
    free = scene.radii != 0
    plain, found = once.shapes[0], repeated.shapes[0]
    np.testing.assert_allclose(found.own_variance[free], plain.own_variance[free], rtol=1e-6)
    assert np.all(np.sum(found.shared[free] ** 2, axis=1) > np.sum(plain.shared[free] ** 2, axis=1))
    assert np.all(found.sigma_radius > plain.sigma_radius)


# Against the other methods, and the exact bound.


def test_with_exact_poses_it_is_the_osculating_circle() -> None:
    scene = PLANAR.scene
    known = PosePrior(scene.T_world_camera, np.zeros((PLANAR.views, 6, 0)))
    seen = observe(scene, known, 1e-5, np.random.default_rng(10))
    free = replace(seen.features[0], order=np.full(len(scene.radii), CIRCLE))
    found = adjust(seen.prior, [free])
    v, rotations = scene.T_world_camera.translation, scene.T_world_camera.rotation.as_matrix()
    rays = np.cross(np.einsum("vjk,nvk->nvj", rotations, free.normals[:, 0]), NORMAL)
    rays *= -np.sign(np.sum(rays * v, axis=-1, keepdims=True))
    circles = osculating_circle(v, rays, 1e-5, NORMAL)
    shape = found.shapes[0]
    assert found.converged and found.steps == 0 and np.all(found.pose_covariance == 0)
    # the two weigh rays by distances that differ by the depth of their origins
    np.testing.assert_allclose(shape.radius, circles.radius, atol=5e-2 * float(circles.sigma_radius.max()))
    np.testing.assert_allclose(shape.sigma_radius, circles.sigma_radius, rtol=1e-2)
    exact = adjust(known, [replace(noise_free(scene)[0], order=free.order)]).shapes[0]
    np.testing.assert_allclose(exact.radius, scene.radii, atol=1e-9)


def test_sigma_is_the_bound() -> None:
    found = adjust(PLANAR.errors, noise_free(PLANAR.scene, PLANAR.sigma))
    _, bound = joint_study.radius_bounds(PLANAR)
    assert found.shapes[0].sigma_radius[0] == pytest.approx(bound, rel=1e-5)
    assert found.shapes[0].radius[0] == pytest.approx(RADIUS, abs=1e-9)


def test_without_fixed_features_sigma_is_that_of_the_absolute_estimate() -> None:
    """One contour alone says nothing of the poses that its own radius does not need."""
    J = angle_derivatives(PLANAR)[0] / PLANAR.sigma
    views, prior = PLANAR.views, np.repeat([POSITION**2, POSITION**2, ROTATION**2], PLANAR.views)
    poses, shape = J[:, : 3 * views], J[:, [3 * views, 3 * views + 1, -1]]
    noise = np.eye(views) + (poses * prior) @ poses.T
    expected = np.sqrt(np.linalg.inv(shape.T @ np.linalg.solve(noise, shape))[-1, -1])
    first = np.array([0])
    found = adjust(PLANAR.errors, [noise_free(PLANAR.scene, PLANAR.sigma)[0].take(first)])
    assert found.shapes[0].sigma_radius[0] == pytest.approx(expected, rel=1e-5)
    assert expected > 10 * joint_study.radius_bounds(PLANAR)[1]
    rng, trials, z = np.random.default_rng(11), 120, []
    for _ in range(trials):
        seen = observe(PLANAR.scene, PLANAR.errors, PLANAR.sigma, rng)
        shape = adjust(seen.prior, [seen.features[0].take(first)]).shapes[0]
        z.append((shape.radius[0] - RADIUS) / shape.sigma_radius[0])
    assert np.mean(np.square(z)) == pytest.approx(1, abs=4 * np.sqrt(2 / trials))


# Honesty.


@pytest.mark.parametrize("trials", [120, pytest.param(600, marks=pytest.mark.slow)])
def test_planar_errors_are_what_sigma_says(trials: int) -> None:
    row = joint_row(PLANAR, planar_trials((1, 0, trials)))
    assert row.converged == 1
    assert row.nees == pytest.approx(1, abs=4 * np.sqrt(2 / trials))
    assert row.ratio == pytest.approx(1, abs=4 * np.sqrt(0.5 / trials))
    assert row.coverage == pytest.approx(0.95, abs=4 * np.sqrt(0.95 * 0.05 / trials))
    assert abs(row.bias_mm) < 4 * row.joint_mm / np.sqrt(trials)


@pytest.mark.parametrize("case, trials", [(0, 60), pytest.param(3, 60, marks=pytest.mark.slow)])
def test_errors_in_space_are_what_sigma_says(case: int, trials: int) -> None:
    """Six errors of every pose; then also a wrong hand-eye transform and a wrong focal length."""
    row = spatial_study.spatial_row(
        spatial_study.CASES[case], spatial_study.spatial_trials((case, 0, trials))
    )
    assert row.converged > 0.95
    # radii of a trial share errors of cameras: ten of them count as one or two
    few = 4 * np.sqrt(2 / trials / 2)
    assert row.nees_sphere == pytest.approx(1.05, abs=few)
    assert row.nees_line == pytest.approx(1, abs=few)
    assert row.nees_pose == pytest.approx(1, abs=few)
    assert row.nees_point == pytest.approx(1, abs=few)
    if row.nees_focal:
        assert row.nees_focal == pytest.approx(1, abs=4 * np.sqrt(2 / trials))


@pytest.mark.slow
def test_every_case_of_the_planar_table() -> None:
    for row in joint_study.joint_study(4000):
        assert row.ratio < 1.15
        assert 0.9 < row.nees < 1.1
        assert 0.93 < row.coverage < 0.97
        assert row.converged >= 0.995
        assert row.joint_mm < row.parallax_mm < row.absolute_mm <= row.three_views_mm


def test_gross_outliers_hardly_move_the_radius() -> None:
    """3 % of all planes are off by 30 sigma."""
    case, rng, moved = joint_study.CASES[2], np.random.default_rng(12), []
    for _ in range(10):
        seen = observe(case.scene, case.errors, case.sigma, rng)
        clean = adjust(seen.prior, seen.features).shapes[0]
        f = seen.features[0]
        off = 30 * case.sigma * rng.choice([-1, 1], f.sigma.shape) * (rng.random(f.sigma.shape) < 0.03)
        up = np.cross(f.normals, [0.0, 1.0, 0.0])
        normals = f.normals + off[..., None] * up / np.linalg.norm(up, axis=-1, keepdims=True)
        normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
        found = adjust(seen.prior, [replace(f, normals=normals)])
        assert found.converged
        moved.append((found.shapes[0].radius[0] - clean.radius[0]) / clean.sigma_radius[0])
    assert np.sqrt(np.mean(np.square(moved))) < 1.0
