"""Meshes for display: coarse enough to be mailed. Never measure on them."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from extremal.estimator import InvalidInput
from extremal.estimator.camera import Array
from extremal.scenes import Scene

CELLS = 56  # along the longest side of a mesh that is made coarse
MOST_FACES = 12_000  # of a mesh that is shown as it is


@dataclass(frozen=True, eq=False)
class DisplayMesh:
    """A triangle mesh: vertices (V, 3) [m], faces (F, 3), colours (V, 3) in 0-255."""

    vertices: Array
    faces: NDArray[np.integer]
    colours: NDArray[np.uint8]

    def __post_init__(self) -> None:
        n = len(self.vertices)
        if self.vertices.shape != (n, 3) or self.faces.ndim != 2 or self.faces.shape[1] != 3:
            raise InvalidInput(
                f"vertices are {self.vertices.shape}, faces {self.faces.shape}; accepted: (V, 3), (F, 3)"
            )
        if not np.isfinite(self.vertices).all():
            raise InvalidInput("a vertex is not finite; accepted: finite positions [m]")
        if self.colours.shape != (n, 3) or self.colours.dtype != np.uint8:
            raise InvalidInput(
                f"colours are {self.colours.shape} of {self.colours.dtype}; accepted: ({n}, 3) of uint8"
            )
        if self.faces.size and not (self.faces.min() >= 0 and self.faces.max() < n):
            raise InvalidInput(f"faces name vertices that are not there; accepted: 0 to {n - 1}")

    @staticmethod
    def of(mesh: trimesh.Trimesh, colours: NDArray[np.uint8]) -> "DisplayMesh":
        """A mesh with colours (V, 3) of its vertices."""
        return DisplayMesh(np.array(mesh.vertices), np.array(mesh.faces), colours)


def coarse(mesh: DisplayMesh, cells: int = CELLS, most: int = MOST_FACES) -> DisplayMesh:
    """The mesh with the vertices of each cell of a grid made one, their mean, where it has too many faces.

    Vertex clustering (Rossignac and Borrel 1993): a surface moves by less than a cell, a `cells`th of the longest side.
    """
    if len(mesh.faces) <= most:
        return mesh
    low = mesh.vertices.min(axis=0)
    cell = max(float(np.ptp(mesh.vertices, axis=0).max()) / cells, 1e-9)
    index = ((mesh.vertices - low) / cell).astype(np.int64)
    _, label = np.unique(index, axis=0, return_inverse=True)
    label = label.ravel()
    counts = np.bincount(label)[:, None]
    vertices, colours = (
        np.stack([np.bincount(label, v) for v in values.astype(float).T], axis=1) / counts
        for values in (mesh.vertices, mesh.colours)
    )
    faces = label[mesh.faces]
    faces = faces[(np.diff(np.sort(faces, axis=1), axis=1) > 0).all(axis=1)]  # those that did not collapse
    turned = np.take_along_axis(
        faces, (np.argmin(faces, axis=1)[:, None] + np.arange(3)) % 3, axis=1
    )  # the smallest first
    return DisplayMesh(vertices, np.unique(turned, axis=0), np.rint(colours).astype(np.uint8))


def object_meshes(scene: Scene) -> Iterator[tuple[str, DisplayMesh]]:
    """Name and mesh of every object of a scene, in the world, in its own colours."""
    spec = scene.to_spec()
    for body in spec.bodies:
        parts = []
        for geom in body.geoms:
            part, rgba = spec.mesh(geom.meshname), np.array(spec.material(geom.material).rgba)
            vertices, faces = np.reshape(part.uservert, (-1, 3)), np.reshape(part.userface, (-1, 3))
            parts.append((np.asarray(vertices, float), faces, rgba[:3]))
        if parts:
            turn = Rotation.from_quat(np.array(body.quat), scalar_first=True)
            yield body.name, _joined(parts, RigidTransform.from_components(np.array(body.pos), turn))


def _joined(
    parts: list[tuple[Array, NDArray[np.integer], Array]], T_world_object: RigidTransform
) -> DisplayMesh:
    """Pieces of one colour each as one mesh."""
    first = np.cumsum([0] + [len(vertices) for vertices, _, _ in parts[:-1]])
    return DisplayMesh(
        T_world_object.apply(np.concatenate([vertices for vertices, _, _ in parts])),
        np.concatenate([faces + start for (_, faces, _), start in zip(parts, first, strict=True)]),
        np.concatenate(
            [np.tile(np.rint(255 * colour).astype(np.uint8), (len(v), 1)) for v, _, colour in parts]
        ),
    )
