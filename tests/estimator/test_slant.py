"""Slants smoothed over the views against the exact tangent planes of straight edges and spheres."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from extremal.estimator.camera import Array
from extremal.estimator.slant import smoothed_tangent_planes
from extremal.scripts.spatial_study import random_scene
from extremal.scripts.synthetic import TangentScene

VIEWS, REFERENCE, CONTOURS = 9, 4, 12


@pytest.fixture(scope="module")
def scene() -> TangentScene:
    """Spheres, cut obliquely, and tilted straight lines, by turns."""
    return random_scene(VIEWS, CONTOURS, 0, np.random.default_rng(1))


def smoothed(scene: TangentScene, normals: Array, seen: np.ndarray | None = None) -> Array:
    rays = scene.rays[:, : normals.shape[1]]
    seen = np.ones(rays.shape[:2], bool) if seen is None else seen
    reference = min(REFERENCE, rays.shape[1] // 2)
    return smoothed_tangent_planes(normals, rays, scene.plane_normals, seen, reference)


def turned(scene: TangentScene, angles: Array) -> Array:
    """The scene's tangent planes (n, V, 3) turned about their rays."""
    across = np.cross(scene.rays, scene.normals)
    return np.cos(angles)[..., None] * scene.normals + np.sin(angles)[..., None] * across


def off(normals: Array, scene: TangentScene) -> Array:
    """Angles (n, V) [rad] from the scene's tangent planes."""
    return np.arcsin(np.linalg.norm(np.cross(normals, scene.normals[:, : normals.shape[1]]), axis=-1))


def tilt(scene: TangentScene) -> Array:
    """Largest sine (n,) of the angle between a contour's surface normals and its epipolar plane."""
    return np.abs(np.sum(scene.normals * scene.plane_normals[:, None], axis=-1)).max(axis=1)


def test_exact_planes_stay_as_they_are(scene: TangentScene) -> None:
    assert tilt(scene).min() < 0.1 and tilt(scene).max() > 0.6
    found = smoothed(scene, scene.normals)
    assert np.all(np.sum(found * scene.normals, axis=-1) > 0)
    assert off(found, scene).max() < 5e-6


def test_signs_of_normals_do_not_matter(scene: TangentScene) -> None:
    signs = np.random.default_rng(2).choice([-1.0, 1.0], (CONTOURS, VIEWS, 1))
    np.testing.assert_allclose(smoothed(scene, signs * scene.normals), smoothed(scene, scene.normals))


def test_a_turn_of_the_world_turns_them(scene: TangentScene) -> None:
    turn = Rotation.from_rotvec([0.5, -0.8, 0.3]).as_matrix().T
    noisy = turned(scene, 0.02 * np.random.default_rng(3).normal(size=(CONTOURS, VIEWS)))
    seen = np.ones((CONTOURS, VIEWS), bool)
    found = smoothed_tangent_planes(
        noisy @ turn, scene.rays @ turn, scene.plane_normals @ turn, seen, REFERENCE
    )
    np.testing.assert_allclose(found, smoothed(scene, noisy) @ turn, atol=1e-9)


def test_noise_of_directions_averages_as_three_numbers_from_all_views_do(scene: TangentScene) -> None:
    rng, sigma, trials = np.random.default_rng(4), 0.02, 200
    square = np.zeros((CONTOURS, VIEWS))
    for _ in range(trials):
        noisy = turned(scene, sigma * rng.normal(size=square.shape))
        square += off(smoothed(scene, noisy), scene) ** 2 / trials
    left = np.sqrt(square.mean(axis=1)) / sigma
    # least squares would leave the square root of 3 / V; weights that bound outliers cost a little more
    assert np.all(left < 1.15 * np.sqrt(3 / VIEWS)) and np.all(left > 0.9 * np.sqrt(3 / VIEWS))


def test_every_plane_contains_its_ray(scene: TangentScene) -> None:
    """Also where cameras are a little off the epipolar planes, as those of a robot's path are."""
    rng = np.random.default_rng(5)
    noisy = turned(scene, 0.3 * rng.normal(size=(CONTOURS, VIEWS)))
    rays = scene.rays + 3e-3 * rng.normal(size=scene.rays.shape)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    noisy -= np.sum(noisy * rays, axis=-1, keepdims=True) * rays
    noisy /= np.linalg.norm(noisy, axis=-1, keepdims=True)
    found = smoothed_tangent_planes(
        noisy, rays, scene.plane_normals, np.ones((CONTOURS, VIEWS), bool), REFERENCE
    )
    np.testing.assert_allclose(np.sum(found * rays, axis=-1), 0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(found, axis=-1), 1)


def test_views_that_do_not_show_a_contour_are_filled(scene: TangentScene) -> None:
    seen = np.ones((CONTOURS, VIEWS), bool)
    seen[:, [1, 6]] = False
    seen[::3, 3] = False
    given = np.where(
        seen[..., None], scene.normals, scene.plane_normals[:, None]
    )  # as `tracking` leaves them
    assert off(smoothed(scene, given, seen), scene).max() < 5e-5


def test_a_false_direction_hardly_turns_the_others(scene: TangentScene) -> None:
    angles = np.zeros((CONTOURS, VIEWS))
    angles[:, 2] = 0.5
    others = np.arange(VIEWS) != 2
    left = off(smoothed(scene, turned(scene, angles)), scene)[:, others].max(axis=1)
    assert np.median(left) < 0.05 * 0.5 and left[tilt(scene) < 0.8].max() < 0.2 * 0.5


@pytest.mark.parametrize("count", [0, 1, 2])
def test_few_views_leave_finite_planes(scene: TangentScene, count: int) -> None:
    """Warnings are errors. What few views do not tell is decided somehow, but the planes that were seen stay nearly."""
    seen = np.zeros((CONTOURS, VIEWS), bool)
    seen[:, [REFERENCE, 0][:count]] = True
    given = np.where(seen[..., None], scene.normals, scene.plane_normals[:, None])
    found = smoothed(scene, given, seen)
    np.testing.assert_allclose(np.linalg.norm(found, axis=-1), 1)
    np.testing.assert_allclose(np.sum(found * scene.rays, axis=-1), 0, atol=1e-12)
    assert np.max(off(found, scene)[seen], initial=0.0) < 1e-4


@pytest.mark.parametrize("views", [1, 2, 3])
def test_short_sequences(scene: TangentScene, views: int) -> None:
    assert off(smoothed(scene, scene.normals[:, :views]), scene).max() < 1e-4


def test_no_tracks(scene: TangentScene) -> None:
    none = np.zeros((0, VIEWS, 3))
    assert (
        smoothed_tangent_planes(none, none, np.zeros((0, 3)), np.zeros((0, VIEWS), bool), 0).shape
        == none.shape
    )
