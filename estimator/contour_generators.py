"""Contour generators of a mesh, beside the apparent contours that were seen.

Where the ray of an outline's point touches the surface, the signed distance r of the surface from the ray's tangent plane
(n, h) is stationary along the ray: as the surface moves by d along its own normals N, to first order

    r = n.(x - c),     dr = n.N d

with x a point of the mesh's contour generator and c the camera's centre. That x slides along the ray as the surface moves
does not matter to first order, so that neither contact points nor curvatures need be known.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from extremal.estimator.camera import Array
from extremal.estimator.closed_mesh import ClosedMesh
from extremal.estimator.silhouette import STEP, Outline

ALIKE = 0.8  # least agreement of the mesh's normal with that of the outline
ASIDE = 1.5  # [px] along the outline to the nearest of its points
POOL = 16.0  # [px] of an outline whose points share their errors: the knots of its spline are that far apart
HOLD = 3.0  # standard deviations, of those that are usual, beyond which a distance loses weight


@dataclass(frozen=True, eq=False)
class Touches:
    """Points of the contour generators of a mesh of V vertices that have a counterpart on an outline.

    Attributes:
        distance: (n,) [m] of the mesh's point outside the outline's tangent plane.
        jacobian: (n, V) derivatives of `distance` by shifts of the vertices along their normals.
        sigma: (n,) [m] of the outline there.
        information: (n,) 1/sigma^2, each point's share of it.
        pixels: (n,) [px] `distance` in the image.
        points: (n, 3) [m] of the mesh; view: (n,) index of the outline.
    """

    distance: Array
    jacobian: sparse.csr_array
    sigma: Array
    information: Array
    pixels: Array
    points: Array
    view: NDArray[np.integer]

    @property
    def misfit(self) -> float:
        """Standard deviation of `distance` in units of sigma, by the median."""
        return float(1.4826 * np.median(np.abs(self.distance) / self.sigma)) if len(self.sigma) else 0.0

    @property
    def weights(self) -> Array:
        """(n,) the information, less where a distance is far out of line (Huber)."""
        out = np.abs(self.distance) / (self.sigma * HOLD * max(self.misfit, 1.0))
        return self.information / np.maximum(out, 1.0)


def touches(mesh: ClosedMesh, outlines: Sequence[Outline], free: NDArray[np.bool_], gate: float) -> Touches:
    """Contour generators of a mesh matched with outlines, where vertices are `free` (V,), within `gate` pixels."""
    parts = [_touches(mesh, outline, free, gate) for outline in outlines]
    ends, shares, distance, sigma, information, pixels, points = (
        np.concatenate(p) for p in zip(*parts, strict=True)
    )
    rows = np.repeat(np.arange(len(distance)), 2)
    entries = (shares.ravel(), (rows, ends.ravel()))
    jacobian = sparse.csr_array(sparse.coo_array(entries, shape=(len(distance), len(mesh.vertices))))
    view = np.repeat(np.arange(len(parts)), [len(part[0]) for part in parts])
    return Touches(distance, jacobian, sigma, information, pixels, points, view)


def contour_generator(mesh: ClosedMesh, centre: Array) -> tuple[NDArray[np.integer], Array, Array, Array]:
    """Where the surface turns away from `centre` (3,): edges (n, 2) that the curve crosses, the fractions (n,) of them at
    which it does, points (n, 3) and unit normals (n, 3).

    The points lie on the arcs that the normals at the edges' ends ask for, not on the edges.
    """
    facing = np.sum(mesh.normals * (mesh.vertices - centre), axis=1)
    edges = mesh.edges[(facing[mesh.edges[:, 0]] < 0) != (facing[mesh.edges[:, 1]] < 0)]
    a, b = facing[edges].T
    t = a / (a - b)
    first, last = np.moveaxis(mesh.vertices[edges], 1, 0)
    n0, n1 = np.moveaxis(mesh.normals[edges], 1, 0)
    normals = (1 - t)[:, None] * n0 + t[:, None] * n1
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    sag = 0.5 * t * (1 - t) * np.sum((n1 - n0) * (last - first), axis=1)
    return edges, t, first + t[:, None] * (last - first) + sag[:, None] * normals, normals


def _touches(
    mesh: ClosedMesh, outline: Outline, free: NDArray[np.bool_], gate: float
) -> tuple[np.ndarray, ...]:
    """Ends (n, 2), derivatives (n, 2) by their shifts, distance, sigma, information and pixels (n,) and points (n, 3) of one view."""
    centre = outline.view.centre
    if len(outline.pixels) == 0:
        return np.zeros((0, 2), int), np.zeros((0, 2)), *(np.zeros(0),) * 4, np.zeros((0, 3))
    edges, t, points, normals = contour_generator(mesh, centre)
    image = outline.view.project(points)
    image = np.where(np.isfinite(image), image, -1e6)
    apart, j = outline.tree.query(image)
    plane, across = outline.planes[j], outline.normals[j]
    offset = image - outline.pixels[j]
    along = np.abs(offset[:, 1] * across[:, 0] - offset[:, 0] * across[:, 1])
    keep = (apart < gate) & (along < ASIDE) & (np.sum(normals * plane, axis=1) > ALIKE)
    keep &= free[edges].all(axis=1)
    edges, t, points, plane, j = edges[keep], t[keep], points[keep], plane[keep], j[keep]
    share = np.stack([1 - t, t], axis=1) * np.einsum("nk,nek->ne", plane, mesh.normals[edges])
    ray = points - centre
    sigma = outline.sigma[j] * np.linalg.norm(ray, axis=1)
    information = min(1.0, STEP * len(outline.pixels) / (POOL * max(len(j), 1))) / sigma**2
    pixels = np.sum(offset[keep] * across[keep], axis=1)
    return edges, share, np.sum(plane * ray, axis=1), sigma, information, pixels, points
