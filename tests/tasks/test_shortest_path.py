"""Shortest paths against closed forms, a hull, geodesics on a triangulated offset, and each other."""

import time

import numpy as np
import pytest
from scipy.spatial import ConvexHull  # pyright: ignore[reportAttributeAccessIssue]
from scipy.spatial.transform import RigidTransform, Rotation

from extremal.estimator.errors import InvalidInput
from extremal.scenes import Box, Ellipsoid, Lathe, Sphere, Superquadric
from extremal.tasks.shortest_path import Path, shortest_path, winding
from extremal.tasks.taut_string import string_path


def cylinder(radius: float, pose: RigidTransform | None = None) -> Lathe:
    return Lathe(
        [0, 0.2, 0.4], [radius] * 3, T_world_object=RigidTransform.identity() if pose is None else pose
    )


def vase(rng: np.random.Generator) -> Lathe:
    """Radii of 25 to 70 mm with a waist or a belly."""
    z = np.linspace(0, rng.uniform(0.16, 0.24), 7)
    wave = rng.uniform(0.003, 0.012) * np.sin(2 * np.pi * (z / z[-1] * rng.uniform(0.7, 1.4) + rng.uniform()))
    return Lathe(z, rng.uniform(0.04, 0.055) + wave)


def across(lathe: Lathe, clearance: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Start and goal on either side of a lathe at the origin, 10 to 60 mm beyond its clearance."""
    height = lathe.profile.height
    far = lathe.profile.largest + clearance + rng.uniform(0.01, 0.06, 2)
    turn = rng.uniform(2.2, 3.1) * rng.choice([-1, 1])
    z = height * rng.uniform(0.25, 0.75, 2)
    return np.array([-far[0], 0, z[0]]), np.array([-far[1] * np.cos(turn), -far[1] * np.sin(turn), z[1]])


def circle_length(a: float, b: float, r: float, angle: float) -> float:
    """Taut string around a circle between points at distances a and b from its centre, `angle` apart."""
    arc = angle - np.arccos(r / a) - np.arccos(r / b)
    return np.sqrt(a * a - r * r) + np.sqrt(b * b - r * r) + r * arc


def test_cylinders_give_helices_in_closed_form() -> None:
    rng = np.random.default_rng(11)
    for _ in range(10):
        radius, clearance = rng.uniform(0.02, 0.1), rng.uniform(0.01, 0.06)
        pose = RigidTransform.from_components(rng.normal(size=3), Rotation.from_rotvec([0.3, -0.2, 0.1]))
        a, b = (radius + clearance) * rng.uniform(1.02, 1.5, 2)
        angle, z = rng.uniform(2, np.pi), rng.uniform(0.15, 0.25, 2)
        start, goal = pose.apply([[a, 0, z[0]], [b * np.cos(angle), b * np.sin(angle), z[1]]])
        path = shortest_path(cylinder(radius, pose), start, goal, clearance)
        expected = np.hypot(circle_length(a, b, radius + clearance, angle), z[1] - z[0])
        assert path.length == pytest.approx(expected, rel=1e-9)
        assert np.abs(path.points[[0, -1]] - [start, goal]).max() < 1e-12


@pytest.mark.parametrize("seed", [101, 102, 103, 104])
def test_clairaut_and_the_taut_string_agree_on_vases(seed: int) -> None:
    rng = np.random.default_rng(seed)
    lathe, clearance = vase(rng), rng.uniform(0.02, 0.05)
    start, goal = across(lathe, clearance, rng)
    exact = shortest_path(lathe, start, goal, clearance)
    points, length = string_path(lathe, start, goal, clearance)
    assert exact.length == pytest.approx(length, rel=1e-5)
    # Different points of the same curve.
    gaps = np.linalg.norm(exact.points[1:-1, None] - points, axis=2).min(axis=1)
    assert np.median(gaps) < 1e-3
    for p in (exact.points, points):
        assert lathe.signed_distance(p).min() > clearance - 1e-5


def test_angular_momentum_is_conserved_from_start_to_goal() -> None:
    rng = np.random.default_rng(12)
    lathe = vase(rng)
    path = shortest_path(lathe, *across(lathe, 0.03, rng), 0.03)
    middle, step = (path.points[1:] + path.points[:-1]) / 2, np.diff(path.points, axis=0)
    momentum = np.cross(middle, step)[:, 2] / np.linalg.norm(step, axis=1)
    assert np.ptp(momentum) < 1e-4 * np.abs(momentum).mean()


def test_geodesics_of_the_triangulated_offset_are_as_long() -> None:
    """potpourri3d, between the points where the path touches; the offset as a dilation of the meridian section."""
    pp3d = pytest.importorskip("potpourri3d")
    rng = np.random.default_rng(13)
    lathe, clearance = vase(rng), 0.03
    path = shortest_path(lathe, *across(lathe, clearance, rng), clearance)
    touch, leave = path.points[1], path.points[-2]
    z = np.linspace(path.points[:, 2].min() - 0.02, path.points[:, 2].max() + 0.02, 201)
    z = np.unique(np.concatenate([z, [touch[2], leave[2]]]))
    ends = np.unwrap(np.arctan2([touch[1], leave[1]], [touch[0], leave[0]]))
    theta = np.unique(np.concatenate([np.linspace(ends.min() - 0.2, ends.max() + 0.2, 401), ends]))
    own = np.linspace(0, lathe.profile.height, 20001)
    chord = np.maximum(clearance**2 - (z[:, None] - own) ** 2, 0)
    near = np.abs(z[:, None] - own) <= clearance
    rho = np.max(np.where(near, lathe.profile.spline(own) + np.sqrt(chord), 0), axis=1)
    grid = np.stack(
        np.broadcast_arrays(rho[:, None] * np.cos(theta), rho[:, None] * np.sin(theta), z[:, None]), -1
    )
    index = np.arange(len(z) * len(theta)).reshape(len(z), len(theta))
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = np.concatenate([np.stack(t, -1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))])
    vertices = grid.reshape(-1, 3)
    first, last = (int(np.argmin(np.linalg.norm(vertices - p, axis=1))) for p in (touch, leave))
    assert np.linalg.norm(vertices[[first, last]] - [touch, leave], axis=1).max() < 1e-6
    geodesic = pp3d.EdgeFlipGeodesicSolver(vertices, faces).find_geodesic_path(first, last)
    length = float(np.sum(np.linalg.norm(np.diff(geodesic, axis=0), axis=1)))
    straight = np.linalg.norm(path.points[0] - touch) + np.linalg.norm(path.points[-1] - leave)
    assert path.length == pytest.approx(length + straight, rel=1e-4)


def test_sections_of_ellipsoids_in_planes_of_symmetry_are_strings_around_offset_ellipses() -> None:
    a, b, clearance = 0.09, 0.04, 0.025
    start, goal = np.array([-0.15, -0.01, 0]), np.array([0.145, 0.02, 0])
    t = np.linspace(0, 2 * np.pi, 20001)
    on, normal = (
        np.stack([a * np.cos(t), b * np.sin(t)], 1),
        np.stack([np.cos(t) / a, np.sin(t) / b], 1),
    )
    offset = on + clearance * normal / np.linalg.norm(normal, axis=1, keepdims=True)
    hull = ConvexHull(np.concatenate([[start[:2], goal[:2]], offset]))
    order = list(hull.vertices)
    ring = hull.points[order[order.index(0) :] + order[: order.index(0) + 1]]
    i = [*order[order.index(0) :], *order[: order.index(0)]].index(1)
    steps = np.linalg.norm(np.diff(ring, axis=0), axis=1)
    expected = min(steps[:i].sum(), steps[i:].sum())
    path = shortest_path(Ellipsoid(a, b, 0.2), start, goal, clearance)
    assert path.length == pytest.approx(expected, rel=1e-5)
    assert np.abs(path.points[:, 2]).max() < 1e-5


def test_spheres_from_any_side_and_boxes_around_an_edge() -> None:
    rng = np.random.default_rng(14)
    for _ in range(4):
        a = rng.normal(size=3)
        a *= 0.12 / np.linalg.norm(a)
        b = -a + 0.04 * rng.normal(size=3)
        b *= 0.11 / np.linalg.norm(b)
        if a[2] + b[2] < 0:  # the way below is not offered
            a, b = -a, -b
        angle = np.arccos(a @ b / 0.12 / 0.11)
        assert shortest_path(Sphere(0.05), a, b, 0.02).length == pytest.approx(
            circle_length(0.12, 0.11, 0.07, float(angle)), rel=1e-5
        )
    # Around a square column: straight along a face, quarter circles around its two edges.
    path = shortest_path(
        Box((0.1, 0.1, 0.8)), [-0.07, 0.05 + 0.02, 0], [0.07 + 0.05, -0.05, 0], clearance=0.02
    )
    assert path.length == pytest.approx(
        0.12 + circle_length(0.02, np.hypot(0.07, 0.1), 0.02, np.pi / 2 + np.arctan2(0.1, 0.07)), rel=1e-5
    )


def test_over_the_top_where_that_is_shorter() -> None:
    disc = Lathe([0, 0.01, 0.02], [0.1] * 3)
    path = shortest_path(disc, [-0.14, 0, 0.01], [0.14, 0, 0.01], 0.02)
    assert path.points[:, 2].max() == pytest.approx(0.04, abs=1e-5)
    # Around both rims, in the meridian plane: tangent, arc, then flat to the middle.
    to_rim, wrap = np.hypot(0.04, 0.01), np.pi / 2 + np.arctan2(0.01, 0.04)
    half = np.sqrt(to_rim**2 - 0.02**2) + 0.02 * (wrap - np.arccos(0.02 / to_rim)) + 0.1
    assert path.length == pytest.approx(2 * half, rel=5e-5)  # the arcs are six steps long
    tall = shortest_path(cylinder(0.1), [-0.14, 0.01, 0.2], [0.14, 0.01, 0.2], 0.02)
    assert np.ptp(tall.points[:, 2]) < 1e-9


def test_straight_where_nothing_is_in_the_way_and_winding_counts_the_arc() -> None:
    free = shortest_path(cylinder(0.05), [-0.2, 0.09, 0.2], [0.2, 0.09, 0.2], 0.03)
    assert free.length == free.free_length == pytest.approx(0.4)
    assert len(free.points) == 2
    assert winding(free) == 0
    path = shortest_path(cylinder(0.05), [-0.16, 0, 0.2], [0.16, 0, 0.2], 0.03)
    assert winding(path) == pytest.approx(np.pi - 2 * np.arccos(0.5), abs=1e-4)
    assert path.free_length == pytest.approx(0.32)


def test_cached_read_only_and_fast() -> None:
    rng = np.random.default_rng(15)
    lathe = vase(rng)
    start, goal = across(lathe, 0.03, rng)
    assert shortest_path(lathe, start, goal, 0.03) is shortest_path(lathe, list(start), goal, 0.03)
    with pytest.raises(ValueError, match="read-only"):
        shortest_path(lathe, start, goal, 0.03).points[0] = 0
    spent = []
    for clearance in np.linspace(0.02, 0.0295, 7):
        begin = time.process_time()
        shortest_path(lathe, start, goal, float(clearance))
        spent.append(time.process_time() - begin)
    assert np.median(spent) < 0.15  # 0.025 s on a quiet machine


@pytest.mark.parametrize(
    ("start", "goal", "clearance", "message"),
    [
        ([0.06, 0, 0.2], [0.2, 0, 0.2], 0.03, "start"),
        ([0.2, 0, 0.2], [0, 0, 0.2], 0.03, "goal"),
        ([0.2, 0, np.nan], [-0.2, 0, 0.2], 0.03, "start"),
        ([0.2, 0, 0.2], [-0.2, 0], 0.03, "goal"),
        ([0.2, 0, 0.2], [-0.2, 0, 0.2], 0.0, "clearance"),
        ([0.2, 0, 0.2], [-0.2, 0, 0.2], np.nan, "clearance"),
    ],
)
def test_what_is_refused(start: list[float], goal: list[float], clearance: float, message: str) -> None:
    with pytest.raises(InvalidInput, match=message):
        shortest_path(cylinder(0.05), start, goal, clearance)


def test_paths_are_checked() -> None:
    with pytest.raises(InvalidInput, match="points"):
        Path(np.zeros((1, 3)), 0.0)
    with pytest.raises(InvalidInput, match="length"):
        Path(np.zeros((2, 3)), np.nan)


@pytest.mark.slow
def test_many_vases_and_superquadrics() -> None:
    rng = np.random.default_rng(16)
    for _ in range(40):
        lathe, clearance = vase(rng), rng.uniform(0.01, 0.06)
        start, goal = across(lathe, clearance, rng)
        exact = shortest_path(lathe, start, goal, clearance).length
        assert exact == pytest.approx(string_path(lathe, start, goal, clearance)[1], rel=2e-5)
    for _ in range(6):
        a, b = rng.uniform(0.04, 0.09, 2)
        body = Superquadric(a, b, 0.15, rng.uniform(0.3, 1), rng.uniform(0.4, 1))
        far = np.hypot(a, b) + 0.06
        path = shortest_path(body, [-far, 0.01, 0], [far, 0, 0.02], 0.03)
        assert body.signed_distance(path.points).min() > 0.03 - 1e-5
        assert path.free_length < path.length < np.pi * far
