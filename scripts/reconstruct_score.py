"""How near surfaces come to the exact truth, where contours swept over the object."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import cKDTree  # pyright: ignore[reportAttributeAccessIssue]

from extremal.estimator.camera import Array
from extremal.estimator.closed_mesh import ClosedMesh
from extremal.estimator.whole import WholeSurface
from extremal.scenes import Scene
from extremal.scripts.report_mesh import object_meshes

SAMPLES = 2000  # points of a surface whose distance to the truth is measured
DENSE = 100_000  # points of a surface that the truth's points look for
TRUE_SAMPLES = 20_000
NEAR = 1e-3  # [m] to a surface within which a point of the truth counts as recovered


@dataclass(frozen=True, eq=False)
class Distances:
    """Of one method: points (n, 3) [m] where the object was seen, their distances (n,) [m] outside the truth, and the
    share of the object's whole surface within `NEAR` of them."""

    points: Array
    error: Array
    completeness: float

    def summary(self) -> dict[str, Any]:
        """As in result.json; null where there are no points."""
        some = len(self.error) > 0
        return {
            "rms_m": float(np.sqrt(np.mean(self.error**2))) if some else None,
            "p95_m": float(np.percentile(np.abs(self.error), 95)) if some else None,
            "completeness": self.completeness,
        }


class Judge:
    """Scores surfaces of the one object in a scene; `surface` says where the object was seen, for all methods alike."""

    def __init__(self, scene: Scene, surface: WholeSurface, rng: np.random.Generator) -> None:
        self._object, self._rng = scene.objects[0], rng
        self._tree, self._observed = cKDTree(surface.mesh.vertices), surface.observed
        (_, drawn), *_ = object_meshes(scene)
        self._truth = _sample(drawn.vertices, drawn.faces, TRUE_SAMPLES, rng)

    def of_mesh(self, mesh: ClosedMesh) -> Distances:
        """Scores a mesh by points spread evenly over it."""
        return self.of_points(_sample(mesh.vertices, mesh.faces, DENSE, self._rng))

    def of_points(self, points: Array) -> Distances:
        """Scores points (n, 3) [m], of which those count that lie beside surface that was seen."""
        if len(points):
            points = points[self._observed[self._tree.query(points)[1]]]
        if len(points) == 0:
            return Distances(np.zeros((0, 3)), np.zeros(0), 0.0)
        apart, _ = cKDTree(points).query(self._truth)
        chosen = self._rng.choice(len(points), min(SAMPLES, len(points)), replace=False)
        error = self._object.signed_distance(points[chosen])
        return Distances(points[chosen], error, float(np.mean(apart < NEAR)))


def _sample(vertices: Array, faces: NDArray[np.integer], count: int, rng: np.random.Generator) -> Array:
    """Points (count, 3) spread evenly over triangles."""
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    return np.asarray(trimesh.sample.sample_surface(mesh, count, seed=int(rng.integers(2**31)))[0], float)
