"""Support functions against the curves that they describe."""

import re

import numpy as np
import pytest
from jacobian import numeric_jacobian
from scipy.integrate import quad_vec

from extremal.estimator import InvalidInput
from extremal.estimator.camera import Array
from extremal.estimator.support import MOST, Features, Points, Sections

ANGLES = np.array([-2.9, -1.2, -0.3, -1e-3, 0.0, 1e-6, 0.2, 0.9, 2.5])


def one(kind: type[Features], order: int) -> Features:
    """One feature at the origin, in a frame that is the world."""
    normals = np.tile([1.0, 0.0, 0.0], (1, 1, len(ANGLES), 1))
    return kind(normals, np.ones((1, 1, len(ANGLES))), np.zeros((1, 3)), np.eye(3)[None], np.array([order]))


def normals_at(angles: Array, rng: np.random.Generator) -> Array:
    """(1, 1, V, 3) normals of any length, at angles in the plane and tilted out of it."""
    length, tilt = rng.uniform(0.3, 1.5, len(angles)), rng.uniform(-1, 1, len(angles))
    return np.stack([length * np.cos(angles), length * np.sin(angles), tilt], axis=-1)[None, None]


def supports(feature: Features, normals: Array, theta: Array) -> Array:
    return feature.columns(normals)[0, 0] @ theta


@pytest.mark.parametrize(
    "kind, order", [(Sections, 2), (Sections, 3), (Sections, 4), (Sections, 5), (Points, 3)]
)
def test_contact_is_the_gradient_of_the_support(kind: type[Features], order: int) -> None:
    rng = np.random.default_rng(order)
    feature, theta = one(kind, order), rng.normal(size=order)
    for angle in ANGLES:
        n = normals_at(np.array([angle]), rng)

        def support(n: Array) -> Array:
            return supports(feature, n[None, None, None], theta)

        contact = feature.contact(n, theta[None])[0, 0, 0]
        np.testing.assert_allclose(contact, numeric_jacobian(support, n[0, 0, 0])[0], atol=1e-8)
        assert support(n[0, 0, 0]) == pytest.approx(float(contact @ n[0, 0, 0]), abs=1e-12)


def test_a_circle_is_of_order_three() -> None:
    """h(n) = p0 . n + R |n| in the plane: whatever the tilt, the plane's line in the section touches the circle."""
    n = normals_at(ANGLES, np.random.default_rng(0))
    centre, radius = np.array([0.03, -0.2, 0.0]), -0.04
    h = n[0, 0] @ centre + radius * np.hypot(n[0, 0, :, 0], n[0, 0, :, 1])
    theta = np.array([centre[0] + radius, centre[1], radius])  # the contact point at phi = 0, and R
    np.testing.assert_allclose(supports(one(Sections, 3), n, theta), h, atol=1e-15)
    towards = n[0, 0, :, :2] / np.hypot(n[0, 0, :, 0], n[0, 0, :, 1])[:, None]
    contact = one(Sections, 3).contact(n, theta[None])[0, 0]
    np.testing.assert_allclose(contact[:, :2], centre[:2] + radius * towards, atol=1e-15)


def test_a_straight_line_is_of_order_two_and_a_point_of_order_three() -> None:
    rng = np.random.default_rng(1)
    place, line = np.array([0.3, -0.1, 0.0]), np.array([0.4, -0.2, 1.0])
    through = np.cross(line, rng.normal(size=(len(ANGLES), 3)))[None, None]
    np.testing.assert_allclose(
        supports(one(Sections, 2), through, place[:2]), through[0, 0] @ place, atol=1e-15
    )
    point, normals = rng.normal(size=3), rng.normal(size=(1, 1, len(ANGLES), 3))
    np.testing.assert_allclose(supports(one(Points, 3), normals, point), normals[0, 0] @ point, atol=1e-15)


@pytest.mark.parametrize("order", [4, 5])
def test_radii_of_curvature_that_vary(order: int) -> None:
    """The curve is integrated from its radius of curvature: dr = rho (-sin phi, cos phi) dphi."""
    theta = np.array([0.02, -0.1, 0.04, 0.03, -0.05])[:order]
    a, b = theta[3], theta[4] if order == 5 else 0.0

    def speed(phi: float) -> Array:
        return (theta[2] + a * phi + b * phi**2 / 2) * np.array([-np.sin(phi), np.cos(phi)])

    curve = np.array([theta[:2] + quad_vec(speed, 0, phi, epsabs=1e-14)[0] for phi in ANGLES])
    n = np.stack([np.cos(ANGLES), np.sin(ANGLES), 0 * ANGLES], axis=-1)[None, None]
    feature = one(Sections, order)
    np.testing.assert_allclose(feature.contact(n, theta[None])[0, 0, :, :2], curve, atol=1e-12)
    np.testing.assert_allclose(
        supports(feature, n, theta), np.sum(curve * n[0, 0, :, :2], axis=1), atol=1e-12
    )


def test_columns_beyond_the_order_are_zero() -> None:
    mixed = Sections(
        np.tile([1.0, 0.0, 0.0], (4, 1, 3, 1)),
        np.ones((4, 1, 3)),
        np.zeros((4, 3)),
        np.tile(np.eye(3), (4, 1, 1)),
        np.array([2, 3, 4, 5]),
    )
    columns = mixed.columns(np.random.default_rng(2).normal(size=(4, 1, 3, 3)))
    assert columns.shape == (4, 1, 3, MOST)
    for row, order in enumerate((2, 3, 4, 5)):
        assert np.all(columns[row, ..., order:] == 0) and np.all(columns[row, ..., :order] != 0)
    part = mixed.take(np.array([1, 0]))
    assert part.width == 3 and len(part) == 2 and isinstance(part, Sections)


@pytest.mark.parametrize(
    "change, message",
    [
        ({"order": np.array([1])}, "order of a section is [1]"),
        ({"order": np.array([6])}, "accepted: 2 to 5"),
        ({"sigma": np.zeros((1, 1, 2))}, "must be positive"),
        ({"sigma": np.full((1, 1, 2), np.nan)}, "must be positive"),
        ({"origin": np.full((1, 3), np.nan)}, "origin"),
        ({"normals": np.full((1, 1, 2, 3), np.inf)}, "normals"),
        ({"frame": np.eye(3)}, "don't fit"),
        ({"order": np.array([3, 3])}, "don't fit"),
    ],
)
def test_what_is_refused(change: dict[str, np.ndarray], message: str) -> None:
    values = {
        "normals": np.tile([1.0, 0.0, 0.0], (1, 1, 2, 1)),
        "sigma": np.ones((1, 1, 2)),
        "origin": np.zeros((1, 3)),
        "frame": np.eye(3)[None],
        "order": np.array([3]),
    }
    with pytest.raises(InvalidInput, match=re.escape(message)):
        Sections(**(values | change))
