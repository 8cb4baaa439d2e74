"""Visible edges in simple arrangements, and the truth of exact image points."""

import time

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from extremal.estimator.errors import SceneError
from extremal.scenes import Box, Lathe, LathePatch, Scene, Sphere, load_scene, randomised
from extremal.scenes.loading import presets

CENTRE = np.array([-0.6, 0.05, 0.24])
TRAVEL = np.array([0.0, 1.0, 0.0])


def at(x: float, y: float, z: float) -> RigidTransform:
    return RigidTransform.from_translation([x, y, z])


def test_nearer_sphere_hides_the_farther_one() -> None:
    near = Sphere(0.05, name="near", T_world_object=at(-0.2, 0, 0))
    far = Sphere(0.05, name="far", T_world_object=at(0.2, 0, 0))
    half = Sphere(0.05, name="half", T_world_object=at(0.1, 0.06, 0))
    edges = {curve.object: curve for curve in Scene((near, far, half)).true_edges([-0.7, 0, 0])}
    assert edges["near"].visible.all()
    assert not edges["far"].visible.any()
    assert 0.2 < edges["half"].visible.mean() < 0.98
    # Where `half` is seen, its image lies outside the cone of `near`.
    ray = edges["half"].points - [-0.7, 0, 0]
    angle = np.arccos(ray[:, 0] / np.linalg.norm(ray, axis=1))
    assert np.array_equal(edges["half"].visible, angle > np.arcsin(0.05 / 0.5))


def test_box_shows_nine_edges_of_twelve() -> None:
    box = Box((0.1, 0.1, 0.1), name="box")
    edges = Scene((box,)).true_edges([-0.5, -0.6, 0.7])
    assert sorted(curve.visible.mean() for curve in edges) == [0.0] * 3 + [1.0] * 9
    front = Scene((box,)).true_edges([-0.5, 0.0, 0.0])
    assert sum(curve.visible.all() for curve in front) == 4


def test_marking_is_seen_from_its_own_side_alone() -> None:
    patch = LathePatch("spot", np.pi, 0.6, 0.05, 0.08, (1, 1, 1, 1))
    vase = Lathe((0.0, 0.2), (0.04, 0.04), (patch,), name="vase")
    for x, seen in ((-0.5, True), (0.5, False)):
        edges = [c for c in Scene((vase,)).true_edges([x, 0, 0.3]) if c.kind == "marking"]
        assert len(edges) == 4
        assert all(curve.visible.all() == seen and curve.visible.any() == seen for curve in edges)
        for curve in edges:
            assert np.abs(vase.signed_distance(curve.points)).max() < 1e-12
            assert np.linalg.norm(np.diff(curve.points, axis=0), axis=1).max() <= 5e-4


def test_rim_of_a_standing_vase_is_whole_and_its_base_half_seen() -> None:
    scene = load_scene("vase-and-box")
    edges = {curve.name: curve for curve in scene.true_edges(CENTRE)}
    assert edges["vase/rim"].visible.all()
    assert 0.4 < edges["vase/base"].visible.mean() < 0.5
    for name in ("vase/limb0", "vase/limb1"):
        assert edges[name].visible.all()


def image_points(scene: Scene) -> tuple[np.ndarray, ...]:
    """Exact rays, tangent planes (from neighbours alone), points, names and kinds of all visible edges."""
    rays, planes, points, names, kinds = [], [], [], [], []
    for curve in scene.true_edges(CENTRE):
        rows = np.arange(6, len(curve.points) - 6, 9)
        rows = rows[curve.visible[rows]]
        ray = curve.points - CENTRE
        rays.append(ray[rows] / np.linalg.norm(ray[rows], axis=1)[:, None])
        plane = np.cross(ray[rows - 1], ray[rows + 1])
        planes.append(plane / np.linalg.norm(plane, axis=1)[:, None])
        points.append(curve.points[rows])
        names += [curve.name] * len(rows)
        kinds += [curve.kind] * len(rows)
    return (
        np.concatenate(rays),
        np.concatenate(planes),
        np.concatenate(points),
        np.array(names),
        np.array(kinds),
    )


@pytest.mark.parametrize("name", presets())
def test_exact_points_are_matched_with_themselves(name: str) -> None:
    scene = load_scene(name)
    rays, planes, points, names, kinds = image_points(scene)
    epipolar = np.cross(rays, TRAVEL)
    truth = scene.truth(CENTRE, rays, planes, epipolar)
    assert truth.matched.all()
    assert np.mean(truth.curve == names) > 0.995  # where two edges meet either will do
    same = truth.curve == names
    assert np.array_equal(truth.kind[same], kinds[same])
    assert np.abs(truth.distance).max() < 1e-5
    extremal = same & (kinds == "extremal")
    assert np.abs(truth.point - points)[extremal].max() < 1e-9
    assert np.abs(truth.distance[extremal]).max() < 1e-9
    assert np.all(truth.radius[extremal] > 0)
    assert np.all(truth.radius[~extremal & same] == 0)
    assert np.all(np.isnan(truth.gaussian_curvature[~extremal & same]))
    assert np.all(np.isfinite(truth.gaussian_curvature[extremal]))


def test_truth_of_shifted_points_lies_in_their_epipolar_planes() -> None:
    scene = load_scene("vase-and-box")
    rays, planes, _, names, kinds = image_points(scene)
    shifted = rays + 0.001 * planes
    shifted /= np.linalg.norm(shifted, axis=1)[:, None]
    epipolar = np.cross(shifted, TRAVEL)
    epipolar /= np.linalg.norm(epipolar, axis=1)[:, None]
    steep = np.abs(np.sum(planes * epipolar, axis=1)) < 0.8
    truth = scene.truth(CENTRE, shifted, planes, epipolar)
    good = truth.matched & steep & (truth.curve == names)
    assert good.sum() > 0.95 * steep.sum()
    ray = truth.point - CENTRE
    assert np.abs(np.sum(ray * epipolar, axis=1))[good].max() < 1e-10
    limb = good & (kinds == "extremal")
    assert np.abs(np.sum(truth.normal * ray, axis=1))[limb].max() < 1e-10
    assert truth.distance[good] == pytest.approx(0.001, rel=0.05)


def test_points_off_every_edge_or_across_one_match_nothing() -> None:
    scene = load_scene("sphere")
    (curve,) = (c for c in scene.true_edges(CENTRE) if c.kind == "extremal")
    rows = np.arange(50, len(curve.points) - 50, 50)
    rays = curve.points[rows] - CENTRE
    rays /= np.linalg.norm(rays, axis=1)[:, None]
    inside = rays - 0.02 * curve.normals[rows]
    epipolar = np.cross(rays, TRAVEL)
    assert not scene.truth(CENTRE, inside, curve.normals[rows], epipolar).matched.any()
    across = np.cross(curve.normals[rows], rays)
    truth = scene.truth(CENTRE, rays, across, epipolar)
    assert "extremal" not in truth.kind
    assert np.all(np.isnan(truth.radius[~truth.matched]))


def test_sphere_radius_is_that_of_its_epipolar_section() -> None:
    scene = load_scene("sphere")
    rays, planes, _, _, kinds = image_points(scene)
    rays, planes = rays[kinds == "extremal"], planes[kinds == "extremal"]
    epipolar = np.cross(rays, TRAVEL)
    epipolar /= np.linalg.norm(epipolar, axis=1)[:, None]
    truth = scene.truth(CENTRE, rays, planes, epipolar)
    away = np.abs(epipolar @ (np.array([0, 0, 0.05]) - CENTRE))
    assert truth.radius == pytest.approx(np.sqrt(0.05**2 - away**2), abs=1e-9)
    assert truth.gaussian_curvature == pytest.approx(400)


def test_edges_of_the_default_scene_take_less_than_a_second() -> None:
    scene = load_scene("vase-and-box")
    start = time.perf_counter()
    scene.true_edges(CENTRE)
    assert time.perf_counter() - start < 1


def test_random_scenes_repeat_with_the_seed_and_stay_within_bounds() -> None:
    scene = load_scene("vase-and-box")
    for seed in range(20):
        a, b = (randomised(scene, np.random.default_rng(seed)) for _ in range(2))
        vase, again = a["vase"], b["vase"]
        assert isinstance(vase, Lathe)
        assert isinstance(again, Lathe)
        assert vase.profile_r == again.profile_r
        assert a.lights == b.lights
        assert 0.025 <= vase.profile.smallest < vase.profile.largest <= 0.055
        assert all(light.direction[0] > 0 > light.direction[2] for light in a.lights)
        for y in (-0.2, 0.2):  # the box never hides the vase
            edges = a.true_edges([-0.6, y, 0.24])
            limbs = [c for c in edges if c.object == "vase" and c.kind == "extremal"]
            convex = np.concatenate([c.visible for c in limbs])
            alone = np.concatenate([c.visible for c in vase.contour_generator([-0.6, y, 0.24])])
            assert np.array_equal(convex, alone)


def test_bad_camera_centre_is_refused() -> None:
    with pytest.raises(SceneError, match="camera centre"):
        load_scene("sphere").true_edges([np.nan, 0, 0])
