"""The meshes that MuJoCo draws against the surfaces they stand for."""

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from extremal.scenes import Sphere, Superquadric, Surface, load_scene

FOCAL, DISTANCE, BASELINE = 800.0, 0.5, 0.1


def triangles(surface: Surface) -> tuple[np.ndarray, np.ndarray]:
    pieces = surface._pieces()
    offsets = np.cumsum([0] + [len(piece.vertices) for piece in pieces[:-1]])
    vertices = np.concatenate([surface._world(piece.vertices) for piece in pieces])
    return vertices, np.concatenate([p.faces + o for p, o in zip(pieces, offsets, strict=True)])


def cut(vertices: np.ndarray, edges: np.ndarray, centre: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Points in which a plane crosses the edges of a mesh."""
    height = (vertices - centre) @ normal
    crossing = edges[(height[edges[:, 0]] > 0) != (height[edges[:, 1]] > 0)]
    a, b = height[crossing[:, 0]], height[crossing[:, 1]]
    start = vertices[crossing[:, 0]]
    return start + (a / (a - b))[:, None] * (vertices[crossing[:, 1]] - start)


def radius(
    angles: list[float], centres: list[np.ndarray], x: np.ndarray, y: np.ndarray, side: float
) -> float:
    """Cipolla ch. 3, eq. 3.21-3.23: the circle that touches three rays of a plane."""
    normals = [side * (np.cos(a) * y - np.sin(a) * x) for a in angles]
    rows = [[n @ x, n @ y, 1.0] for n in normals]
    return np.linalg.solve(rows, [n @ c for n, c in zip(normals, centres, strict=True)])[2]


MEASURED = [
    load_scene("vase-and-box")["vase"],
    load_scene("waisted-vase")["vase"],
    load_scene("sphere")["sphere"],
    load_scene("ellipsoid")["ellipsoid"],
    Superquadric(0.05, 0.04, 0.06, 0.7, 0.8),
]


@pytest.mark.parametrize("surface", MEASURED, ids=lambda s: s.name)
def test_silhouette_and_its_three_tangent_radius_are_those_of_the_surface(surface: Surface) -> None:
    rng = np.random.default_rng(0)
    vertices, faces = triangles(surface)
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    pixels, radii = [], []
    while len(radii) < 16:
        azimuth, elevation = rng.uniform(0, 2 * np.pi), np.radians(rng.uniform(0, 20))
        away = [np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)]
        middle = vertices.mean(axis=0) + DISTANCE * np.array(away)
        travel = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
        curves = surface.contour_generator(middle)
        curve = curves[rng.integers(len(curves))]
        q = curve.points[rng.choice(np.nonzero(curve.visible)[0][10:-10])]
        plane = np.cross(q - middle, travel)
        plane /= np.linalg.norm(plane)
        normal = surface.normals(q)
        if abs(normal @ plane) > 0.7 or surface.section_radius(q, plane) > 0.1:
            continue
        x = (q - middle) / np.linalg.norm(q - middle)
        y = np.cross(plane, x)
        side = float(np.sign(y @ normal))
        polygon = cut(vertices, edges, middle, plane)
        # On a lathe another part of the section may reach further out than the limb in question.
        polygon = polygon[np.linalg.norm(polygon - q, axis=1) < 0.03]
        centres = [middle + b * travel for b in (-BASELINE / 2, 0, BASELINE / 2)]
        seen, true = [], []
        for c in centres:
            d = polygon - c
            seen.append(side * np.max(side * np.arctan2(d @ y, d @ x)))
            d = surface.contour_points_in_planes(q[None], c, plane[None])[0] - c
            true.append(np.arctan2(d @ y, d @ x))
        pixels += [FOCAL * (a - b) for a, b in zip(seen, true, strict=True)]
        radii.append(radius(seen, centres, x, y, side) - radius(true, centres, x, y, side))
    assert np.abs(pixels).max() < 0.005
    assert np.std(radii) < 1e-4


@pytest.mark.parametrize("name", ["vase-and-box", "sphere", "textured-vase"])
def test_compiled_vertices_and_normals_stay_where_they_were(name: str) -> None:
    scene = load_scene(name)
    model = scene.to_spec().compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert not np.any(model.light_castshadow)
    for surface in scene.objects:
        for i, piece in enumerate(surface._pieces()):
            geom = model.geom(f"{surface.name}/{i}").id
            mesh = model.geom_dataid[geom]
            start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
            rotation, shift = data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom]
            vertices = model.mesh_vert[start : start + count].astype(float) @ rotation.T + shift
            assert vertices.shape == piece.vertices.shape
            assert np.abs(vertices - surface._world(piece.vertices)).max() < 1e-7
            start, count = model.mesh_normaladr[mesh], model.mesh_normalnum[mesh]
            normals = model.mesh_normal[start : start + count].astype(float) @ rotation.T
            assert np.abs(normals - piece.normals @ surface._rotation.T).max() < 1e-6


@pytest.mark.parametrize("name", ["vase-and-box", "textured-vase"])
def test_faces_look_outwards_and_markings_tile_the_surface(name: str) -> None:
    for surface in load_scene(name).objects:
        area = 0.0
        volume = 0.0
        for piece in surface._pieces():
            a, b, c = np.moveaxis(piece.vertices[piece.faces], 1, 0)
            face = np.cross(b - a, c - a)
            assert np.all(np.sum(face * piece.normals[piece.faces[:, 0]], axis=1) > 0)
            area += np.linalg.norm(face, axis=1).sum() / 2
            volume += np.sum(a * np.cross(b, c)) / 6
        if surface.name == "vase":
            z = np.linspace(0, surface.profile.height, 20001)  # pyright: ignore[reportAttributeAccessIssue]
            r, r1, _ = surface.profile.derivatives(z)  # pyright: ignore[reportAttributeAccessIssue]
            exact = 2 * np.pi * np.trapezoid(r * np.sqrt(1 + r1 * r1), z) + np.pi * (r[0] ** 2 + r[-1] ** 2)
            assert area == pytest.approx(exact, rel=1e-4)
            assert volume == pytest.approx(np.pi * np.trapezoid(r * r, z), rel=1e-4)
        else:
            x, y, z = surface.size  # pyright: ignore[reportAttributeAccessIssue]
            assert area == pytest.approx(2 * (x * y + y * z + z * x))
            assert volume == pytest.approx(x * y * z)


def test_sphere_silhouette_agrees_with_rays_cast_by_mujoco() -> None:
    """Bisect `mj_ray` against MuJoCo's own sphere: no code of ours in it."""
    spec = mujoco.MjSpec()  # pyright: ignore[reportAttributeAccessIssue]
    kind = mujoco.mjtGeom.mjGEOM_SPHERE  # pyright: ignore[reportAttributeAccessIssue]
    spec.worldbody.add_geom(type=kind, size=[0.05, 0, 0], pos=[0.02, 0.01, 0.1])
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    sphere = Sphere(0.05, T_world_object=RigidTransform.from_translation([0.02, 0.01, 0.1]))
    centre = np.array([-0.5, 0.1, 0.2])
    (curve,) = sphere.contour_generator(centre)
    hit = np.zeros(1, np.int32)
    for p, n in zip(curve.points[::100], curve.normals[::100], strict=True):
        inside, outside = -1e-3, 1e-3
        for _ in range(40):
            offset = (inside + outside) / 2
            ray = p + offset * n - centre
            found = mujoco.mj_ray(model, data, centre, ray / np.linalg.norm(ray), None, 1, -1, hit) >= 0
            inside, outside = (offset, outside) if found else (inside, offset)
        assert abs(inside) < 1e-9
