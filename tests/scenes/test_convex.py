"""Collision pieces against exact signed distances, by their hulls and by MuJoCo; shells against closed forms."""

from typing import Any

import mujoco
import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull  # pyright: ignore[reportAttributeAccessIssue]

from extremal.estimator import InvalidInput
from extremal.estimator.errors import SceneError
from extremal.scenes import Box, Ellipsoid, Lathe, Mesh, Sphere, Superquadric, Surface
from extremal.scenes.convex import SLICES, add_collision, convex_pieces
from extremal.scenes.inertia import shell_inertia

VASE = Lathe(
    (0.0, 0.03, 0.07, 0.115, 0.155, 0.18, 0.2),
    (0.034, 0.0405, 0.0455, 0.0425, 0.0345, 0.0325, 0.036),
    name="vase",
)
WAIST = Lathe(np.linspace(0, 0.2, 9), 0.05 + 0.02 * np.cos(np.linspace(0, 2 * np.pi, 9)), name="waist")
BOXY = Superquadric(0.05, 0.04, 0.06, 0.3, 0.5, name="boxy")
ROUND = Superquadric(0.05, 0.04, 0.06, 1.0, 1.0, name="round")


def surface_points(surface: Surface, n: int = 600) -> np.ndarray:
    """Points (N, 3) on the side of an upright object, spread over its height."""
    rng = np.random.default_rng(0)
    centre, radius = surface._bounds
    angle, z = rng.uniform(0, 2 * np.pi, n), centre[2] + radius * rng.uniform(-0.95, 0.95, n)
    d = -np.stack([np.cos(angle), np.sin(angle), np.zeros(n)], axis=-1)
    o = -2 * radius * d + [0, 0, 1] * z[:, None]
    t = surface.intersect(o, d)
    hit = np.isfinite(t)
    return o[hit] + t[hit, None] * d[hit]


def level(pieces: list[np.ndarray], points: np.ndarray) -> np.ndarray:
    """Signed distance (N,) to the union of hulls near their faces: the least over pieces of the farthest face plane."""
    planes = [ConvexHull(piece).equations for piece in pieces]
    return np.min([np.max(points @ e[:, :3].T + e[:, 3], axis=1) for e in planes], axis=0)


@pytest.mark.parametrize(
    ("surface", "tolerance"),
    [(VASE, 5e-5), (WAIST, 7e-5), (BOXY, 3e-4), (ROUND, 0.06 * 2 * (1 - np.cos(np.pi / 64)))],
    ids=lambda x: str(x)[:9],
)
def test_pieces_stay_with_the_surface(surface: Surface, tolerance: float) -> None:
    assert np.abs(level(convex_pieces(surface), surface_points(surface))).max() < tolerance


def test_few_slices_suffice_and_none_are_wasted() -> None:
    assert len(convex_pieces(WAIST)) <= SLICES
    assert len(convex_pieces(Lathe([0, 0.1, 0.2], [0.04] * 3))) < 12


def gap_model(surface: Surface) -> tuple[mujoco.MjModel, mujoco.MjData, int]:
    """The surface beside a small ball on a mocap body, and the ball's geom."""
    spec = mujoco.MjSpec()
    add_collision(spec, spec.worldbody.add_body(name="object"), surface)
    ball: Any = spec.worldbody.add_body(name="ball", mocap=True)
    ball.add_geom(name="ball", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.003, 0, 0])
    model = spec.compile()
    return model, mujoco.MjData(model), model.geom("ball").id


@pytest.mark.parametrize(
    "surface",
    [VASE, WAIST, BOXY, Sphere(0.05), Ellipsoid(0.03, 0.05, 0.07), Box((0.06, 0.08, 0.1))],
    ids=lambda s: s.name,
)
def test_mujoco_measures_the_true_distance(surface: Surface) -> None:
    model, data, ball = gap_model(surface)
    points = surface_points(surface, 60)
    for p in points + 0.01 * surface.normals(points):
        data.mocap_pos[0] = p
        mujoco.mj_kinematics(model, data)
        gaps = [
            mujoco.mj_geomDistance(model, data, g, ball, 0.1, None) for g in range(model.ngeom) if g != ball
        ]
        assert min(gaps) == pytest.approx(
            float(surface.signed_distance(p)) - 0.003, abs=3e-4 if surface is BOXY else 8e-5
        )


def test_convex_meshes_are_accepted_others_are_named() -> None:
    ball = trimesh.creation.icosphere(2, 0.05)
    assert len(convex_pieces(Mesh.from_trimesh(ball))) == 1
    vertices = np.array(ball.vertices)
    vertices[0] *= 0.8
    with pytest.raises(
        SceneError, match="dented: a mesh that is not convex has no collision shape; accepted: lathes"
    ):
        convex_pieces(Mesh(vertices, np.array(ball.faces), name="dented"))


def test_shells_by_closed_forms() -> None:
    ball = shell_inertia(Sphere(0.05), 3.0)
    mass = 3.0 * 4 * np.pi * 0.05**2
    assert ball.mass == pytest.approx(mass, rel=1e-4)
    np.testing.assert_allclose(ball.moments, np.eye(3) * mass * 0.05**2 * 2 / 3, rtol=3e-4, atol=1e-9)
    R, h = 0.04, 0.2
    side, cap = 2 * np.pi * R * h * 3.0, np.pi * R**2 * 3.0
    can = shell_inertia(Lathe([0, 0.1, h], [R] * 3), 3.0)
    assert can.mass == pytest.approx(side + 2 * cap, rel=1e-12)
    across = side * (R**2 / 2 + h**2 / 12) + 2 * cap * (R**2 / 4 + h**2 / 4)
    np.testing.assert_allclose(np.diag(can.moments), [across, across, side * R**2 + cap * R**2], rtol=1e-12)
    np.testing.assert_allclose(can.centre, [0, 0, h / 2], atol=1e-15)
    a, b, c = 0.06, 0.08, 0.1
    assert shell_inertia(Box((a, b, c)), 2.0).mass == pytest.approx(4 * (a * b + b * c + c * a), rel=1e-12)


def test_a_vases_shell_by_its_drawn_mesh() -> None:
    """The integral over the triangles that are drawn, whose middles of sides are exact for quadratic polynomials."""
    corners = np.concatenate([piece.vertices[piece.faces] for piece in VASE._pieces()])
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    p, w = ((corners + np.roll(corners, 1, axis=1)) / 2).reshape(-1, 3), np.repeat(area / 3, 3)
    centre = w @ p / w.sum()
    second = ((p - centre) * w[:, None]).T @ (p - centre)
    found = shell_inertia(VASE, 1.0)
    assert found.mass == pytest.approx(w.sum(), rel=1e-5)
    np.testing.assert_allclose(found.centre, centre, atol=1e-6)
    np.testing.assert_allclose(found.moments, np.trace(second) * np.eye(3) - second, rtol=1e-4, atol=1e-9)


def test_a_boxy_shell_by_its_hull() -> None:
    """Rays from all sides find points of the convex surface, whose hull has its area."""
    d = np.random.default_rng(0).normal(size=(20_000, 3))
    d /= np.linalg.norm(d, axis=1)[:, None]
    points = -d + BOXY.intersect(-d, d)[:, None] * d
    assert shell_inertia(BOXY, 1.0).mass == pytest.approx(ConvexHull(points).area, rel=1e-3)


def test_bad_density() -> None:
    with pytest.raises(InvalidInput, match=r"area density is 0\.0; accepted"):
        shell_inertia(Sphere(0.05), 0.0)
