"""What stands for objects in collisions: primitives where they are exact, convex pieces of a lathe, hulls.

MuJoCo collides a mesh as its convex hull, which fills a waist. A lathe is therefore cut by planes across its
axis into slices, each the hull of two rings. True geometry is asked of the surface itself, never of these pieces.
"""

# mujoco's compiled classes come without type stubs.
# pyright: reportAttributeAccessIssue=false

from typing import Any

import mujoco
import numpy as np

from extremal.estimator.errors import SceneError
from extremal.scenes.box import Box
from extremal.scenes.curves import Array
from extremal.scenes.grids import adaptive_grid
from extremal.scenes.lathe import Lathe
from extremal.scenes.mesh import Mesh
from extremal.scenes.mjcf import Spec
from extremal.scenes.profile import Profile
from extremal.scenes.quadrics import Ellipsoid, Sphere
from extremal.scenes.superquadric import Superquadric
from extremal.scenes.surface import Surface

SLICES, SIDES = 48, 64  # of a lathe, at most, and of each of its rings
CHORD = 1e-5  # by which slices leave the profile [m], where SLICES of them are enough
CONVEX = 1e-6  # a mesh that leaves its hull by less is convex [m]


def add_collision(spec: Spec, body: Any, surface: Surface, **attributes: Any) -> None:
    """Give a body geoms that collide as the surface does, in the object frame.

    Args:
        spec: the model, to which meshes called "name/hull0", ... are added.
        body: of the model.
        surface: its shape; its pose is not used.
        attributes: of every geom, such as `contype`.

    Raises:
        SceneError: the surface is neither convex nor a lathe.
    """
    geom = mujoco.mjtGeom
    if isinstance(surface, Sphere):
        body.add_geom(type=geom.mjGEOM_SPHERE, size=[surface.radius, 0, 0], **attributes)
    elif isinstance(surface, Ellipsoid):
        body.add_geom(type=geom.mjGEOM_ELLIPSOID, size=[surface.a, surface.b, surface.c], **attributes)
    elif isinstance(surface, Box):
        body.add_geom(type=geom.mjGEOM_BOX, size=np.array(surface.size, float) / 2, **attributes)
    else:
        for i, vertices in enumerate(convex_pieces(surface)):
            name = f"{surface.name}/hull{i}"
            spec.add_mesh(name=name, uservert=vertices.astype(np.float32).ravel())
            body.add_geom(type=geom.mjGEOM_MESH, meshname=name, **attributes)


def convex_pieces(surface: Surface) -> list[Array]:
    """Vertices (V, 3) [m], object frame, of the convex pieces that together stand for a surface.

    Raises:
        SceneError: the surface is neither a lathe, a superquadric nor a convex mesh.
    """
    if isinstance(surface, Lathe):
        return _lathe_slices(surface.profile)
    if isinstance(surface, Superquadric):
        return [np.unique(barr_grid(surface, SIDES // 2, SIDES).reshape(-1, 3), axis=0)]
    if isinstance(surface, Mesh) and _is_convex(surface):
        return [np.asarray(surface.vertices, float)]
    raise SceneError(
        f"{surface.name}: a {type(surface).__name__.lower()} that is not convex has no collision shape; accepted: "
        "lathes, spheres, ellipsoids, superquadrics, boxes, convex meshes"
    )


def _lathe_slices(profile: Profile) -> list[Array]:
    """The solids between neighbouring rings, at most `SLICES`, dense where the profile bends."""
    samples = np.linspace(0, profile.height, 2001)
    _, r1, r2 = profile.derivatives(samples)
    bending = np.abs(r2) / np.sqrt(1 + r1 * r1)
    z = adaptive_grid(samples, bending, samples[[0, -1]], most=SLICES, chord=CHORD)
    angle = 2 * np.pi / SIDES * np.arange(SIDES)
    # Corners lie outside of the circle by as much as the sides' middles lie inside.
    radius = profile.spline(z)[:, None] * 2 / (1 + np.cos(np.pi / SIDES))
    height = np.broadcast_to(z[:, None], (len(z), SIDES))
    rings = np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=-1)
    return [np.concatenate(rings[i : i + 2]) for i in range(len(rings) - 1)]


def barr_grid(surface: Sphere | Ellipsoid | Superquadric, rows: int, columns: int) -> Array:
    """Points (rows + 1, columns, 3) of the surface, object frame, at equal steps of Barr's angles (1981), from pole to pole.

    They are densest along the rounded edges.
    """
    e1, e2 = (surface.e1, surface.e2) if isinstance(surface, Superquadric) else (1.0, 1.0)
    eta = np.linspace(-np.pi / 2, np.pi / 2, rows + 1)[:, None]
    omega = 2 * np.pi / columns * np.arange(columns)

    def power(x: Array, e: float) -> Array:
        return np.sign(x) * np.abs(np.where(np.abs(x) < 1e-15, 0, x)) ** e

    around, up = power(np.cos(eta), e1), power(np.sin(eta), e1)
    x, y = around * power(np.cos(omega), e2), around * power(np.sin(omega), e2)
    return np.stack(np.broadcast_arrays(x, y, up), axis=-1) * surface._axes


def _is_convex(surface: Mesh) -> bool:
    """Whether no vertex lies in front of any face."""
    vertices, faces = np.asarray(surface.vertices, float), np.asarray(surface.faces)
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    n = np.cross(b - a, c - a)
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    level = np.sum(n * a, axis=1)
    step = max(1, 4_000_000 // len(vertices))
    return all(
        np.max(vertices @ n[i : i + step].T - level[i : i + step]) < CONVEX for i in range(0, len(n), step)
    )
