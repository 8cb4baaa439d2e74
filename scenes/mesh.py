"""Triangle meshes taken as samples of a smooth surface."""

import re
from dataclasses import dataclass
from functools import cached_property
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import cKDTree  # pyright: ignore[reportAttributeAccessIssue]

from extremal.estimator.errors import InvalidInput, SceneError
from extremal.estimator.reading import read_bytes
from extremal.scenes.curves import Array, Piece, SurfaceCurve
from extremal.scenes.grids import MEASURED, Facets
from extremal.scenes.mesh_contour import zero_polylines
from extremal.scenes.surface import Surface

MOST_FACES = 200_000
LARGEST_FILE = 50_000_000  # bytes
SMALLEST = 1e-4  # [m]
MOST_LINES, LONGEST_LINE = 5 * MOST_FACES, 10_000  # of an OBJ file: its parser is slow
FORMATS = (".obj", ".off", ".ply", ".stl")
OBJ_LINES = re.compile(rb"^[ \t]*(?:v|vt|vn|f)[ \t].*$", re.MULTILINE)  # no materials, which name other files


@dataclass(frozen=True, eq=False)
class Mesh(Surface):
    """Closed triangle mesh with normals that are interpolated linearly from its vertices.

    Limits. The truth is that of the interpolated normals: contour generators cross triangles in straight
    segments and are off the underlying surface by the order of (edge length)^2 x curvature / 8; curvatures
    are constant in a triangle and accurate to the order of edge length x curvature. Distances and rays are
    exact for the flat triangles. There are no creases: sharp edges are smoothed by the vertex normals.

    Attributes:
        vertices: (V, 3) [m] in the object frame.
        faces: (F, 3) vertex indices, counter-clockwise seen from outside; up to 200000.

    Raises:
        SceneError: for a mesh that is not closed and consistently oriented.
    """

    vertices: Array
    faces: NDArray[np.integer]

    @classmethod
    def from_trimesh(cls, mesh: trimesh.Trimesh, **common: Any) -> "Mesh":
        """The surface of a trimesh mesh; `common` are the attributes of `Surface`."""
        return cls(np.array(mesh.vertices, float), np.array(mesh.faces), **common)

    @classmethod
    def from_file(cls, path: str | Path, scale: float = 1.0, **common: Any) -> "Mesh":
        """The surface in an OBJ, OFF, PLY or STL file, whose unit is `scale` metres.

        Raises:
            SceneError: for a file that cannot be read as one closed mesh.
        """
        path = Path(path)
        if path.suffix.lower() not in FORMATS:
            raise SceneError(f"mesh file is {path.name!r}; accepted: {', '.join(FORMATS)}")
        try:
            content = read_bytes(path, LARGEST_FILE)
        except InvalidInput as error:
            raise SceneError(f"mesh file {error}") from None
        try:
            mesh = _parsed(content, path.suffix.lower()[1:])
            vertices, faces = np.array(mesh.vertices, float) * scale, np.array(mesh.faces)
        except Exception as error:  # noqa: BLE001  parsers raise anything on damaged files
            raise SceneError(f"mesh file {path.name!r} cannot be read: {error!r:.120}") from None
        try:
            return cls(vertices, faces, **common)
        except SceneError as error:
            raise SceneError(f"mesh file {path.name!r}: {error}") from None

    def _check(self) -> None:
        vertices, faces = np.asarray(self.vertices, float), np.asarray(self.faces)
        if vertices.ndim != 2 or vertices.shape[1:] != (3,) or not np.all(np.abs(vertices) <= 100):
            raise SceneError(f"{self.name}: vertices must be (V, 3) finite numbers within 100 m")
        if len(vertices) and not np.ptp(vertices, axis=0).max() >= SMALLEST:
            size = float(np.ptp(vertices, axis=0).max())
            raise SceneError(f"{self.name}: the mesh is {size:.3g} m long; accepted: {SMALLEST} to 200 m")
        if faces.ndim != 2 or faces.shape[1:] != (3,) or not np.issubdtype(faces.dtype, np.integer):
            raise SceneError(f"{self.name}: faces are {faces.dtype} {faces.shape}; accepted: integers (F, 3)")
        if not 4 <= len(faces) <= MOST_FACES or faces.min() < 0 or faces.max() >= len(vertices):
            raise SceneError(
                f"{self.name}: the mesh has {len(faces)} faces of {len(vertices)} vertices; accepted: 4 to {MOST_FACES} faces "
                "that refer to the vertices"
            )
        if not (self._mesh.is_watertight and self._mesh.is_winding_consistent and self._mesh.volume > 0):
            raise SceneError(
                f"{self.name}: the mesh must be closed, with faces counter-clockwise from outside"
            )
        if not np.all(self._mesh.area_faces > 0):
            raise SceneError(f"{self.name}: the mesh has a face without area")

    @cached_property
    def _mesh(self) -> trimesh.Trimesh:
        return trimesh.Trimesh(np.asarray(self.vertices, float), np.asarray(self.faces), process=False)

    @cached_property
    def _corners(self) -> Array:
        return np.array(self._mesh.triangles)

    @cached_property
    def _vertex_normals(self) -> Array:
        return np.array(self._mesh.vertex_normals)

    @cached_property
    def _centroids(self) -> tuple[Any, float]:
        """Tree of the triangles' centroids, and the largest distance from a centroid to its corners."""
        centroids = self._corners.mean(axis=1)
        return cKDTree(centroids), float(np.linalg.norm(self._corners - centroids[:, None], axis=2).max())

    @property
    def _grazing_margin(self) -> float:
        return 3 * float(np.median(self._mesh.edges_unique_length))

    @property
    def _bounds(self) -> tuple[Array, float]:
        centre = self._mesh.bounds.mean(axis=0)
        return centre, float(np.linalg.norm(self._mesh.vertices - centre, axis=1).max()) * (1 + 1e-9)

    def _nearest(self, p: Array) -> tuple[NDArray[np.integer], Array]:
        """Triangles (N,) nearest to points (N, 3), and the nearest points (N, 3) on them."""
        tree, reach = self._centroids
        candidates = tree.query_ball_point(p, tree.query(p)[0] * (1 + 1e-9) + reach)
        sizes = np.array([len(c) for c in candidates])
        rows, triangles = np.repeat(np.arange(len(p)), sizes), np.concatenate([*candidates, []]).astype(int)
        q = trimesh.triangles.closest_point(self._corners[triangles], p[rows])
        distance = np.linalg.norm(q - p[rows], axis=1)
        order = np.lexsort((distance, rows))
        first = order[np.concatenate([[0], np.cumsum(sizes)[:-1]])] if len(p) else order
        return triangles[first], q[first]

    def _frame(self, p: Array) -> tuple[Array, Array]:
        flat = p.reshape(-1, 3)
        triangles, q = self._nearest(flat)
        corners, normals = self._corners[triangles], self._vertex_normals[self._mesh.faces[triangles]]
        weights = trimesh.triangles.points_to_barycentric(corners, q)
        blend = np.einsum("nk,nki->ni", weights, normals)
        length = np.linalg.norm(blend, axis=1)[:, None]
        n = blend / length
        # Gradients (n, 3 corners, 3) of the barycentric coordinates: opposite edge turned inwards, over twice the area.
        face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        opposite = np.roll(corners, -2, axis=1) - np.roll(corners, -1, axis=1)
        gradients = np.cross(face[:, None], opposite) / np.sum(face * face, axis=1)[:, None, None]
        J = np.einsum("nki,nkj->nij", normals, gradients) / length[..., None]
        tangent = np.eye(3) - n[:, :, None] * n[:, None, :]
        S = tangent @ (J + np.swapaxes(J, 1, 2)) @ tangent / 2
        return n.reshape(p.shape), S.reshape(*p.shape, 3)

    def _level(self, p: Array) -> Array:
        return self._signed_distance(p.reshape(-1, 3)).reshape(p.shape[:-1])

    def _signed_distance(self, p: Array) -> Array:
        """Distance to the nearest triangle; inside is where the triangles' solid angles sum to 4 pi."""
        _, q = self._nearest(p)
        distance = np.linalg.norm(p - q, axis=1)
        inside = np.zeros(len(p), bool)
        step = max(1, 2_000_000 // len(self._corners))
        for i in range(0, len(p), step):
            a, b, c = np.moveaxis(self._corners - p[i : i + step, None, None], 2, 0)
            la, lb, lc = (np.linalg.norm(x, axis=-1) for x in (a, b, c))
            ab, bc, ca = np.sum(a * b, axis=-1), np.sum(b * c, axis=-1), np.sum(c * a, axis=-1)
            # Van Oosterom and Strackee (1983)
            volume = np.sum(a * np.cross(b, c), axis=-1)
            angle = 2 * np.arctan2(volume, la * lb * lc + ab * lc + bc * la + ca * lb)
            inside[i : i + step] = np.sum(angle, axis=1) > 2 * np.pi
        return np.where(inside, -distance, distance)

    def _intersect(self, origins: Array, directions: Array) -> Array:
        """Moeller and Trumbore (1997), all rays against all triangles.

        The triple products are written with the moments o x d, so that they are matrix products.
        """
        a = self._corners[:, 0]
        e1, e2 = self._corners[:, 1] - a, self._corners[:, 2] - a
        face, a_e1, e2_a = np.cross(e1, e2), np.cross(a, e1), np.cross(e2, a)
        level = np.sum(a * face, axis=1)
        t = np.full(len(origins), np.inf)
        step = max(1, 2_000_000 // len(a))
        for i in range(0, len(t), step):
            o, d = origins[i : i + step], directions[i : i + step]
            moment = np.cross(o, d)
            with np.errstate(divide="ignore", invalid="ignore"):
                f = -1 / (d @ face.T)
                u = f * (moment @ e2.T - d @ e2_a.T)
                v = -f * (moment @ e1.T + d @ a_e1.T)
                along = f * (o @ face.T - level)
                hit = (u >= -1e-12) & (v >= -1e-12) & (u + v <= 1 + 1e-12) & (along > 0)
            t[i : i + step] = np.where(hit, along, np.inf).min(axis=1)
        return t

    def _contour(self, centre: Array) -> list[Array]:
        """Zeros of n.(r - c), interpolated linearly in every triangle from its vertices."""
        vertices = self._mesh.vertices
        level = np.sum(self._vertex_normals * (vertices - centre), axis=1)
        return zero_polylines(np.array(vertices), self._mesh.faces, level)

    def contour_points_in_planes(self, start: Any, centre: Any, plane_normals: Any) -> Array:
        """The starting points themselves: on a mesh a contour generator is no better known than its polyline."""
        return np.asarray(start, float)

    def _fixed(self) -> list[SurfaceCurve]:
        return []

    def _pieces(self, facets: Facets = MEASURED) -> list[Piece]:
        return [
            Piece(np.array(self._mesh.vertices), self._vertex_normals, self._mesh.faces, self.appearance.rgba)
        ]


def _parsed(content: bytes, kind: str) -> trimesh.Trimesh:
    """The triangles of a file whose suffix is `kind`: from these bytes alone, no other file is looked at."""
    if kind == "obj":
        lines = OBJ_LINES.findall(content.replace(b"\\\n", b" ").replace(b"\r\n", b"\n"))
        if len(lines) > MOST_LINES or max(map(len, lines), default=0) > LONGEST_LINE:
            raise ValueError(f"{len(lines)} lines; accepted: {MOST_LINES} lines of {LONGEST_LINE} characters")
        content = b"\n".join(lines)
    with np.errstate(all="ignore"):
        mesh = trimesh.load_mesh(BytesIO(content), file_type=kind, process=False, skip_materials=True)
    # A number that is not finite is an error, and not, as in trimesh's own processing, a face less.
    if not np.all(np.isfinite(mesh.vertices)):
        raise ValueError("a vertex is not finite")
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    return mesh
