"""Second-order shape of fixed features, for motions that do not determine it, and for edgels of no surface."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from extremal.estimator import DegenerateGeometry, InvalidInput
from extremal.estimator.camera import Array
from extremal.estimator.second_order import SecondOrderShape, second_order_shape
from extremal.estimator.tangent_planes import TangentPlanes, surroundings

SIGMA = 6e-5  # [rad]: 0.05 px at f = 800 px


def arc(turn: float, views: int = 25, distance: float = 0.55) -> Array:
    """Camera centres (V, 3) on an arc of half-angle `turn` [rad] that also leaves its plane."""
    u = np.linspace(-1, 1, views)
    azimuth, elevation = turn * u, 0.2 + 0.3 * turn * np.sin(3 * u)
    direction = [-np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    return distance * np.stack(direction, axis=1)


def bundle(
    points: Array, tangents: Array, centres: Array, along: Array, rng: np.random.Generator
) -> tuple[Array, Array, Array, Array]:
    """Edgels of a fixed curve through `points` (M, 3) with tangents, seen from every centre, with noise."""
    v = np.repeat(centres, len(points), axis=0)
    x, t = np.tile(points, (len(centres), 1)), np.tile(tangents, (len(centres), 1))
    p = x - v
    p /= np.linalg.norm(p, axis=1, keepdims=True)
    n = np.cross(p, t)
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    p = p + SIGMA * rng.normal(size=(len(p), 1)) * n
    p /= np.linalg.norm(p, axis=1, keepdims=True)
    n = np.cross(p, t)
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    first = len(centres) // 2 * len(points) + int(np.argmin(np.abs(along)))
    order = np.concatenate([[first], np.delete(np.arange(len(p)), first)])
    return v[order], p[order], n[order], np.full(len(p), SIGMA)


def fixed_curve(bend: float, rng: np.random.Generator, centres: Array | None = None) -> SecondOrderShape:
    """A fixed curve of curvature `bend` [1/m] in a tilted plane, through the origin."""
    s = np.linspace(-0.02, 0.02, 11)
    turn = Rotation.from_rotvec([0.3, 0.2, -0.1])
    points = turn.apply(np.stack([0.5 * bend * s**2, 0 * s, s], axis=1))
    tangents = turn.apply(np.stack([bend * s, 0 * s, 1 + 0 * s], axis=1))
    return second_order_shape(*bundle(points, tangents, arc(0.35) if centres is None else centres, s, rng))


@pytest.mark.parametrize("bend", [0.0, 8.0])
def test_fixed_curves(bend: float) -> None:
    shape = fixed_curve(bend, np.random.default_rng(3))
    assert shape.valid
    assert shape.kind == "fixed curve"
    assert abs(shape.ray_radius) < 3 * np.sqrt(shape.covariance[3, 3]) < 3e-3
    assert np.linalg.norm(shape.position) < 5e-4
    if bend:  # rank one: no radius across the curve, a finite one along it
        assert np.abs(shape.principal_radii).min() < 3e-3
        assert np.abs(shape.principal_radii).max() > 0.03


def test_one_edgel_a_view_leaves_the_contour_open() -> None:
    """A straight edge or a dot on a curve, followed through the views: the section is known, the rest is not."""
    rng = np.random.default_rng(4)
    centres = arc(0.35)
    shape = second_order_shape(*bundle(np.zeros((1, 3)), np.array([[0, 0, 1.0]]), centres, np.zeros(1), rng))
    assert shape.valid
    assert shape.kind == "fixed curve"
    assert np.isinf(shape.covariance[5, 5])
    assert np.isinf(shape.sigma_gaussian)
    assert np.isinf(shape.sigma_radii).all()
    assert np.linalg.norm(shape.position) < 3e-4


def test_fixed_point() -> None:
    """Edges of several directions end in it."""
    rng = np.random.default_rng(5)
    angle = np.linspace(-0.5, 0.5, 5)
    tangents = np.stack([0 * angle, np.sin(angle), np.cos(angle)], axis=1)
    shape = second_order_shape(*bundle(np.zeros((5, 3)), tangents, arc(0.35), angle, rng))
    assert shape.kind == "fixed point"
    assert np.linalg.norm(shape.position) < 3e-4
    assert np.isinf(shape.sigma_radii).all()


# Motions that do not determine it.


def assert_undetermined(shape: SecondOrderShape) -> None:
    assert not np.any(shape.valid)
    assert np.all(shape.kind == "undetermined")
    assert np.all(np.isinf(np.diagonal(shape.covariance, axis1=-2, axis2=-1)))
    for name in ("sigma_curvatures", "sigma_radii", "sigma_gaussian", "sigma_mean"):
        assert np.all(np.isinf(getattr(shape, name)))
    for name in ("position", "principal_curvatures", "principal_radii", "gaussian", "mean"):
        assert np.all(np.isfinite(getattr(shape, name)))


def test_pure_rotation_and_equal_views() -> None:
    assert_undetermined(fixed_curve(8.0, np.random.default_rng(6), np.tile(arc(0.35)[:1], (9, 1))))


def test_motion_along_the_ray() -> None:
    centres = np.linspace(0.4, 0.7, 9)[:, None] * np.array([-1.0, 0, 0])
    shape = second_order_shape(
        *bundle(np.zeros((1, 3)), np.array([[0, 0, 1.0]]), centres, np.zeros(1), np.random.default_rng(7))
    )
    assert_undetermined(shape)


def test_degenerate_rows_leave_the_others_alone() -> None:
    rng = np.random.default_rng(8)
    points, tangents, along = np.zeros((1, 3)), np.array([[0, 0, 1.0]]), np.zeros(1)
    good = bundle(points, tangents, arc(0.35, 9), along, rng)
    bad = bundle(points, tangents, np.tile(arc(0.3)[:1], (9, 1)), along, rng)
    both = second_order_shape(*(np.stack(pair) for pair in zip(good, bad, strict=True)))
    alone = second_order_shape(*good)
    assert both.valid.tolist() == [True, False]
    np.testing.assert_allclose(both.position[0], alone.position, atol=1e-9)


def test_edgels_of_no_surface() -> None:
    """Planes anywhere: no row is a shape, and none is an exception or silently not a number."""
    rng = np.random.default_rng(12)
    v, p, t = rng.normal(size=(3, 20, 30, 3))
    p /= np.linalg.norm(p, axis=-1, keepdims=True)
    n = np.cross(p, t)
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    assert_undetermined(second_order_shape(v, p, n, np.full((20, 30), SIGMA)))


def test_inputs_that_are_refused() -> None:
    v, p, n, s = bundle(
        np.zeros((1, 3)), np.array([[0, 0, 1.0]]), arc(0.35, 9), np.zeros(1), np.random.default_rng(9)
    )
    with pytest.raises(DegenerateGeometry, match="6 edgels"):
        second_order_shape(v[:6], p[:6], n[:6], s[:6])
    for bad in ((v[:8], p, n, s), (v, p, n, -s), (v, 2 * p, n, s), (v, p, n * np.nan, s), (v, p, p, s)):
        with pytest.raises(InvalidInput):
            second_order_shape(*bad)
    planes = TangentPlanes(v, p, n, s)
    with pytest.raises(InvalidInput, match="depth"):
        surroundings(planes, [0], [-0.5])
    with pytest.raises(InvalidInput, match="seeds"):
        surroundings(planes, [0, 1], [0.5])
    with pytest.raises(InvalidInput, match="centres"):
        TangentPlanes(v[:3], p, n, s)
