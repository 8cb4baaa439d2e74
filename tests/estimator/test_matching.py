"""Which edgel is near a pixel, and which matches move with the camera as the others do."""

import numpy as np
import pytest
from exact_contours import cameras, exact_contours
from scipy.spatial import KDTree

from extremal.estimator import View
from extremal.estimator.matching import EdgelMap
from extremal.estimator.poses import pose_exp
from extremal.estimator.sequential import LEAST_IN_STEP, in_step
from extremal.scenes import load_scene

POSE = 2e-3  # [m], [rad]


@pytest.mark.parametrize("reach", [4, 14])
def test_edgels_near_pixels(reach: int) -> None:
    view = cameras(3)[1]
    contours = exact_contours(load_scene("sphere")["sphere"], view)
    edgels = EdgelMap(contours, view.camera.width, view.camera.height, reach)
    rng = np.random.default_rng(0)
    pixels = rng.uniform(-20, 1.05 * max(view.camera.width, view.camera.height), (3000, 2))
    pixels[::2] = rng.choice(contours.positions, 1500) + rng.uniform(-15, 15, (1500, 2))
    pixels[7] = np.nan
    found = edgels.lookup(pixels)
    np.testing.assert_array_equal(found, edgels.lookup_few(pixels))
    # an edgel stands for 2.5 px of its contour to each side, and pixels are rounded
    distance = np.nan_to_num(KDTree(contours.positions).query(np.nan_to_num(pixels, nan=1e3))[0], posinf=1e3)
    assert np.all(found[distance > reach + 2.5 + 1.5] == -1)
    size = (view.camera.width - 1, view.camera.height - 1)
    inside = np.all((pixels > 0) & (pixels < size), axis=1)
    assert np.all(found[inside & (distance < reach - 1.5)] >= 0)


def test_parameters_have_a_nearest_edgel() -> None:
    """By brute force; beyond the ends, those."""
    contours = exact_contours(load_scene("sphere")["sphere"], cameras(3)[1])
    u = np.random.default_rng(3).uniform(contours.u[0] - 9, contours.u[-1] + 9, 500)
    apart = np.abs(u[:, None] - contours.u)
    np.testing.assert_allclose(apart[np.arange(500), contours.nearest_edgel(u)], apart.min(axis=1))


def matches(view: View, rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Contact points (n, 3) in the world and tangent planes' normals in the frame of a camera."""
    p = rng.uniform([-0.15, -0.1, 0.45], [0.15, 0.1, 0.65], (n, 3))
    normals = np.cross(p, rng.standard_normal((n, 3)))
    return view.T_world_camera.apply(p), normals / np.linalg.norm(normals, axis=1, keepdims=True)


def test_tracks_on_other_contours_are_out_of_step() -> None:
    rng = np.random.default_rng(1)
    ok = np.ones(40, bool)
    for _ in range(20):
        view = cameras(3)[1]
        points, normals = matches(view, rng, 40)
        believed = View(
            view.camera,
            view.T_world_camera * pose_exp(POSE * rng.standard_normal(6)),
            view.image,
            POSE**2 * np.eye(6),
        )
        pixel = np.linalg.norm(points - view.centre, axis=1) / view.camera.fx
        there = view.T_world_camera.rotation.apply(normals)
        points = points + (0.1 * rng.standard_normal(40) * pixel)[:, None] * there
        np.testing.assert_array_equal(in_step(ok, believed, points, normals), ok)
        off = points.copy()
        off[:8] += (3.0 * pixel[:8])[:, None] * there[:8]
        np.testing.assert_array_equal(in_step(ok, believed, off, normals), np.arange(40) >= 8)


def test_too_few_matches_tell_nothing_of_each_other() -> None:
    view = cameras(3)[1]
    points, normals = matches(view, np.random.default_rng(2), 40)
    ok = np.arange(40) < LEAST_IN_STEP - 1
    np.testing.assert_array_equal(in_step(ok, view, points + 1.0, normals), ok)
