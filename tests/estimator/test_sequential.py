"""Shape view by view from rendered views: against the batch, and for what it does with little or bad input."""

from dataclasses import replace

import numpy as np
import pytest

from extremal.estimator import Camera, DegenerateGeometry, InvalidInput, View, estimate_shape
from extremal.estimator.poses import pose_exp
from extremal.estimator.references import bootstrap
from extremal.estimator.sequential import LiveShape, SequentialShape
from extremal.scenes import load_scene
from extremal.sim import LinearMotion, record

CAMERA = Camera(width=320, height=240, fx=400.0, fy=400.0)
CENTRE, RADIUS = np.array([0.0, 0.0, 0.05]), 0.05  # [m] of the preset's sphere
POSE = 5e-4  # [m], [rad]


@pytest.fixture(scope="module")
def views() -> tuple[View, ...]:
    motion = LinearMotion(views=13, baseline=0.3, distance=0.5)
    return record(
        load_scene("sphere"), CAMERA, motion, "preview", rng=np.random.default_rng(1), workers=1
    ).views


@pytest.fixture(scope="module")
def noisy(views: tuple[View, ...]) -> list[View]:
    rng = np.random.default_rng(2)
    covariance = POSE**2 * np.eye(6)
    return [
        replace(
            v,
            T_world_camera=v.T_world_camera * pose_exp(POSE * rng.standard_normal(6)),
            pose_covariance=covariance,
        )
        for v in views
    ]


def followed(views: list[View] | tuple[View, ...]) -> SequentialShape:
    track = SequentialShape()
    for view in views:
        track.update(view)
    return track


def on_the_limb(shape: LiveShape) -> np.ndarray:
    off = np.linalg.norm(shape.position - CENTRE, axis=1) - RADIUS
    return shape.extremal & np.isfinite(shape.sigma_radius) & (np.abs(off) < 0.005)


def test_the_limb_of_a_sphere(views: tuple[View, ...]) -> None:
    shape = followed(views).shape()
    limb = on_the_limb(shape)
    assert limb.sum() >= 20
    assert set(np.sign(shape.radius[limb])) == {-1, 1}
    off = np.linalg.norm(shape.position[limb] - CENTRE, axis=1) - RADIUS
    assert abs(np.median(off)) < 5e-4
    assert np.all(np.abs(shape.radius[limb]) < RADIUS + 4 * shape.sigma_radius[limb] + 0.002)
    assert np.median(shape.sigma_radius[limb]) < 2e-3
    batch = estimate_shape(views, estimator="circle")
    assert limb.sum() > 0.7 * np.sum(
        batch.extremal & (np.abs(np.linalg.norm(batch.position - CENTRE, axis=1) - RADIUS) < 0.005)
    )


def test_what_is_given_fits_together(noisy: list[View]) -> None:
    track = followed(noisy)
    shape = track.shape()
    n = len(shape.radius)
    assert n > 60 and shape.pixels.shape == (n, 2) and shape.covariance.shape == (n, 3, 3)
    assert shape.views.max() <= len(noisy)
    known = np.isfinite(shape.sigma_radius)
    assert known.mean() > 0.5
    assert np.all(np.isfinite(shape.covariance[known])) and np.all(np.isinf(shape.covariance[~known]))
    assert np.all(np.linalg.eigvalsh(shape.covariance[known])[:, 0] > -1e-12)
    assert not shape.extremal[~known].any()


def test_poses_are_adjusted_on_the_way(views: tuple[View, ...], noisy: list[View]) -> None:
    """The latest pose is nearer to the truth than the robot believed, and as near as it says."""
    nearer = []
    for count in range(9, 14):
        shape = followed(noisy[:count]).shape()
        believed, true = noisy[count - 1].T_world_camera, views[count - 1].T_world_camera
        missed = (shape.T_world_camera.inv() * true).as_exp_coords()
        nearer.append(
            np.linalg.norm(missed) / np.linalg.norm((believed.inv() * true).as_exp_coords()),
        )
        z = np.concatenate([missed[3:], missed[:3]])
        assert z @ np.linalg.solve(shape.pose_covariance, z) < 30  # 6 degrees of freedom
    assert np.median(nearer) < 1


def test_references_settle_the_radii(noisy: list[View]) -> None:
    track = followed(noisy)
    free = track.shape()
    found = bootstrap(free.radius, free.own_variance, free.shared, free.contour, 0.5, 3.0)
    assert found.fixed.any()
    track.fixed = found.fixed
    held = track.shape()
    known = np.isfinite(free.sigma_radius) & ~found.fixed
    assert np.all(held.sigma_radius[known] < 1.001 * free.sigma_radius[known])
    assert np.median(held.sigma_radius[known] / free.sigma_radius[known]) < 0.9


def test_before_there_are_tracks(views: tuple[View, ...]) -> None:
    track = SequentialShape()
    for _ in range(7):
        track.update(views[0])  # no baseline
    assert not track.started
    with pytest.raises(DegenerateGeometry, match=r"1 view.*tracks start with 5 views"):
        track.shape()
    with pytest.raises(DegenerateGeometry, match="tracks start"):
        _ = track.fixed
    for view in views[1:]:
        track.update(view)
    assert on_the_limb(track.shape()).sum() > 10
    with pytest.raises(InvalidInput, match=r"start is 2.*from 3 views"):
        SequentialShape(start=2)


@pytest.mark.parametrize("blank", [range(13), range(5, 13), [8]])
def test_blank_images(views: tuple[View, ...], blank: range | list[int]) -> None:
    given = [replace(v, image=np.full_like(v.image, 128)) if i in blank else v for i, v in enumerate(views)]
    shape = followed(given).shape()
    assert len(shape.radius) == 0 if 0 in blank else len(shape.radius) > 30
    assert shape.views.max(initial=0) <= 13 - len(blank)


def test_same_views_same_shape(noisy: list[View]) -> None:
    one, two = followed(noisy[:8]).shape(), followed(noisy[:8]).shape()
    np.testing.assert_array_equal(one.radius, two.radius)
    np.testing.assert_array_equal(one.pixels, two.pixels)
