"""The visual hull: all points of space that project into every silhouette (Laurentini 1994, IEEE PAMI 16, 150).

Space is sampled on a cubic grid. `carve` says which grid points belong to the hull; `hull_distance` how far they are from
its boundary, whose zero is known to a fraction of the grid's spacing.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import interp1d
from scipy.ndimage import map_coordinates

from extremal.estimator.camera import Array, View
from extremal.estimator.errors import DegenerateGeometry
from extremal.estimator.silhouette import signed_field

COARSE = 24  # grid points along the longest side of the box in which the hull is looked for
SKIP = 4  # grid points from one to the next that are looked at everywhere
BAND = 1.5  # of those steps from the hull's boundary within which all are looked at
MARGIN = 3  # grid points around the hull
SEARCHES = 12


@dataclass(frozen=True)
class Grid:
    """Points origin + spacing (i, j, k) of the world [m], 0 <= (i, j, k) < shape."""

    origin: tuple[float, float, float]
    spacing: float
    shape: tuple[int, int, int]

    @staticmethod
    def around(low: Array, high: Array, spacing: float, margin: int = MARGIN) -> "Grid":
        """The grid that holds a box (low (3,), high (3,) [m]) and `margin` points around it."""
        count = np.ceil((high - low) / spacing).astype(int) + 1 + 2 * margin
        origin = 0.5 * (low + high) - 0.5 * (count - 1) * spacing
        return Grid(_triple(origin), spacing, tuple(int(c) for c in count))  # pyright: ignore[reportArgumentType]

    def layer(self, i: int) -> Array:
        """Points (J, K, 3) of one layer."""
        y, z = (self.origin[a] + self.spacing * np.arange(self.shape[a]) for a in (1, 2))
        points = np.empty((len(y), len(z), 3))
        points[..., 0] = self.origin[0] + self.spacing * i
        points[..., 1], points[..., 2] = y[:, None], z
        return points

    def world(self, index: np.ndarray) -> Array:
        """Points (..., 3) [m] at fractional indices (..., 3)."""
        return np.asarray(self.origin) + self.spacing * index


def carve(views: Sequence[View], masks: Sequence[NDArray[np.bool_]], grid: Grid) -> NDArray[np.bool_]:
    """Whether each grid point (I, J, K) projects onto pixels of every mask (height, width)."""
    inside = np.ones(grid.shape, bool)
    for i in range(grid.shape[0]):
        points = grid.layer(i).reshape(-1, 3)
        left = np.arange(len(points))
        for view, mask in zip(views, masks, strict=True):
            pixels = np.rint(view.project(points[left]))
            column, row = np.where(np.isfinite(pixels), pixels, -1).astype(int).T
            seen = (column >= 0) & (column < mask.shape[1]) & (row >= 0) & (row < mask.shape[0])
            left, column, row = left[seen], column[seen], row[seen]
            left = left[mask[row, column]]
        layer = np.zeros(len(points), bool)
        layer[left] = True
        inside[i] = layer.reshape(grid.shape[1:])
    return inside


def hull_distance(
    views: Sequence[View], masks: Sequence[NDArray[np.bool_]], grid: Grid
) -> NDArray[np.float32]:
    """About the signed distance (I, J, K) [m] of grid points from the visual hull, negative inside.

    In each view the distance from the silhouette's border in the image, brought to the point's depth; of all views the
    largest. Beyond a few grid spacings from the hull's boundary it is interpolated between every fourth point.
    """
    fields = [signed_field(mask) for mask in masks]
    steps = [np.minimum(np.arange(-(-n // SKIP) + 1) * SKIP, n - 1) for n in grid.shape]
    steps = [np.unique(s) for s in steps]
    coarse = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1)
    distance = _largest(views, fields, grid.world(coarse.reshape(-1, 3))).reshape(coarse.shape[:-1])
    for axis in range(3):
        fine = np.arange(grid.shape[axis])
        distance = interp1d(steps[axis], distance, axis=axis, assume_sorted=True)(fine)
    near = np.argwhere(np.abs(distance) < BAND * SKIP * grid.spacing)
    distance[tuple(near.T)] = _largest(views, fields, grid.world(near))
    return distance.astype(np.float32)


def _largest(views: Sequence[View], fields: Sequence[NDArray[np.float32]], points: Array) -> Array:
    """The largest distance (n,) [m] of points (n, 3) from the silhouettes, positive outside."""
    largest = np.full(len(points), -np.inf, np.float32)
    for view, field in zip(views, fields, strict=True):
        np.maximum(largest, _at(view, field, points), out=largest)
    return largest


def bounds(views: Sequence[View], masks: Sequence[NDArray[np.bool_]]) -> tuple[Array, Array]:
    """Lowest and highest corner (3,) [m] of a box that holds the visual hull, to about a hundredth of its size.

    Raises:
        DegenerateGeometry: the silhouettes have no common part, or do not bound one.
    """
    fields = [signed_field(mask) for mask in masks]
    centre, reach = _looked_at(views)
    low, high = centre - reach, centre + reach
    for _ in range(SEARCHES):
        spacing = float(np.max(high - low)) / COARSE
        grid = Grid.around(low, high, spacing, 0)
        index = np.stack(np.meshgrid(*(np.arange(n) for n in grid.shape), indexing="ij"), axis=-1).reshape(
            -1, 3
        )
        found = index[_largest(views, fields, grid.world(index)) < spacing]
        if len(found) == 0:
            raise DegenerateGeometry(
                "the silhouettes of the views have no common part; accepted: views of one object with correct poses"
            )
        new_low = np.maximum(grid.world(found.min(axis=0) - 0.5), low)
        new_high = np.minimum(grid.world(found.max(axis=0) + 0.5), high)
        shrunk = np.prod(new_high - new_low) / np.prod(high - low)
        low, high = new_low, new_high
        if shrunk > 0.7:
            break
    return low, high


def _looked_at(views: Sequence[View]) -> tuple[Array, float]:
    """The point (3,) that is nearest to all optical axes, and the distance [m] of the farthest camera from it."""
    centres = np.array([view.centre for view in views])
    axes = np.array([view.T_world_camera.rotation.as_matrix()[:, 2] for view in views])
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    total = across.sum(axis=0)
    if np.linalg.cond(total) > 1e6:
        raise DegenerateGeometry("all views look the same way; accepted: views from around the object")
    point = np.linalg.solve(total, np.einsum("vij,vj->i", across, centres))
    return point, float(np.linalg.norm(centres - point, axis=1).max())


def _at(view: View, field: NDArray[np.float32], points: Array) -> NDArray[np.float32]:
    """Distance (n,) [m] of points (n, 3) from a silhouette, by its field (height, width) [px]; large where not seen."""
    rotation = view.T_world_camera.rotation.as_matrix()
    local = (points - view.centre) @ rotation
    pixels = view.camera.project(local)
    unseen = np.isnan(pixels[:, 0])
    x, y = np.where(unseen[:, None], 0.0, pixels).astype(np.float32).T
    values = map_coordinates(field, [y, x], order=1, mode="nearest")
    height, width = field.shape
    beyond = np.maximum(
        np.abs(x - 0.5 * (width - 1)) - 0.5 * width, np.abs(y - 0.5 * (height - 1)) - 0.5 * height
    )
    values = np.where(beyond > 0, np.maximum(values, beyond), values)
    return np.where(unseen, np.inf, values * local[:, 2] / view.camera.fx).astype(np.float32)


def _triple(values: Array) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in values)
    return x, y, z
