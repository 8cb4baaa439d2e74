"""From views to shape: views of a preset, blank ones, and motions that determine nothing."""

from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np
import pytest

from extremal.estimator import Camera, DegenerateGeometry, Shape, View, estimate_shape
from extremal.scenes import load_scene
from extremal.sim import LinearMotion, record

CAMERA = Camera(width=320, height=240, fx=400.0, fy=400.0)
RADIUS = 0.05  # [m] of the preset's sphere
OF_POINTS = [f.name for f in fields(Shape) if f.name not in ("reference", "T_world_camera")]


@pytest.fixture(scope="module")
def views() -> tuple[View, ...]:
    motion = LinearMotion(views=7, baseline=0.3, distance=0.5)
    scene = load_scene("sphere")
    return record(scene, CAMERA, motion, "preview", rng=np.random.default_rng(1), workers=1).views


@pytest.fixture(scope="module")
def shape(views: tuple[View, ...]) -> Shape:
    return estimate_shape(views)


def blank(views: Sequence[View], level: int = 128) -> list[View]:
    return [replace(view, image=np.full_like(view.image, level)) for view in views]


def matched(shape: Shape, other: Shape) -> tuple[np.ndarray, np.ndarray]:
    """Whether each point of a shape is in another one too, and its index there."""
    distance = np.linalg.norm(shape.pixels[:, None] - other.pixels, axis=2)
    return distance.min(axis=1) < 1e-6, np.argmin(distance, axis=1)


def test_what_is_given_fits_together(shape: Shape, views: tuple[View, ...]) -> None:
    n = len(shape.pixels)
    assert n > 30 and shape.reference == 3
    for name in OF_POINTS:
        assert len(getattr(shape, name)) == n, name
    assert len(shape.T_world_camera) == len(views)
    for finite in (shape.radius, shape.sigma_radius, shape.position, shape.pixels, shape.rays):
        assert np.all(np.isfinite(finite))
    assert np.all(shape.sigma_radius > 0)
    np.testing.assert_array_equal(shape.extremal, shape.side != 0)
    np.testing.assert_array_equal(np.sign(shape.radius[shape.extremal]), shape.side[shape.extremal])
    np.testing.assert_array_equal(shape.gaussian_sign[~shape.extremal], 0)
    assert np.all((shape.views >= 3) & (shape.views <= len(views)))
    covariance = shape.covariance
    np.testing.assert_allclose(covariance, np.swapaxes(covariance, 1, 2), atol=1e-18)
    assert np.all(np.linalg.eigvalsh(covariance)[:, 0] > -1e-12)
    np.testing.assert_allclose(views[3].project(shape.position), shape.pixels, atol=3.0)
    np.testing.assert_allclose(np.linalg.norm(shape.tangents, axis=1), 1)


def test_the_limb_of_a_sphere(shape: Shape) -> None:
    """Contact points lie on the sphere, R is that of its section: at most the sphere's, and of both signs."""
    centre = np.array([0.0, 0.0, 0.05])
    limb = shape.extremal & (np.abs(np.linalg.norm(shape.position - centre, axis=1) - RADIUS) < 0.005)
    assert limb.sum() >= 10
    assert {-1, 1} <= set(shape.side[limb])
    off = np.linalg.norm(shape.position - centre, axis=1)[limb] - RADIUS
    assert abs(np.median(off)) < 1e-3
    assert np.all(np.abs(shape.radius[limb]) < RADIUS + 4 * shape.sigma_radius[limb] + 0.002)
    assert np.mean(shape.gaussian_sign[limb] == 1) > 0.8


@pytest.mark.parametrize("count", [0, 1, 2])
def test_too_few_views(views: tuple[View, ...], count: int) -> None:
    for given in (views[:count], blank(views[:count])):
        with pytest.raises(DegenerateGeometry, match=f"{count} view.*3"):
            estimate_shape(given)


def test_no_baseline(views: tuple[View, ...]) -> None:
    with pytest.raises(DegenerateGeometry, match="accepted: a baseline"):
        estimate_shape([views[0]] * 4)
    pose = views[3].T_world_camera
    with pytest.raises(DegenerateGeometry, match="accepted: a baseline"):
        estimate_shape([replace(view, T_world_camera=pose) for view in views])


@pytest.mark.parametrize("level", [0, 128, 255])
def test_blank_images_have_no_points(views: tuple[View, ...], level: int) -> None:
    shape = estimate_shape(blank(views, level))
    for name in OF_POINTS:
        assert len(getattr(shape, name)) == 0, name
    assert shape.pixels.shape == (0, 2) and shape.covariance.shape == (0, 3, 3)


@pytest.mark.parametrize("seen", [[], [3], [2, 3], [0, 1, 2, 4, 5, 6], [3, 4, 5]])
def test_some_blank_images(views: tuple[View, ...], seen: list[int]) -> None:
    """Points need the reference view and two more."""
    given = [view if i in seen else blank([view])[0] for i, view in enumerate(views)]
    shape = estimate_shape(given)
    if 3 not in seen or len(seen) < 3:
        assert len(shape.pixels) == 0
    else:
        assert len(shape.pixels) > 0
        assert np.all(shape.views == 3) and not shape.complete.any()


def test_nothing_but_noise_has_next_to_no_points(views: tuple[View, ...]) -> None:
    rng = np.random.default_rng(2)
    noisy = [
        replace(v, image=np.clip(rng.normal(128, 4, v.image.shape), 0, 255).astype(np.uint8)) for v in views
    ]
    assert len(estimate_shape(noisy).pixels) <= 3


def test_same_views_same_shape(shape: Shape, views: tuple[View, ...]) -> None:
    before = [view.image.copy() for view in views]
    calls: list[tuple[int, int]] = []
    again = estimate_shape(views, lambda done, total: calls.append((done, total)))
    for name in OF_POINTS:
        np.testing.assert_array_equal(getattr(again, name), getattr(shape, name), name)
    for image, view in zip(before, views, strict=True):
        np.testing.assert_array_equal(view.image, image)
    assert calls == [(i + 1, len(views)) for i in range(len(views))]


def test_uncertain_poses_widen_sigma_and_little_else(shape: Shape, views: tuple[View, ...]) -> None:
    """The same points are found, in the same order, but for few."""
    covariance = np.diag([5e-4] * 3 + [5e-4] * 3) ** 2
    uncertain = [replace(view, pose_covariance=covariance) for view in views]
    wider = estimate_shape(uncertain, estimator="circle")
    same, match = matched(shape, wider)
    assert same.mean() > 0.8
    assert np.all(np.diff(match[same]) > 0)
    np.testing.assert_array_equal(wider.contour[match[same]], shape.contour[same])
    limb = same & shape.extremal
    assert np.median(wider.sigma_radius[match[limb]] / shape.sigma_radius[limb]) > 1.5
    assert np.mean(wider.sigma_radius[match[same]] > shape.sigma_radius[same]) > 0.9
    off = np.abs(wider.radius[match[limb]] - shape.radius[limb])
    assert np.median(off / wider.sigma_radius[match[limb]]) < 1


def test_a_motion_backwards(shape: Shape, views: tuple[View, ...]) -> None:
    """Views in reverse order give the same points, with the opposite sign of R."""
    back = estimate_shape(views[::-1])
    same, match = matched(shape, back)
    same &= shape.extremal
    assert same.sum() > 0.8 * shape.extremal.sum()
    close = np.abs(back.radius[match[same]] + shape.radius[same]) < 0.5 * shape.sigma_radius[same] + 1e-6
    assert close.mean() > 0.9
    assert np.mean(back.side[match[same]] == -shape.side[same]) > 0.9


def test_colour_views(shape: Shape, views: tuple[View, ...]) -> None:
    colour = estimate_shape([replace(view, image=np.stack([view.image] * 3, axis=2)) for view in views])
    assert len(colour.pixels) == pytest.approx(len(shape.pixels), rel=0.05)
    np.testing.assert_allclose(np.median(np.abs(colour.radius)), np.median(np.abs(shape.radius)), atol=1e-3)
