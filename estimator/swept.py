"""Which part of a surface was seen: that over which the contour generators swept from view to view; the rest is closed.

Tops and bottoms that no contour generator reaches are not in the data: silhouettes alone would close them with a tent of
tangent planes. They are closed by the surface of least area instead, which is flat where its rim is.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree  # pyright: ignore[reportAttributeAccessIssue]

from extremal.estimator.camera import Array
from extremal.estimator.closed_mesh import ClosedMesh
from extremal.estimator.silhouette import Outline

FARTHEST = 0.9  # [rad] from one view to the next as seen from the object, up to which a surface is followed
LEAST_TURN = 0.3  # of that angle, by which a surface must turn against the ray: less where a contour generator stands still
BESIDE = 3.0  # [px] from the outline at which a vertex next to the contour generator appears


def swept(mesh: ClosedMesh, outlines: Sequence[Outline]) -> NDArray[np.bool_]:
    """Vertices (V,) that a contour generator passed between views that follow each other, the last and the first included.

    There the surface faces the camera in one view and turns away in the next; and where it is nearest to the
    contour generator it appears beside the outline.
    """
    seen = np.zeros(len(mesh.vertices), bool)
    middle = mesh.vertices.mean(axis=0)
    pairs = zip(outlines, [*outlines[1:], outlines[0]], strict=True)
    for first, second in pairs:
        a, b = _facing(mesh, first.view.centre), _facing(mesh, second.view.centre)
        turn = _angle(first.view.centre - middle, second.view.centre - middle)
        passed = ((a < 0) != (b < 0)) & (np.abs(a - b) > LEAST_TURN * turn) & (turn < FARTHEST)
        for outline, nearer in ((first, np.abs(a) <= np.abs(b)), (second, np.abs(a) > np.abs(b))):
            rows = np.flatnonzero(passed & nearer & ~seen)
            if len(rows) and len(outline.pixels):
                image = outline.view.project(mesh.vertices[rows])
                apart, _ = outline.tree.query(np.where(np.isfinite(image), image, -1e6))
                seen[rows[apart < BESIDE]] = True
    return _majority(mesh, seen)


def beside(mesh: ClosedMesh, points: Array, view: NDArray[np.integer]) -> NDArray[np.bool_]:
    """Vertices (V,) no farther from points (n, 3) of contour generators, of views (n,), than these usually are from one view
    to the next.

    Where a contour generator jumps, as over a valley that no contour shows, the surface between is mere interpolation.
    """
    each = [cKDTree(points[view == k]) for k in np.unique(view)]
    gaps = [second.query(first.data)[0] for first, second in zip(each, [*each[1:], each[0]], strict=True)]
    apart, _ = cKDTree(points).query(mesh.vertices)
    return apart < np.median(np.concatenate(gaps))


def closed(mesh: ClosedMesh, free: NDArray[np.bool_]) -> ClosedMesh:
    """The mesh with the vertices that are not `free` (V,) spread evenly over the surface that the others span."""
    inner, outer = np.flatnonzero(~free), np.flatnonzero(free)
    if len(inner) == 0 or len(outer) == 0:
        return mesh
    links = mesh.neighbours[inner]
    matrix = sparse.eye_array(len(inner), format="csc") - links[:, inner].tocsc()
    vertices = mesh.vertices.copy()
    vertices[inner] = splu(sparse.csc_array(matrix)).solve(links[:, outer] @ mesh.vertices[outer])
    return mesh.moved(vertices)


def inner(mesh: ClosedMesh, mask: NDArray[np.bool_], rings: int) -> NDArray[np.bool_]:
    """A mask (V,) without its outermost rings of vertices."""
    outside = ~mask
    for _ in range(rings):
        outside = outside | (mesh.neighbours @ outside.astype(float) > 0)
    return ~outside


def _facing(mesh: ClosedMesh, centre: Array) -> Array:
    """Sine (V,) of the angle by which the surface turns away from a camera's centre (3,)."""
    ray = mesh.vertices - centre
    return np.sum(mesh.normals * ray, axis=1) / np.linalg.norm(ray, axis=1)


def _angle(a: Array, b: Array) -> float:
    return float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))


def _majority(mesh: ClosedMesh, mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """A mask (V,) without specks and holes: each vertex as most of its neighbours and itself."""
    share = mask.astype(float)
    for _ in range(3):
        share = (mesh.neighbours @ share + share > 1.0).astype(float)
    return share > 0.5
