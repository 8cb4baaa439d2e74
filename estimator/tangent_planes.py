"""The edgels of all views that belong to the surroundings of a contour point: those with tangent planes near its own."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from extremal.estimator.camera import Array
from extremal.estimator.errors import InvalidInput

SAG = 0.15  # [m] radius of curvature along the ray up to which a surface's neighbours are found
SLACK = 2e-3  # [m] by which a tangent plane may miss, for the error of the rough depth


@dataclass(frozen=True, eq=False)
class TangentPlanes:
    """Edgels of all views as tangent planes of objects, in the world.

    Attributes:
        centres: (E, 3) camera centres [m].
        rays: (E, 3) unit rays.
        normals: (E, 3) unit normals of the planes through ray and contour; their sign does not matter.
        sigma: (E,) standard deviation [rad] of the ray across the contour.
    """

    centres: Array
    rays: Array
    normals: Array
    sigma: Array

    def __post_init__(self) -> None:
        count = len(self.sigma)
        for name in ("centres", "rays", "normals"):
            if getattr(self, name).shape != (count, 3):
                raise InvalidInput(
                    f"{name} is {getattr(self, name).shape}; accepted: ({count}, 3), as sigma has"
                )


def surroundings(
    planes: TangentPlanes, seeds: ArrayLike, depth: ArrayLike, reach: float = 0.6, window: float = 0.03
) -> tuple[np.ndarray, Array]:
    """Edgels around seeds, the seed itself first: what `second_order_shape` takes.

    An edgel belongs to a seed if its normal is within `reach` of the seed's, if it lies within `window` of the seed's
    section (the plane of its ray and normal), and if its plane passes as near to the seed as a surface allows whose
    normal turns that far.

    Args:
        planes: edgels of all views.
        seeds: (S,) indices of the edgels that are to be estimated.
        depth: (S,) rough distances [m] of their contact points from the camera centres.
        reach: largest angle [rad] between normals.
        window: largest distance [m] along the contour.

    Returns:
        Indices (S, M) of edgels, M the largest number that a seed has, and their sigma (S, M) [rad]: infinite where
        a seed has fewer.

    Raises:
        InvalidInput: depth, reach or window that is not positive, or shapes that do not fit.
    """
    index, distance = np.asarray(seeds, int), np.asarray(depth, float)
    if index.ndim != 1 or distance.shape != index.shape:
        raise InvalidInput(f"seeds {index.shape} and depth {distance.shape}; accepted: (S,) both")
    for name, value in (("depth", distance), ("reach", reach), ("window", window)):
        if not np.all(np.asarray(value) > 0):
            raise InvalidInput(f"{name} is {value}; accepted: positive numbers")
    found = [_around(planes, s, d, reach, window) for s, d in zip(index, distance, strict=True)]
    most = max((len(f) for f in found), default=0)
    chosen = np.stack([np.pad(f, (0, most - len(f)), constant_values=f[0]) for f in found])
    padding = np.arange(most) >= np.array([len(f) for f in found])[:, None]
    return chosen, np.where(padding, np.inf, planes.sigma[chosen])


def _around(planes: TangentPlanes, seed: int, depth: float, reach: float, window: float) -> np.ndarray:
    """Indices of the edgels around one seed, itself first."""
    e1 = planes.rays[seed]
    n0 = planes.normals[seed] - (planes.normals[seed] @ e1) * e1
    n0 = n0 / np.linalg.norm(n0)
    e2 = np.cross(n0, e1)
    near = np.flatnonzero(np.abs(planes.normals @ n0) > np.cos(reach))
    n, p = planes.normals[near], planes.rays[near]
    n = n * np.sign(n @ n0)[:, None]
    section = np.stack([n @ n0, n @ e1], axis=1)
    section /= np.linalg.norm(section, axis=1, keepdims=True)
    across = section[:, :1] * n0 + section[:, 1:] * e1
    along = section[:, :1] * e1 - section[:, 1:] * n0
    offset = planes.centres[near] - (planes.centres[seed] + depth * e1)
    with np.errstate(divide="ignore"):
        y = offset - (np.sum(offset * along, axis=1) / np.sum(p * along, axis=1))[:, None] * p
    x = y @ e2
    # half of what the contour bends away is known from the edgel's own slope; the rest is the section's sag
    miss = np.abs(np.sum(y * across, axis=1) + 0.5 * x * (n @ e2) / np.sum(n * across, axis=1))
    sag = SAG * (1 - section[:, 0]) + 0.5 * np.abs(x * section[:, 1])
    belongs = (np.abs(x) < window) & (miss < SLACK + sag) & (near != seed)
    return np.concatenate([[seed], near[belongs]])
