"""Motions and features that leave shape open end in infinite sigma or a clear error, never in a confident wrong number."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from extremal.estimator import InvalidInput
from extremal.estimator.adjustment import Adjustment, adjust
from extremal.estimator.camera import Array
from extremal.estimator.poses import PosePrior
from extremal.estimator.support import Features, Sections
from extremal.scripts.synthetic import TangentScene, observe
from extremal.sim import fixating

VIEWS = 9
EDGE = 1e-4  # [rad]


def along(direction: Array, length: float) -> Array:
    return np.array([-0.6, 0.0, 0.0]) + length * np.linspace(-0.5, 0.5, VIEWS)[:, None] * direction


MOTIONS: dict[str, Array] = {
    "pure rotation, or all views equal": along(np.array([0.0, 1.0, 0.0]), 1e-9),
    "less than the poses' errors": along(np.array([0.0, 1.0, 0.0]), 1e-3),
    "along the ray": along(np.array([1.0, 0.0, 0.0]), 0.2),
}


def scene(centres: Array) -> TangentScene:
    """A circle that is touched at about the origin, lines and points around, in the cameras' plane."""
    rng = np.random.default_rng(0)
    n = 7
    middles = np.concatenate([[[0.0, -0.04, 0.0]], rng.uniform(-0.1, 0.1, (n - 1, 3)) * (1, 1, 0)])
    poses = fixating(centres, np.zeros(3))
    radii = np.array([0.04, *np.zeros(n - 1)])
    return TangentScene(
        poses, middles, radii, np.zeros(n), np.tile([0.0, 0, 1], (n, 1)), rng.uniform(-0.1, 0.1, (5, 3))
    )


def uncertain(T: RigidTransform, sigma: float = 1e-3) -> PosePrior:
    return PosePrior(T, np.tile(sigma * np.eye(6), (len(T), 1, 1)))


def check_numbers(found: Adjustment) -> None:
    """No NaN anywhere; what is not valid has infinite sigma."""
    assert np.all(np.isfinite(found.T_world_camera.as_matrix())) and np.all(np.isfinite(found.u))
    assert not np.any(np.isnan(found.pose_covariance))
    for shape in found.shapes:
        for name in ("theta", "radius", "shared", "residuals"):
            assert np.all(np.isfinite(getattr(shape, name))), name
        for values in (shape.sigma_radius, shape.own_variance, shape.covariance):
            assert not np.any(np.isnan(values))
            assert np.all(np.isinf(values[~shape.valid]))


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("sigma", [1e-3, 1e-6, 0.0])
def test_motions_that_show_no_shape(motion: str, sigma: float) -> None:
    """Without parallax, only errors of the poses pretend that there was some: no radius is known to better than 0.2 m."""
    there = scene(along(np.array([0.0, 1.0, 0.0]), 1e-9) if motion == "along the ray" else MOTIONS[motion])
    if motion == "along the ray":
        there = scene(MOTIONS[motion] * (1, 1, 1) + (0, 1e-9, 0) * np.arange(VIEWS)[:, None])
    for seed in range(5):
        prior = uncertain(there.T_world_camera, sigma)
        seen = observe(there, prior if sigma else exact(there), EDGE, np.random.default_rng(seed))
        found = adjust(seen.prior, seen.features)
        check_numbers(found)
        radius = found.shapes[0].sigma_radius[0]
        assert radius > 0.2, radius


def exact(there: TangentScene) -> PosePrior:
    return PosePrior(there.T_world_camera, np.zeros((VIEWS, 6, 0)))


def seen_by_some(features: Features, views: int) -> Features:
    sigma = features.sigma.copy()
    sigma[..., views:] = np.inf
    return replace(features, sigma=sigma)


@pytest.mark.parametrize("views", [0, 1, 2])
def test_features_in_too_few_views(views: int) -> None:
    """A contour that two views show has no radius, and does not disturb what others show."""
    there = scene(along(np.array([0.0, 1.0, 0.0]), 0.4))
    seen = observe(there, uncertain(there.T_world_camera), EDGE, np.random.default_rng(1))
    sections, points = seen.features
    first, rest = sections.take(np.array([0])), sections.take(np.arange(1, 7))
    alone = adjust(seen.prior, [rest, points])
    found = adjust(seen.prior, [seen_by_some(first, views), rest, points])
    check_numbers(found)
    assert not found.shapes[0].valid.any() and found.shapes[1].valid.all()
    np.testing.assert_allclose(found.u, alone.u, atol=1e-6)
    np.testing.assert_allclose(found.shapes[1].sigma_radius, alone.shapes[0].sigma_radius, rtol=1e-6)


def test_two_views_alone() -> None:
    there = scene(along(np.array([0.0, 1.0, 0.0]), 0.4)[[0, -1]])
    seen = observe(there, uncertain(there.T_world_camera), EDGE, np.random.default_rng(2))
    found = adjust(seen.prior, seen.features)
    check_numbers(found)
    assert found.converged and not found.shapes[0].valid.any() and found.shapes[1].valid.all()


@pytest.mark.parametrize("behind", [1, 7])
def test_contacts_behind_the_cameras(behind: int) -> None:
    """Planes that touch behind the cameras belong to no feature that they see: the first ones, or all."""
    there = scene(along(np.array([0.0, 1.0, 0.0]), 0.4))
    middles = there.centres.copy()
    middles[:behind, 0] -= 1.2
    there = replace(there, centres=middles)
    seen = observe(there, uncertain(there.T_world_camera), EDGE, np.random.default_rng(3))
    found = adjust(seen.prior, seen.features[:1])
    check_numbers(found)
    assert not found.shapes[0].valid[:behind].any()


def test_wild_planes_beside_good_ones() -> None:
    """Two features whose planes are noise may cost the others their sigma, but never leave a confident wrong number."""
    there = scene(along(np.array([0.0, 1.0, 0.0]), 0.4))
    trials, z = 12, []
    for seed in range(trials):
        rng = np.random.default_rng(seed)
        seen = observe(there, uncertain(there.T_world_camera), EDGE, rng)
        sections, points = seen.features
        wild = sections.take(np.array([1, 2]))
        normals = rng.normal(size=wild.normals.shape)
        wild = replace(wild, normals=normals / np.linalg.norm(normals, axis=-1, keepdims=True))
        found = adjust(seen.prior, [wild, sections.take(np.r_[0, 3:7]), points])
        check_numbers(found)
        z.append((found.shapes[1].radius[0] - 0.04) / found.shapes[1].sigma_radius[0])
    assert np.mean(np.square(z)) < 1 + 4 * np.sqrt(2 / trials)


REFUSED: dict[str, tuple[Callable[[Sections], list[Features]], float, str]] = {
    "no sets": (lambda f: [], 1.0, "no features"),
    "empty sets": (lambda f: [f.take(np.arange(0))], 1.0, "no features"),
    "other views": (lambda f: [f.take(np.arange(2)), cut(f)], 1.0, "features are seen in 8 views"),
    "overlap": (lambda f: [f], 0.5, "overlap is 0.5"),
    "overlap that is no number": (lambda f: [f], np.nan, "overlap is nan"),
}


def cut(features: Sections) -> Sections:
    return replace(features, normals=features.normals[:, :, :-1], sigma=features.sigma[:, :, :-1])


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_refused(name: str) -> None:
    there = scene(along(np.array([0.0, 1.0, 0.0]), 0.4))
    seen = observe(there, uncertain(there.T_world_camera), EDGE, np.random.default_rng(5))
    sections = seen.features[0]
    assert isinstance(sections, Sections)
    features, overlap, message = REFUSED[name]
    with pytest.raises(InvalidInput, match=message):
        adjust(seen.prior, features(sections), overlap)


def test_an_empty_set_beside_another() -> None:
    there = scene(along(np.array([0.0, 1.0, 0.0]), 0.4))
    seen = observe(there, uncertain(there.T_world_camera), EDGE, np.random.default_rng(6))
    sections, points = seen.features
    found = adjust(seen.prior, [sections, points.take(np.arange(0))])
    assert found.converged and found.shapes[0].valid.all() and len(found.shapes[1].valid) == 0
