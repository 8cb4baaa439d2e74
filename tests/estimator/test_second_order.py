"""Second-order shape from tangent planes: exact geometry, Monte Carlo, and what is not determined."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from extremal.estimator.camera import Array
from extremal.estimator.parallel_sections import columns
from extremal.estimator.second_order import SecondOrderShape, second_order_shape
from extremal.estimator.tangent_planes import TangentPlanes, surroundings
from extremal.scenes import Ellipsoid, Lathe, Sphere, Surface
from extremal.scripts import general_study
from extremal.scripts.general_study import general_table, random_ellipsoid, random_vase

SIGMA = 6e-5  # [rad]: 0.05 px at f = 800 px
TURNED = RigidTransform.from_rotation(Rotation.from_rotvec([0.4, -0.9, 0.3]))


def arc(turn: float, views: int = 25, distance: float = 0.55) -> Array:
    """Camera centres (V, 3) on an arc of half-angle `turn` [rad] that also leaves its plane."""
    u = np.linspace(-1, 1, views)
    azimuth, elevation = turn * u, 0.2 + 0.3 * turn * np.sin(3 * u)
    direction = [-np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    return distance * np.stack(direction, axis=1)


def exact(surface: Surface, centres: Array) -> tuple[Array, Array, Array, Array]:
    """All visible points of the contour generators: centres, rays, normals, points (E, 3), in the order of the views."""
    rows = []
    for centre in centres:
        for curve in surface.contour_generator(centre):
            points, normals = curve.points[curve.visible], curve.normals[curve.visible]
            ray = points - centre
            ray /= np.linalg.norm(ray, axis=1, keepdims=True)
            rows.append((np.tile(centre, (len(ray), 1)), ray, normals, points))
    c, p, n, x = (np.concatenate(column) for column in zip(*rows, strict=True))
    return c, p, n, x


def shape_of(
    surface: Surface, centres: Array, reach: float, window: float, seeds: int = 3
) -> tuple[SecondOrderShape, Array]:
    """Shapes at points of the middle view's contours, and the exact points (S, 3)."""
    c, p, n, x = exact(surface, centres)
    middle = np.flatnonzero(np.all(c == centres[len(centres) // 2], axis=1))
    chosen = middle[np.linspace(0, len(middle) - 1, seeds + 2).astype(int)[1:-1]]
    planes = TangentPlanes(c, p, n, np.full(len(c), SIGMA))
    index, sigma = surroundings(planes, chosen, np.linalg.norm(x[chosen] - c[chosen], axis=1), reach, window)
    thin = np.unique(np.append(np.arange(0, index.shape[1], max(1, index.shape[1] // 400)), 0))
    index, sigma = index[:, thin], sigma[:, thin]
    return second_order_shape(c[index], p[index], n[index], sigma), x[chosen]


SHAPES: dict[str, Surface] = {
    "ellipsoid": Ellipsoid(a=0.05, b=0.035, c=0.07, T_world_object=TURNED),
    "waist": Lathe(
        profile_z=np.linspace(0, 0.2, 81),
        profile_r=0.04 + 0.007 * np.cos(10 * np.pi * np.linspace(0, 0.2, 81)),
        T_world_object=RigidTransform.from_translation([0, 0, -0.1]),
    ),
}


def test_sphere_is_exact() -> None:
    shape, points = shape_of(Sphere(radius=0.04), arc(0.35), 0.5, 0.03)
    assert shape.valid.all()
    assert (shape.kind == "elliptic").all()
    np.testing.assert_allclose(shape.position, points, atol=1e-5)
    error, sigma = np.abs(shape.ray_radius - 0.04), np.sqrt(shape.covariance[:, 3, 3])
    np.testing.assert_array_less(error, 1.96 * sigma)
    # the second point is on top, where the motion hardly turns the normals along the ray
    np.testing.assert_array_less(error[[0, 2]], 2e-4)
    np.testing.assert_allclose(shape.contour_curvature, 25, rtol=5e-3)
    np.testing.assert_allclose(shape.frame[:, 0], points / 0.04, atol=1e-3)


@pytest.mark.parametrize("name", SHAPES)
def test_long_arcs_of_exact_contours(name: str) -> None:
    surface = SHAPES[name]
    shape, points = shape_of(surface, arc(0.35), 0.6, 0.03, seeds=7)
    truth = surface.principal_curvatures(points)
    assert shape.valid.all()
    assert np.abs(shape.position - points).max() < 5e-5
    assert np.all(np.abs(shape.principal_curvatures - truth) < 1.96 * shape.sigma_curvatures + 1e-9)
    np.testing.assert_allclose(shape.principal_curvatures, truth, rtol=0.03, atol=0.1)
    np.testing.assert_allclose(shape.gaussian, np.prod(truth, axis=1), rtol=0.05, atol=5)
    np.testing.assert_allclose(shape.mean, truth.mean(axis=1), rtol=0.03)
    found = np.einsum("nki,ni->nk", shape.principal_directions, surface.normals(points))
    np.testing.assert_allclose(found, 0, atol=2e-3)  # tangents of the surface
    for k in range(2):
        along = surface.normal_curvature(points, shape.principal_directions[:, k])
        np.testing.assert_allclose(along, truth[:, k], rtol=0.03, atol=0.1)
    np.testing.assert_allclose(shape.principal_radii * shape.principal_curvatures, 1, rtol=1e-9)


def test_hyperbolic_and_elliptic_are_told_apart() -> None:
    waist, points = shape_of(SHAPES["waist"], arc(0.35), 0.6, 0.03, seeds=9)
    K = SHAPES["waist"].gaussian_curvature(points)
    assert (K < -20).any()
    assert (K > 20).any()
    assert (waist.kind[K < -20] == "hyperbolic").all()
    assert (waist.kind[K > 20] == "elliptic").all()


def fit_error(surface: Surface, scale: float) -> float:
    """Largest relative error of beta by a fit of terms up to order 2 alone over a neighbourhood of this size."""
    point_like, points = shape_of(surface, arc(0.35), 0.6, 0.03, seeds=1)
    n, t1, t2 = point_like.frame[0]
    curves = [surface.contour_generator(c)[0] for c in arc(0.3 * scale)]
    x = np.concatenate([c.points for c in curves]) - points[0]
    normals = np.concatenate([c.normals for c in curves])
    near = (np.abs(x @ t2) < 0.02 * scale) & (normals @ n > 0)
    local = np.stack([normals[near] @ n, normals[near] @ t1, x[near] @ t2], axis=1)
    phi = np.arctan2(local[:, 1], local[:, 0])
    support = np.sum(
        (x[near] @ np.stack([n, t1], axis=1)) * np.stack([np.cos(phi), np.sin(phi)], axis=1), axis=1
    )
    terms = np.linalg.lstsq(columns(phi, local[:, 2], 2), support, rcond=None)[0]
    return abs(terms[3] * surface.normal_curvature(points, t1[None])[0] - 1)


def test_truncation_falls_with_the_size_of_the_arc() -> None:
    """What terms of order 2 leave out is of the first order in the size, or of the second by symmetry."""
    errors = [fit_error(SHAPES["ellipsoid"], scale) for scale in (1.0, 0.5, 0.25)]
    assert errors[2] < 0.7 * errors[1] < 0.7**2 * errors[0]


def test_cylinder_is_parabolic() -> None:
    pose = RigidTransform.from_translation([0, 0, -0.1])
    cylinder = Lathe(profile_z=[0, 0.1, 0.2], profile_r=[0.04] * 3, T_world_object=pose)
    shape, points = shape_of(cylinder, arc(0.35), 0.6, 0.03, seeds=4)
    assert (shape.kind == "parabolic").all()
    np.testing.assert_allclose(shape.principal_curvatures[:, 1], 25, rtol=0.01)
    assert np.abs(shape.principal_curvatures[:, 0]).max() < 0.1
    assert (shape.sigma_radii[:, 0] > 1).all()
    np.testing.assert_allclose(shape.position, points, atol=1e-5)


def test_the_outside_is_found_by_the_motion() -> None:
    """Normals that point the wrong way, or any way, change nothing."""
    c, p, n, x = exact(Sphere(radius=0.04), arc(0.35))
    seed = np.flatnonzero(np.all(c == arc(0.35)[12], axis=1))[:1]
    planes = TangentPlanes(c, p, n, np.full(len(c), SIGMA))
    index, sigma = surroundings(planes, seed, np.linalg.norm(x[seed] - c[seed], axis=1))
    signs = np.where(np.random.default_rng(10).random(len(n)) < 0.5, -1.0, 1.0)[:, None]
    shapes = [second_order_shape(c[index], p[index], m[index], sigma) for m in (n, -n, signs * n)]
    for shape in shapes:
        np.testing.assert_allclose(shape.frame[0, 0], x[seed[0]] / 0.04, atol=1e-3)
        assert (shape.principal_curvatures > 0).all()


# Monte Carlo.


@pytest.mark.parametrize(
    "make", [random_ellipsoid, lambda rng: random_vase(rng, 81)], ids=["ellipsoids", "vases"]
)
def test_sigma_is_honest(make: Callable[[np.random.Generator], Surface]) -> None:
    check(make, objects=3, points=10)


@pytest.mark.slow
@pytest.mark.parametrize(
    "make", [random_ellipsoid, lambda rng: random_vase(rng, 81)], ids=["ellipsoids", "vases"]
)
def test_sigma_is_honest_over_many_objects(make: Callable[[np.random.Generator], Surface]) -> None:
    check(make, objects=100, points=10)


def check(make: Callable[[np.random.Generator], Surface], objects: int, points: int) -> None:
    row = general_study.study_of("objects", make, objects, points)
    count = objects * points
    slack = 3 * np.sqrt(0.05 * 0.95 / count)
    for coverage in (row.smaller_coverage, row.larger_coverage, row.radii_coverage):
        assert 0.93 - slack < coverage
    # mean of chi2 with 6 degrees of freedom, per degree: variance 2 / 6
    assert row.nees == pytest.approx(1, abs=0.1 + 3 * np.sqrt(2 / 6 / count))
    assert row.smaller_error < 0.02
    assert row.larger_error < 0.02
    assert row.sign_right >= 0.99
    assert row.invalid <= 0.01 * count
    assert len(general_table([row]).splitlines()) == 16
