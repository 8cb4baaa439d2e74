"""The osculating circle against exact tangents, finite differences and Monte Carlo."""

import numpy as np
import pytest

from extremal.estimator import DegenerateGeometry, InvalidInput, osculating_circle
from extremal.estimator.camera import Array


def tangents(centres: Array, p0: Array, radius: Array | float, side: int) -> Array:
    """Rays (V, 2) from centres (V, 2) that touch a circle about p0; side +1 is on the left of its centre."""
    towards = p0 - centres
    angle = np.arctan2(towards[:, 1], towards[:, 0]) + side * np.arcsin(
        radius / np.linalg.norm(towards, axis=1)
    )
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def in_space(vectors: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Planar vectors carried into a random plane of space, and that plane's basis (2, 3)."""
    basis = np.linalg.qr(rng.normal(size=(3, 3)))[0][:2]
    return vectors @ basis, basis


@pytest.mark.parametrize(
    "views, baseline, distance", [(3, 0.1, 0.5), (15, 0.4, 0.6), (60, 0.8, 1.0), (3, 0.002, 0.5)]
)
@pytest.mark.parametrize("side", [1, -1])
def test_exact_rays_of_a_circle(views: int, baseline: float, distance: float, side: int) -> None:
    rng = np.random.default_rng(views)
    planar = np.stack([np.sort(rng.uniform(-0.5, 0.5, views)) * baseline, np.zeros(views)], axis=1)
    p0 = np.array([0.03, distance])
    (centres, basis), offset = in_space(planar, rng), rng.normal(size=3)
    rays = tangents(planar, p0, 0.04, side) @ basis
    circle = osculating_circle(centres + offset, rays, np.full(views, 1e-4))
    assert circle.valid
    # the surface's outward normal points against the travel where the ray passes to the left of the centre
    assert circle.radius == pytest.approx(-side * 0.04, abs=1e-9)
    np.testing.assert_allclose(circle.centre, p0 @ basis + offset, atol=1e-8)
    np.testing.assert_allclose(np.sum(circle.normals * rays, axis=1), 0, atol=1e-12)
    np.testing.assert_allclose(circle.points, circle.centre + circle.radius * circle.normals, atol=1e-12)
    assert np.all(circle.normals @ (centres[-1] - centres[0]) > 0)


def test_fixed_point_has_radius_zero() -> None:
    centres = np.array([[-0.05, 0, 0], [0, 0, 0], [0.05, 0, 0]])
    rays = np.array([0.02, 0.01, 0.5]) - centres
    circle = osculating_circle(centres, rays / np.linalg.norm(rays, axis=1, keepdims=True))
    assert circle.radius == pytest.approx(0, abs=1e-12)
    np.testing.assert_allclose(circle.points[0], [0.02, 0.01, 0.5], atol=1e-12)
    assert np.isinf(circle.sigma_radius)


def test_sphere_in_space_gives_the_section_by_the_epipolar_plane() -> None:
    rng = np.random.default_rng(3)
    centres = np.linspace(-0.2, 0.2, 7)[:, None] * np.array([1.0, 0, 0])
    centre = np.array([0.02, 0.03, 0.6])
    tilt = rng.uniform(0.0, 0.1, 50)
    normal = np.stack([np.zeros(50), np.cos(tilt), -np.sin(tilt)], axis=1)
    height = normal @ centre  # of the sphere's centre above each plane through the line of centres
    section = np.sqrt(0.04**2 - height**2)
    across = np.cross(normal, [1.0, 0, 0])
    rays = np.empty((50, 7, 3))
    for i in range(50):
        planar = np.stack([centres[:, 0], np.zeros(7)], axis=1)
        p0 = np.array([centre[0], centre @ across[i]])
        rays[i] = tangents(planar, p0, section[i], 1 if p0[1] > 0 else -1) @ np.array(
            [[1.0, 0, 0], across[i]]
        )
    circle = osculating_circle(centres, rays, 1e-4)
    np.testing.assert_allclose(np.abs(circle.radius), section, atol=1e-9)


@pytest.mark.parametrize("views", [3, 8])
def test_gradient_against_finite_differences(views: int) -> None:
    centres = np.zeros((views, 3))
    centres[:, 0] = np.linspace(-0.15, 0.15, views)
    rays = np.zeros((views, 3))
    rays[:, :2] = tangents(centres[:, :2], np.array([0.01, 0.5]), 0.04, -1)
    sigma = np.linspace(1e-4, 2e-4, views)
    circle = osculating_circle(centres, rays, sigma)
    step = 1e-6
    for i in range(views):
        moved = [
            centres + sign * step * circle.normals[i] * (np.arange(views) == i)[:, None] for sign in (1, -1)
        ]
        numeric = np.subtract(*(osculating_circle(c, rays, sigma).radius for c in moved)) / (2 * step)
        assert numeric == pytest.approx(circle.radius_gradient[i], rel=2e-4, abs=1e-4)


@pytest.mark.parametrize("views, baseline, distance", [(3, 0.1, 0.5), (15, 0.4, 0.6)])
def test_sigma_by_monte_carlo(views: int, baseline: float, distance: float) -> None:
    rng = np.random.default_rng(11)
    trials = 20_000
    centres = np.zeros((views, 3))
    centres[:, 0] = np.linspace(-0.5, 0.5, views) * baseline
    exact = tangents(centres[:, :2], np.array([0.02, distance]), 0.04, -1)
    sigma = rng.uniform(0.5, 1.5, views) * 2e-5
    angle = np.arctan2(exact[:, 1], exact[:, 0]) + sigma * rng.normal(size=(trials, views))
    rays = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=-1)
    circle = osculating_circle(centres, rays, sigma)
    normalised = (circle.radius - 0.04) / circle.sigma_radius
    # standard error of a variance from n samples: sqrt(2 / n); five of them
    assert np.mean(normalised**2) == pytest.approx(1, abs=5 * np.sqrt(2 / trials) + 0.01)
    coverage = np.mean(np.abs(normalised) < 1.96)
    assert coverage == pytest.approx(0.95, abs=5 * np.sqrt(0.05 * 0.95 / trials))
    across = np.sum((circle.points[:, 0] - circle.points[:, 0].mean(axis=0)) * circle.normals[:, 0], axis=1)
    assert across.std() == pytest.approx(circle.sigma_across.mean(), rel=0.05)


def test_theory_of_the_design_table() -> None:
    """sd of R with known poses: 15.4 mm for 3 views over 100 mm at 500 mm, 1.12 mm for 15 over 400 mm at 600 mm."""
    for views, baseline, distance, expected in (
        (3, 0.1, 0.5, 15.4e-3),
        (15, 0.4, 0.6, 1.12e-3),
        (60, 0.8, 1.0, 0.75e-3),
    ):
        centres = np.zeros((views, 3))
        centres[:, 0] = np.linspace(-0.5, 0.5, views) * baseline
        rays = np.zeros((views, 3))
        rays[:, :2] = tangents(centres[:, :2], np.array([0.0, distance]), 0.04, -1)
        assert osculating_circle(centres, rays, 0.1 / 800).sigma_radius == pytest.approx(expected, rel=0.03)


def test_ray_of_infinite_sigma_is_left_out() -> None:
    centres = np.zeros((5, 3))
    centres[:, 0] = np.linspace(-0.1, 0.1, 5)
    rays = np.zeros((5, 3))
    rays[:, :2] = tangents(centres[:, :2], np.array([0.0, 0.5]), 0.04, 1)
    sigma = np.array([1e-4, 1e-4, np.inf, 1e-4, 1e-4])
    spoilt = rays.copy()
    spoilt[2] = [0.02, 0.9998, 0]
    spoilt[2] /= np.linalg.norm(spoilt[2])
    assert osculating_circle(centres, spoilt, sigma).radius == pytest.approx(-0.04, abs=1e-9)


@pytest.mark.parametrize("what", ["no baseline", "parallel rays", "behind", "nan"])
def test_degenerate_rows_are_invalid(what: str) -> None:
    centres = np.repeat(np.array([[-0.05, 0, 0], [0, 0, 0], [0.05, 0, 0]])[None], 2, axis=0)
    rays = np.array([0.02, 0.01, 0.5]) - centres
    if what == "no baseline":
        centres[1] = centres[1, :1]
        rays[1] = rays[1, :1]
    elif what == "parallel rays":
        rays[1] = [0, 0, 1]
    elif what == "behind":
        rays[1] *= -1
    else:
        rays[1, 1, 0] = np.nan
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    circle = osculating_circle(centres, rays, 1e-4)
    np.testing.assert_array_equal(circle.valid, [True, False])
    assert np.isinf(circle.sigma_radius[1])
    assert np.all(np.isfinite(circle.radius)) and np.all(np.isfinite(circle.points))


def test_errors_name_what_is_wrong() -> None:
    with pytest.raises(DegenerateGeometry, match="2 views"):
        osculating_circle(np.zeros((2, 3)), np.ones((2, 3)))
    with pytest.raises(InvalidInput, match="accepted"):
        osculating_circle(np.zeros((4, 3)), np.ones((3, 3)))
    with pytest.raises(InvalidInput, match="positive"):
        osculating_circle(np.eye(3), np.ones((3, 3)), np.zeros(3))
    with pytest.raises(InvalidInput, match="fit"):
        osculating_circle(np.zeros((5, 3, 3)), np.ones((4, 3, 3)))


def test_batches_broadcast_and_blocks_agree() -> None:
    rng = np.random.default_rng(5)
    centres = np.array([[-0.05, 0, 0], [0, 0.01, 0], [0.05, 0, 0.0]])
    points = rng.uniform([-0.1, -0.1, 0.4], [0.1, 0.1, 0.6], (20_000, 1, 3))
    rays = points - centres
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    together = osculating_circle(centres, rays.reshape(100, 200, 3, 3), 1e-4)
    assert together.radius.shape == (100, 200) and together.normals.shape == (100, 200, 3, 3)
    apart = osculating_circle(centres, rays[12_345], 1e-4)
    assert together.radius.ravel()[12_345] == apart.radius


def test_general_motion_converges_by_the_trinocular_approximation() -> None:
    """Three views on a curved path around a sphere: the error falls as the path shrinks (Vaillant and Faugeras)."""
    centre, radius = np.array([0.0, 0.0, 0.6]), 0.04
    errors = []
    for scale in (0.1, 0.05, 0.025):
        x = scale * np.array([-0.5, 0.0, 0.5])
        centres = np.stack([x, 4 * x**2 + x**3, x**2], axis=1)
        # limb points whose rays meet the plane of the first two centres and the first ray where the surface does
        plane = np.cross(
            centres[1] - centres[0], _limb(centres[0], centre, radius, np.array([0, 1.0, 0.02])) - centres[0]
        )
        plane /= np.linalg.norm(plane)
        points = np.array([_limb(v, centre, radius, plane, centres[0]) for v in centres])
        rays = points - centres
        circle = osculating_circle(centres, rays / np.linalg.norm(rays, axis=1, keepdims=True), 1e-4)
        section = np.sqrt(radius**2 - (plane @ (centre - centres[0])) ** 2)
        errors.append(abs(abs(float(circle.radius)) - section))
    assert errors[0] < 0.15 * radius
    assert errors[2] < 0.5 * errors[0]


def _limb(v: Array, centre: Array, radius: float, plane: Array, through: Array | None = None) -> Array:
    """Contour point of a sphere, on the +x side, as seen from v: in the plane with that normal through a point (or v)."""
    through = v if through is None else through
    p = centre + np.array([radius, 0.0, 0.0])
    for _ in range(50):
        away = p - centre
        value = np.array([away @ away - radius**2, away @ (p - v), plane @ (p - through)])
        p = p - np.linalg.solve(np.stack([2 * away, away + p - v, plane]), value)
    return p
