"""The bound of the joint study against finite differences of exact angles; its synthetic scenes; its table."""

import numpy as np
import pytest
from jacobian import numeric_jacobian

from extremal.estimator.camera import Array
from extremal.estimator.poses import PosePrior
from extremal.scripts.joint_study import (
    CASES,
    POSITION,
    RADIUS,
    ROTATION,
    JointRow,
    joint_study,
    radius_bounds,
    study_table,
)
from extremal.scripts.spatial_study import random_scene
from extremal.scripts.synthetic import observe

KNOWN = {0: 15.4, 1: 1.12, 2: 0.61, 3: 0.15}  # [mm] published with the cases: bounds where poses are known


@pytest.mark.parametrize("case", range(len(CASES)))
def test_bounds_against_finite_differences_of_exact_angles(case: int) -> None:
    planar = CASES[case]
    v, centres = planar.scene.T_world_camera.translation[:, :2], planar.scene.centres[:, :2]
    views, n = len(v), len(centres)

    def angles(x: Array) -> Array:
        """Of tangents from cameras (x, y, turn) to circles (x, y, R), R = 0 but for the first."""
        cameras, shapes, radius = x[: 3 * views].reshape(views, 3), x[3 * views : -1].reshape(n, 2), x[-1]
        towards = shapes[:, None] - cameras[:, :2]
        R = np.where(np.arange(n) == 0, radius, 0.0)[:, None]
        tilt = np.arcsin(R / np.linalg.norm(towards, axis=-1))
        return (np.arctan2(towards[..., 1], towards[..., 0]) + tilt - cameras[:, 2]).ravel()

    at = np.concatenate([np.pad(v, ((0, 0), (0, 1))).ravel(), centres.ravel(), [RADIUS]])
    J = numeric_jacobian(angles, at) / planar.sigma
    information, shape = J.T @ J, slice(3 * views, None)
    known = np.sqrt(np.linalg.inv(information[shape, shape])[-1, -1])
    prior = np.tile([POSITION**-2, POSITION**-2, ROTATION**-2], views)
    information[: 3 * views, : 3 * views] += np.diag(prior)
    bound = np.sqrt(np.linalg.inv(information)[-1, -1])
    np.testing.assert_allclose(radius_bounds(planar), [known, bound], rtol=1e-5)
    if case in KNOWN:
        assert 1e3 * known == pytest.approx(KNOWN[case], rel=0.03)


def test_synthetic_planes_touch_what_they_are_planes_of() -> None:
    scene = random_scene(7, 10, 5, np.random.default_rng(0))
    known = PosePrior(scene.T_world_camera, np.zeros((7, 6, 0)))
    sections, points = observe(scene, known, 1e-15, np.random.default_rng(1)).features
    rotations, v = scene.T_world_camera.rotation.as_matrix(), scene.T_world_camera.translation
    world = np.einsum("vjk,nlvk->nlvj", rotations, sections.normals)[:, 0]
    sphere = scene.radii != 0
    middle = scene.centres + scene.heights[:, None] * scene.plane_normals
    away = np.abs(np.sum((middle[:, None] - v) * world, axis=-1))
    size = np.hypot(scene.radii, scene.heights)
    np.testing.assert_allclose(away[sphere], np.tile(size[sphere, None], (1, 7)), atol=1e-12)
    np.testing.assert_allclose(away[~sphere], 0, atol=1e-12)
    np.testing.assert_allclose(np.einsum("nvk,nk->nv", world, scene.lines)[~sphere], 0, atol=1e-12)
    np.testing.assert_allclose(scene.section_radii(sections), scene.radii, atol=1e-12)  # pyright: ignore[reportArgumentType]
    planes = np.einsum("vjk,nlvk->nlvj", rotations, points.normals)
    passing = np.einsum("nlvk,nvk->nlv", planes, scene.points[:, None] - v)
    np.testing.assert_allclose(passing, 0, atol=1e-12)


def test_study_and_table() -> None:
    told = []
    rows = joint_study(2, lambda done, of: told.append((done, of)))
    assert told[-1] == (2 * len(CASES), 2 * len(CASES)) and len(rows) == len(CASES)
    assert all(row.converged == 1 for row in rows)
    row = JointRow(600, 400, 15, 0.1, 800.0, 1.12, 26.5, 17.1, 2.3, 1.2, 1.19, 1.01, -0.01, 0.99, 0.951, 1.0)
    assert study_table([row]).splitlines()[2] == (
        "| 600 | 400 | 15 | 0.1 | 800 | 1.12 | 26.5 | 17.1 | 2.3 | 1.2 | 1.19 | 1.010 | -0.010 | 0.990 | 95.1% | 100.0% |"
    )
