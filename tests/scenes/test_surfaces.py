"""Every kind of surface against closed forms, finite differences of its distance, and its own rays."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import RigidTransform, Rotation

from extremal.estimator import InvalidInput
from extremal.scenes import Box, Ellipsoid, Lathe, Mesh, Sphere, Superquadric, Surface

POSE = RigidTransform.from_components(
    np.array([0.3, -0.2, 0.1]), Rotation.from_euler("xyz", [0.4, -0.7, 1.1])
)
VASE = ((0.0, 0.03, 0.07, 0.115, 0.155, 0.18, 0.2), (0.034, 0.0405, 0.0455, 0.0425, 0.0345, 0.0325, 0.036))
SMOOTH: list[Surface] = [
    Sphere(0.05, T_world_object=POSE),
    Ellipsoid(0.03, 0.05, 0.07, T_world_object=POSE),
    Ellipsoid(0.05, 0.05, 0.03, name="oblate", T_world_object=POSE),
    Superquadric(0.03, 0.05, 0.07, 0.6, 0.4, T_world_object=POSE),
    Superquadric(0.05, 0.04, 0.06, 1.0, 1.0, name="round", T_world_object=POSE),
    Lathe(*VASE, name="vase", T_world_object=POSE),
]
SOLIDS = [*SMOOTH, Box((0.06, 0.08, 0.1), T_world_object=POSE)]


def by_name(surface: Surface) -> str:
    return surface.name


def rays_at(surface: Surface, rng: np.random.Generator, n: int = 800) -> tuple[np.ndarray, np.ndarray]:
    d = rng.normal(size=(n, 3))
    d /= np.linalg.norm(d, axis=1)[:, None]
    middle = surface.T_world_object.apply(np.array([0, 0, 0.1 if isinstance(surface, Lathe) else 0.0]))
    return middle - 0.4 * d + rng.normal(size=(n, 3)) * 0.03, d


def surface_points(surface: Surface, rng: np.random.Generator) -> np.ndarray:
    o, d = rays_at(surface, rng)
    t = surface.intersect(o, d)
    hit = np.isfinite(t)
    return o[hit] + t[hit, None] * d[hit]


@pytest.mark.parametrize("surface", SOLIDS, ids=by_name)
def test_rays_meet_the_surface_first_from_outside_and_misses_stay_out(surface: Surface) -> None:
    o, d = rays_at(surface, np.random.default_rng(1))
    t = surface.intersect(o, d)
    hit = np.isfinite(t)
    assert 0.2 < hit.mean() < 1
    assert np.abs(surface.signed_distance(o[hit] + t[hit, None] * d[hit])).max() < 1e-9
    for fraction in np.linspace(0, 0.999, 25):
        assert surface.signed_distance(o[hit] + fraction * t[hit, None] * d[hit]).min() > -1e-12
    for along in np.linspace(0, 0.8, 81):
        assert surface.signed_distance(o[~hit] + along * d[~hit]).min() > -1e-12


@pytest.mark.parametrize("surface", SMOOTH, ids=by_name)
def test_normals_and_curvatures_are_derivatives_of_the_signed_distance(surface: Surface) -> None:
    rng = np.random.default_rng(2)
    p = surface_points(surface, rng)
    n = surface.normals(p)
    e = 1e-5
    gradient = np.stack(
        [
            (surface.signed_distance(p + e * axis) - surface.signed_distance(p - e * axis)) / (2 * e)
            for axis in np.eye(3)
        ],
        axis=1,
    )
    smooth = np.abs(gradient - n).max(axis=1) < 1e-6
    assert smooth.mean() > 0.99  # the others are within 10 um of a lathe's rims
    t = np.cross(n, rng.normal(size=n.shape))
    t /= np.linalg.norm(t, axis=1)[:, None]
    e = 1e-4
    d = surface.signed_distance
    bending = (d(p + e * t) + d(p - e * t) - 2 * d(p)) / e**2
    error = np.abs(bending - surface.normal_curvature(p, t))
    assert np.quantile(error, 0.99) < 0.01
    k = surface.principal_curvatures(p)
    between = surface.normal_curvature(p, t)
    assert np.all((between > k[:, 0] - 1e-9) & (between < k[:, 1] + 1e-9))
    u = np.cross(n, t)
    assert np.allclose(between + surface.normal_curvature(p, u), k.sum(axis=1))  # Euler
    assert np.allclose(surface.gaussian_curvature(p), k[:, 0] * k[:, 1])


@pytest.mark.parametrize("surface", SOLIDS, ids=by_name)
def test_signed_distance_equals_brute_force_inside_and_outside(surface: Surface) -> None:
    rng = np.random.default_rng(3)
    pieces = surface._pieces()
    middle = surface.T_world_object.apply(np.array([0, 0, 0.1 if isinstance(surface, Lathe) else 0.0]))
    p = middle + rng.normal(size=(60, 3)) * 0.03
    local = surface.T_world_object.inv().apply(p)
    distance = np.full(len(p), np.inf)
    for piece in pieces:
        for i in range(len(p)):
            distance[i] = min(distance[i], np.linalg.norm(piece.vertices - local[i], axis=1).min())
    d = surface.signed_distance(p)
    if not isinstance(surface, Box):  # its vertices are only its corners
        assert np.all(distance - np.abs(d) > -1e-6)
        assert np.mean(distance - np.abs(d) < 5e-5) > 0.8  # caps have few vertices
    # An inside point sees the surface once more often than an outside one.
    up = np.tile([0.0, 0.6, 0.8], (len(p), 1))
    first = surface.intersect(p, up)
    crossings = np.zeros(len(p), int)
    start = p.copy()
    for _ in range(6):
        t = surface.intersect(start, up)
        alive = np.isfinite(t)
        crossings += alive
        start[alive] += (t[alive, None] + 1e-7) * up[alive]
    assert np.array_equal(crossings % 2 == 1, d < 0)
    assert np.all(np.isfinite(first[d < 0]))


@pytest.mark.parametrize("surface", SMOOTH, ids=by_name)
@pytest.mark.parametrize("offset", [(-0.6, 0.1, 0.2), (0.1, 0.15, 0.5), (0.2, -0.3, -0.2)])
def test_contour_generators_turn_away_from_the_camera(
    surface: Surface, offset: tuple[float, float, float]
) -> None:
    centre = surface.T_world_object.apply(np.array(offset))
    curves = surface.contour_generator(centre)
    assert curves
    for curve in curves:
        ray = curve.points - centre
        assert np.abs(np.sum(curve.normals * ray, axis=1)).max() < 1e-9
        assert np.abs(surface.signed_distance(curve.points)).max() < 1e-9
        assert len(curve.points) >= 400
        assert curve.kind == "extremal"
        assert curve.name.startswith(surface.name + "/limb")


def test_sphere_has_its_closed_forms() -> None:
    sphere = Sphere(0.05, T_world_object=POSE)
    p = surface_points(sphere, np.random.default_rng(4))
    assert np.allclose(sphere.principal_curvatures(p), 20)
    assert np.allclose(sphere.gaussian_curvature(p), 400)
    # A plane at angle phi to the normal cuts a circle of radius R cos phi.
    n = sphere.normals(p)
    t = np.cross(n, [0.3, 0.5, 0.8])
    t /= np.linalg.norm(t, axis=1)[:, None]
    phi = np.radians(35)
    assert np.allclose(sphere.section_radius(p, np.cos(phi) * t + np.sin(phi) * n), 0.05 * np.cos(phi))


def test_straight_lathe_is_a_cylinder() -> None:
    cylinder = Lathe((0.0, 0.2), (0.04, 0.04))
    p = np.array([[0.04, 0.0, 0.1], [0.0, -0.04, 0.05]])
    assert np.allclose(cylinder.principal_curvatures(p), [0, 25])
    centre = np.array([-0.5, 0.0, 0.3])
    for curve in cylinder.contour_generator(centre):
        assert np.allclose(curve.points[:, 0], -(0.04**2) / 0.5)
    assert cylinder.signed_distance([0.0, 0.0, 0.25]) == pytest.approx(0.05)
    assert cylinder.signed_distance([0.0, 0.0, 0.1]) == pytest.approx(-0.04)
    assert cylinder.signed_distance([0.07, 0.0, 0.24]) == pytest.approx(0.05)


def test_waist_has_the_curvature_of_a_torus() -> None:
    # Profile R - sqrt(a^2 - (z - h)^2): the inner side of a torus; K at its equator is -1 / (a (R - a)).
    z = np.linspace(0, 0.08, 81)
    a, big = 0.06, 0.09
    lathe = Lathe(z, big - np.sqrt(a**2 - (z - 0.04) ** 2))
    k = lathe.principal_curvatures([big - a, 0.0, 0.04])
    assert k == pytest.approx([-1 / a, 1 / (big - a)], rel=1e-4)


def test_lathe_seen_from_above_has_a_limb_that_ends_on_the_side() -> None:
    ball = Lathe(np.linspace(0, 0.1, 41), np.sqrt(0.06**2 - (np.linspace(0, 0.1, 41) - 0.05) ** 2))
    (curve,) = ball.contour_generator([-0.1, 0.0, 0.5])
    assert np.allclose(curve.points[0], curve.points[-1], atol=1e-6)  # closed: it goes round
    assert curve.visible.all()


def test_deep_waist_hides_part_of_its_own_contour() -> None:
    z = np.linspace(0, 0.2, 9)
    lathe = Lathe(z, 0.035 + 0.02 * np.cos(2 * np.pi * z / 0.2))
    centre = np.array([-0.3, 0.0, 0.6])
    curves = lathe.contour_generator(centre)
    visible = np.concatenate([curve.visible for curve in curves])
    assert 0.1 < visible.mean() < 0.9
    points = np.concatenate([curve.points for curve in curves])
    normals = np.concatenate([curve.normals for curve in curves])
    # Just off the surface, a visible point sees the camera, by a march along the ray; moving off it may bring
    # a point behind the limb that begins to hide it, by no more than the move.
    off = points[visible] + 1e-4 * normals[visible]
    for fraction in np.linspace(0.4, 1, 600):
        assert lathe.signed_distance(centre + fraction * (off - centre)).min() > -1e-4


def test_mesh_of_a_sphere_comes_near_it() -> None:
    mesh = Mesh.from_trimesh(trimesh.creation.icosphere(4, 0.05), T_world_object=POSE)
    ball = Sphere(0.05, T_world_object=POSE)
    centre = POSE.apply([-0.5, 0.1, 0.2])
    (curve,) = mesh.contour_generator(centre)
    assert curve.visible.mean() > 0.99
    assert np.abs(ball.signed_distance(curve.points)).max() < 1e-4
    ray = curve.points - centre
    assert np.abs(np.sum(ball.normals(curve.points) * ray, axis=1)).max() < 2e-3
    assert np.median(mesh.principal_curvatures(curve.points)) == pytest.approx(20, rel=0.05)
    o, d = rays_at(ball, np.random.default_rng(5), 200)
    t, exact = mesh.intersect(o, d), ball.intersect(o, d)
    both = np.isfinite(t) & np.isfinite(exact)
    square = np.sum(ball.normals(o[both] + t[both, None] * d[both]) * d[both], axis=1) < -0.3
    assert np.abs(t[both] - exact[both])[square].max() < 5e-4
    p = POSE.translation + np.random.default_rng(6).normal(size=(100, 3)) * 0.04
    assert np.abs(mesh.signed_distance(p) - ball.signed_distance(p)).max() < 2e-4


@pytest.mark.parametrize("solid", SOLIDS, ids=lambda s: s.name)
def test_points_that_no_solver_finds_are_not_numbers(solid: Surface) -> None:
    """One that has no step, or none that leads anywhere, leaves the other points alone."""
    centre = POSE.apply([-0.5, 0.1, 0.2])
    middle, radius = solid.bounding_sphere
    level = np.cross(centre - middle, [0, 0, 1.0])
    start = np.stack([middle + radius * level / np.linalg.norm(level), centre])
    upright = np.tile(np.cross(centre - middle, level), (2, 1))
    found = solid.contour_points_in_planes(start, centre, upright)
    assert np.all(np.isnan(found[1]))  # from the camera's centre itself
    (alone,) = solid.contour_points_in_planes(start[:1], centre, upright[:1])
    np.testing.assert_allclose(found[0], alone, atol=1e-12)
    assert np.all(np.isnan(solid.contour_points_in_planes(start[:1], centre, np.zeros((1, 3)))))


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e200])
@pytest.mark.parametrize("solid", [*SOLIDS, Mesh.from_trimesh(trimesh.creation.box())], ids=lambda s: s.name)
def test_points_that_are_nowhere_are_refused(solid: Surface, bad: float) -> None:
    with pytest.raises(InvalidInput, match="accepted: up to"):
        solid.signed_distance([[0.0, 0.0, bad]])
    with pytest.raises(InvalidInput, match="accepted: up to"):
        solid.contour_generator([0.0, 0.0, bad])
