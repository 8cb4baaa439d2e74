"""Arcs alone: level sections of ellipsoids, whose tangents from cameras on a line are known in closed form."""

from collections.abc import Callable

import numpy as np
import pytest

from extremal.estimator import InvalidInput
from extremal.estimator.camera import Array
from extremal.estimator.strip_arcs import Arcs, fit_arcs
from extremal.estimator.strip_grid import normal_sigma

VIEWS = 15


class Sections:
    """Ellipses with half axes (n, 2) along turned axes, seen from (-0.6, y), y over `baseline` [m]: what `fit_arcs` takes.

    All are level, with centres on the z axis: of random shapes and orientations where `rng` is given, else of those of one
    ellipsoid.
    """

    def __init__(
        self,
        baseline: float = 0.4,
        sigma: float = 1e-7,
        rng: np.random.Generator | None = None,
        count: int = 60,
        views: int = VIEWS,
    ) -> None:
        self.middle = views // 2
        self.axes = np.linspace(0.7, 1.0, count)[:, None] * (0.035, 0.05)
        turn = np.zeros(count)
        if rng is not None:
            self.axes, turn = rng.uniform(0.02, 0.06, (count, 2)), rng.uniform(0, np.pi, count)
        c, s = np.cos(turn), np.sin(turn)
        self.turn = np.stack(
            [np.stack([c, s], axis=-1), np.stack([-s, c], axis=-1)], axis=-2
        )  # (n, 2, 2) rows: axes
        self.centres = np.zeros((views, 3))
        self.centres[:, 0], self.centres[:, 1] = -0.6, baseline * np.linspace(-0.5, 0.5, views)
        scaled = np.einsum("nij,vj->nvi", self.turn, self.centres[:, :2]) / self.axes[:, None]
        # on the unit circle the contact is arccos(1 / distance) away from the camera's direction
        angle = np.arctan2(scaled[..., 1], scaled[..., 0]) - np.arccos(1 / np.linalg.norm(scaled, axis=-1))
        circle = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        self.contacts = self._level(circle * self.axes[:, None])
        normals = self._level(circle / self.axes[:, None])
        self.normals = normals / np.linalg.norm(normals, axis=-1, keepdims=True)
        rays = self.contacts - self.centres
        self.rays = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
        self.sigma = np.full((count, views), sigma)
        self.shared = np.zeros((count, views, 1))
        first, ray = self.normals[:, self.middle], self.rays[:, self.middle]
        self.frame = np.stack([first, ray, np.cross(first, ray)], axis=1)

    def _level(self, xy: Array) -> Array:
        """World vectors (n, V, 3) of those (n, V, 2) along the axes."""
        return np.concatenate([xy @ self.turn, np.zeros((*xy.shape[:-1], 1))], axis=-1)

    def fit(self, angles: Array | float = 0.0) -> tuple[Arcs, Array]:
        """Arcs through tangents that are turned about the camera centres by angles (n, V) [rad]."""
        normals = self.normals + np.asarray(angles)[..., None] * self.rays
        normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
        origin = self.contacts[:, self.middle] + (0.002, 0.002, 0.0)
        alone = np.arange(len(origin))
        return fit_arcs(origin, self.frame, normals, self.centres, self.sigma, self.shared, alone)

    def off(self, points: Array) -> Array:
        """Distances (n, T) [m] of points (n, T, 3) near the ellipses from them, positive outside."""
        own = np.einsum("nij,ntj->nti", self.turn, points[..., :2])
        level = np.sum((own / self.axes[:, None]) ** 2, axis=-1)
        return 0.5 * (level - 1) / np.linalg.norm(own / self.axes[:, None] ** 2, axis=-1)


def test_three_views_converge_to_second_order() -> None:
    """Halving the motion divides the error of contact points by four or more, and that across the surface by eight."""
    errors = []
    for baseline in (0.8, 0.4, 0.2, 0.1):
        seen = Sections(baseline, sigma=1e-9, views=3)
        arcs, phi = seen.fit()
        points, _ = arcs.points(phi)
        contact = np.linalg.norm(points - seen.contacts, axis=-1).max()
        errors.append([np.abs(seen.off(points)).max(), contact])
    order = np.log2(np.array(errors[:-1]) / errors[1:])
    assert order[:, 0].min() > 3.0 and order[:, 1].min() > 2.0


def test_many_views_follow_sections_that_are_no_circles() -> None:
    seen = Sections(0.4)
    arcs, phi = seen.fit()
    assert np.abs(seen.off(arcs.points(phi)[0])).max() < 1e-7
    radius, _ = arcs.radius(phi)
    a, b = seen.axes[:, :1], seen.axes[:, 1:]
    n = seen.normals[..., :2]
    true = (a * b) ** 2 / np.sum((n * seen.axes[:, None]) ** 2, axis=-1) ** 1.5
    np.testing.assert_allclose(radius, true, rtol=0.02)


@pytest.mark.parametrize(("sigma", "bias"), [(1e-5, 0.0), (1e-5, 2e-5), (1e-4, 0.0)])
def test_covariance_covers_the_errors(sigma: float, bias: float) -> None:
    """Over random ellipses, each with its own noise and a bias of its own in all views alike."""
    rng = np.random.default_rng(4)
    seen = Sections(sigma=sigma, rng=rng, count=600)
    seen.shared[:] = bias
    noise = sigma * rng.standard_normal(seen.sigma.shape)
    arcs, phi = seen.fit(noise + bias * rng.standard_normal((len(noise), 1)))
    points, covariance = arcs.points(phi)
    assert np.abs(np.linalg.eigvalsh(covariance)[..., 0]).max() < 1e-15  # none across the plane
    z = seen.off(points) / normal_sigma(seen.normals, covariance)
    # one number a view and ellipse; ellipses are independent, the views of one are not
    share = np.mean(np.abs(z) < 2, axis=1)
    assert abs(share.mean() - 0.9545) < 3 * share.std() / np.sqrt(len(share)) + 0.015
    square = np.mean(z**2, axis=1)
    assert abs(square.mean() - 1) < 3 * square.std() / np.sqrt(len(square)) + 0.1


def _bad(change: Callable[[Sections], object]) -> None:
    seen = Sections()
    change(seen)
    seen.fit()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda s: s.sigma.fill(0.0), "sigma"),
        (lambda s: s.normals.fill(np.nan), "normals"),
        (lambda s: setattr(s, "shared", np.zeros((3, 2, 1))), "shared"),
        (lambda s: setattr(s, "centres", s.centres[:-1]), "centres|shapes|broadcast"),
    ],
)
def test_arcs_refuse_what_is_no_data(change: Callable[[Sections], object], message: str) -> None:
    with pytest.raises(InvalidInput, match=message):
        _bad(change)
