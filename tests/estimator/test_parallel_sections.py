"""Parallel sections: their terms, the feet of edgels, and the Jacobian of the signed image distance."""

import numpy as np
from jacobian import assert_jacobian

from extremal.estimator.camera import Array
from extremal.estimator.parallel_sections import (
    Edgels,
    contact_point,
    feet,
    image_distance,
    jet,
    kernels,
)


def test_kernels_are_each_others_derivatives() -> None:
    phi = np.array([1e-3, -0.2, 0.7])
    K = kernels(phi, 5)  # from index -2
    np.testing.assert_allclose(
        K[:, 2:5], np.stack([np.cos(phi), np.sin(phi), 1 - np.cos(phi)], axis=1), atol=1e-15
    )
    slope = (kernels(phi + 1e-5, 5) - kernels(phi - 1e-5, 5)) / 2e-5
    np.testing.assert_allclose(slope[:, 1:], K[:, :-1], atol=1e-9)


def model(rng: np.random.Generator, count: int = 12) -> tuple[Array, Edgels, Array, Array]:
    """A surface of order 4, and edgels a little off its apparent contours: terms (1, P), edgels (1, M), phi, x (1, M)."""
    terms = np.array([[0.001, -0.002, 0.02, 0.04, 0.3, -8.0, 0.01, 0.2, 20.0, 200.0, *np.full(5, 0.02)]])
    phi, x = rng.uniform(-0.3, 0.3, (1, count)), rng.uniform(-0.01, 0.01, (1, count))
    j = jet(terms, phi, x, 4)
    n = np.stack([np.cos(phi), np.sin(phi), -j.x], axis=-1)
    towards = np.cross(n, [0.0, 0.1, 1.0])
    towards /= -np.linalg.norm(towards, axis=-1, keepdims=True)
    ray = towards + 2e-4 * rng.normal(size=towards.shape)
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    centres = contact_point(j, phi, x) - 0.5 * towards
    return terms, Edgels(centres, ray, np.ones((1, count))), phi, x


def test_feet_are_the_nearest_points_of_the_predicted_contours() -> None:
    rng = np.random.default_rng(1)
    terms, edgels, phi, x = model(rng)
    phi, x = feet(terms, 4, edgels, phi, x)
    error, _ = image_distance(terms, 4, edgels, phi, x)
    for step in (-1e-4, 1e-4):  # neighbours on the contour: x moves, phi follows such that n . d = 0
        moved = x + step
        angle = phi
        for _ in range(20):
            j = jet(terms, angle, moved, 4)
            d = contact_point(j, angle, moved) - edgels.centres
            n, n_phi = (
                np.stack([np.cos(angle), np.sin(angle), -j.x], axis=-1),
                np.stack([-np.sin(angle), np.cos(angle), -j.px], axis=-1),
            )
            angle = angle - np.sum(n * d, -1) / np.sum(n_phi * d, -1)
        d = contact_point(jet(terms, angle, moved, 4), angle, moved) - edgels.centres
        away = np.linalg.norm(np.cross(edgels.rays, d), axis=-1) / np.linalg.norm(d, axis=-1)
        assert np.all(np.arcsin(away) > np.abs(error))


def test_jacobian_of_the_signed_image_distance() -> None:
    terms, edgels, phi, x = model(np.random.default_rng(2))
    phi, x = feet(terms, 4, edgels, phi, x)
    _, J = image_distance(terms, 4, edgels, phi, x)
    scale = 1e-5 / np.abs(J[0]).max(axis=0)

    def distance(t: Array) -> Array:
        t = t[None]
        return image_distance(t, 4, edgels, *feet(t, 4, edgels, phi, x))[0][0]

    assert_jacobian(distance, J[0], terms[0], rtol=1e-6, step=scale)
