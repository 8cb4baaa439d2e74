"""Differential geometry of closed triangle meshes: normals, areas, mean curvature, and even spacing of vertices."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from extremal.estimator.camera import Array

FLATTEST = 0.02  # least sine of a triangle's angle that its cotangent is taken from


@dataclass(frozen=True, eq=False)
class ClosedMesh:
    """A closed triangle mesh.

    Attributes:
        vertices: (V, 3) [m].
        faces: (F, 3) indices, counter-clockwise seen from outside.
    """

    vertices: Array
    faces: NDArray[np.integer]

    @cached_property
    def edges(self) -> NDArray[np.integer]:
        """(E, 2), each once, the smaller index first."""
        pairs = np.sort(self.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1).astype(np.int64)
        keys = np.unique(pairs[:, 0] * len(self.vertices) + pairs[:, 1])
        return np.stack(np.divmod(keys, len(self.vertices)), axis=1)

    @cached_property
    def _crosses(self) -> Array:
        a, b, c = np.moveaxis(self.vertices[self.faces], 1, 0)
        return np.cross(b - a, c - a)

    @cached_property
    def normals(self) -> Array:
        """(V, 3) unit, outwards: means over the faces around, weighted as Max (1999, JGT 4, 1) does: exact on spheres."""
        total = np.zeros_like(self.vertices)
        for k in range(3):
            here = self.vertices[self.faces[:, k]]
            ahead = self.vertices[self.faces[:, (k + 1) % 3]] - here
            behind = self.vertices[self.faces[:, (k + 2) % 3]] - here
            weight = np.sum(ahead**2, axis=1) * np.sum(behind**2, axis=1)
            np.add.at(total, self.faces[:, k], self._crosses / np.maximum(weight, 1e-30)[:, None])
        return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-30)

    @cached_property
    def areas(self) -> Array:
        """(V,) [m^2] third parts of the faces around each vertex."""
        area = np.repeat(np.linalg.norm(self._crosses, axis=1) / 6, 3)
        return np.bincount(self.faces.ravel(), area, len(self.vertices)).astype(float)

    @cached_property
    def stiffness(self) -> sparse.csr_array:
        """(V, V), the cotangents' Laplacian of the mesh, positive semi-definite: applied to the vertices and divided by
        their areas, 2 H n (Pinkall and Polthier 1993)."""
        v, f, n = self.vertices, self.faces, len(self.vertices)
        rows: list[NDArray[np.integer]] = []
        columns: list[NDArray[np.integer]] = []
        values: list[Array] = []
        sine = np.maximum(np.linalg.norm(self._crosses, axis=1), 1e-30)
        for k in range(3):
            i, j = f[:, (k + 1) % 3], f[:, (k + 2) % 3]
            a, b = v[i] - v[f[:, k]], v[j] - v[f[:, k]]
            longest = np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1)
            half = 0.5 * np.sum(a * b, axis=1) / np.maximum(sine, FLATTEST * longest)
            half = np.maximum(half, 0.0) + 1e-3  # no negative weights: a fold would grow
            rows += [i, j]
            columns += [j, i]
            values += [-half, -half]
        entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
        off = sparse.csr_array(sparse.coo_array(entries, shape=(n, n)))
        return sparse.csr_array(off - sparse.diags_array(off.sum(axis=1)))

    @cached_property
    def neighbours(self) -> sparse.csr_array:
        """(V, V) with equal weights on a vertex's neighbours, which sum to 1."""
        e, n = self.edges, len(self.vertices)
        ones = np.ones(2 * len(e))
        ends = np.concatenate([e, e[:, ::-1]])
        links = sparse.csr_array(sparse.coo_array((ones, (ends[:, 0], ends[:, 1])), shape=(n, n)))
        return sparse.csr_array(sparse.diags_array(1 / links.sum(axis=1)) @ links)

    def moved(self, vertices: Array) -> "ClosedMesh":
        """The mesh with its vertices (V, 3) elsewhere."""
        mesh = replace(self, vertices=vertices)
        mesh.__dict__.update(edges=self.edges, neighbours=self.neighbours)  # they depend on the faces alone
        return mesh

    def spread(self, steps: int, along_normals: float = 0.0) -> "ClosedMesh":
        """Vertices moved towards the middle of their neighbours, along the surface, and by a fraction across it."""
        mesh = self
        for _ in range(steps):
            mesh = mesh._spread_once(along_normals)
        return mesh

    def _spread_once(self, along_normals: float) -> "ClosedMesh":
        step = 0.5 * (self.neighbours @ self.vertices - self.vertices)
        across = np.sum(step * self.normals, axis=1, keepdims=True) * self.normals
        return self.moved(self.vertices + step - (1 - along_normals) * across)
