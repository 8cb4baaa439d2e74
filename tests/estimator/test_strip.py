"""Strips from exact contours of objects whose surfaces are known."""

import numpy as np
import pytest
from exact_contours import OBJECTS, PLACE, VIEWS, cameras, exact_contours, strip_of
from scipy.spatial.transform import RigidTransform

from extremal.estimator import DegenerateGeometry, InvalidInput, find_contours
from extremal.estimator.strip import Strip, recover_strip, surface_at
from extremal.scenes import Ellipsoid, Surface


@pytest.fixture(scope="module", params=OBJECTS)
def exact(request: pytest.FixtureRequest) -> tuple[Surface, Strip]:
    """An object and the strip of its exact contours."""
    return OBJECTS[request.param], strip_of(OBJECTS[request.param])


def test_vertices_lie_on_the_surface(exact: tuple[Surface, Strip]) -> None:
    surface, strip = exact
    valid = strip.valid
    assert len(strip.run) > 30 and valid.mean() > 0.9
    assert set(strip.side) == {-1, 1}  # both sides of the object
    off = np.abs(surface.signed_distance(strip.points[valid]))
    assert np.percentile(off, 95) < 10e-6 and off.max() < 50e-6  # what splines leave, most at their ends
    turned = np.sum(strip.normals[valid] * surface.normals(strip.points[valid]), axis=1)
    assert np.degrees(np.arccos(np.clip(turned, -1, 1))).max() < 3  # of differences over 4 mm


def test_generators_and_arcs_are_where_they_should_be(exact: tuple[Surface, Strip]) -> None:
    """Vertices of a view's s-curve lie on that view's contour generator; those of an arc in one plane with the travel."""
    surface, strip = exact
    centres = np.array([v.centre for v in cameras()])
    assert list(strip.view) == list(range(VIEWS))
    for t, view in enumerate(strip.view):
        rows = strip.valid[:, t]
        ray = strip.points[rows, t] - centres[view]
        facing = np.sum(ray * surface.normals(strip.points[rows, t]), axis=1) / np.linalg.norm(ray, axis=1)
        assert np.abs(facing).max() < 0.02  # [rad]: a millimetre of depth
    off = np.einsum("stk,sk->st", strip.points - strip.arcs.origin[:, None], strip.arcs.frame[:, 2])
    assert np.abs(off).max() < 1e-9
    assert np.all(np.abs(strip.arcs.frame[:, 2] @ (centres[-1] - centres[0])) < 1e-9)


def test_faces_look_outwards(exact: tuple[Surface, Strip]) -> None:
    surface, strip = exact
    corners = strip.points.reshape(-1, 3)[strip.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert len(strip.faces) > 1.7 * len(strip.run) * (VIEWS - 1) * 0.8
    assert np.all(np.sum(normals * surface.normals(corners.mean(axis=1)), axis=1) > 0)
    assert np.all(strip.valid.ravel()[strip.faces])


def test_sigma_of_whole_strips_covers_noise_in_the_images() -> None:
    """Contours with independent noise in every edgel: splines tie neighbours together, runs of about three count as one."""
    surface = OBJECTS["ellipsoid"]
    strip = strip_of(surface, np.random.default_rng(8))
    z = (surface.signed_distance(strip.points) / strip.sigma)[strip.valid]
    assert np.mean(np.abs(z) < 2) > 0.93
    assert np.mean(z**2) < 1.3


def test_world_motion_is_in_the_covariance() -> None:
    strip = strip_of(OBJECTS["sphere"])
    step = 1e-6
    world = step * np.random.default_rng(2).standard_normal((6, 1))
    motion = RigidTransform.from_exp_coords(np.concatenate([world[3:, 0], world[:3, 0]]))
    _, covariance, _ = surface_at(strip.arcs, strip.phi, strip.run, strip.side, world)
    moved = motion.apply(strip.points.reshape(-1, 3)).reshape(strip.points.shape) - strip.points
    added = covariance - strip.covariance
    np.testing.assert_allclose(added, moved[..., None] * moved[..., None, :], atol=1e-4 * step**2)


# What is refused.


def test_degenerate_input_is_an_error() -> None:
    seen = cameras()
    contours = [exact_contours(OBJECTS["sphere"], v) for v in seen]
    with pytest.raises(DegenerateGeometry, match="2 view"):
        recover_strip(seen[:2], contours[:2])
    with pytest.raises(InvalidInput, match="contours of 14"):
        recover_strip(seen, contours[1:])
    with pytest.raises(DegenerateGeometry, match="baseline"):
        recover_strip([seen[0]] * 5, contours[:5])
    with pytest.raises(DegenerateGeometry, match="extremal"):
        recover_strip(seen, [find_contours(v.image, v.camera) for v in seen])  # black frames


def test_a_fixed_feature_is_no_strip() -> None:
    seen = cameras()
    thin = Ellipsoid(a=1e-4, b=1e-4, c=0.06, T_world_object=PLACE)
    with pytest.raises(DegenerateGeometry, match="extremal"):
        recover_strip(seen, [exact_contours(thin, v) for v in seen])
