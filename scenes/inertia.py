"""Mass, centre of mass and moments of inertia of objects, as thin closed shells."""

from dataclasses import dataclass

import numpy as np

from extremal.estimator.errors import InvalidInput
from extremal.scenes.convex import barr_grid
from extremal.scenes.curves import Array
from extremal.scenes.grids import grid_triangles
from extremal.scenes.lathe import Lathe
from extremal.scenes.profile import Profile
from extremal.scenes.quadrics import Ellipsoid, Sphere
from extremal.scenes.superquadric import Superquadric
from extremal.scenes.surface import Surface

ROWS, COLUMNS = 256, 512  # of triangles on rounded objects
NODES = 8  # of Gauss's rule between two points of a profile


@dataclass(frozen=True, eq=False)
class Inertia:
    """How a body resists acceleration, in its object frame.

    Attributes:
        mass: [kg].
        centre: (3,) centre of mass [m].
        moments: (3, 3) inertia matrix about the centre of mass [kg m^2].
    """

    mass: float
    centre: Array
    moments: Array


def shell_inertia(surface: Surface, area_density: float) -> Inertia:
    """The inertia of a thin wall on the whole surface, caps of a lathe included: a hollow object.

    Args:
        area_density: of the wall [kg/m^2]: its density times its thickness.

    Raises:
        InvalidInput: the density is not a positive number.
    """
    if not (np.isfinite(area_density) and area_density > 0):
        raise InvalidInput(f"area density is {area_density!r}; accepted: a positive number [kg/m^2]")
    points, areas = wall_points(surface)
    weights = area_density * areas
    mass = float(weights.sum())
    centre = weights @ points / mass
    offset = points - centre
    second = (weights[:, None] * offset).T @ offset
    return Inertia(mass, centre, np.trace(second) * np.eye(3) - second)


def wall_points(surface: Surface) -> tuple[Array, Array]:
    """Points (K, 3) of the surface, object frame, and areas (K,) [m^2] that stand for it in integrals of quadratic polynomials.

    To rounding on lathes, boxes and meshes, to 1e-4 on rounded objects.
    """
    if isinstance(surface, Lathe):
        return _revolved(surface.profile)
    if isinstance(surface, Sphere | Ellipsoid | Superquadric):
        grid = barr_grid(surface, ROWS, COLUMNS)
        faces = grid_triangles(np.ones((len(grid) - 1, COLUMNS), bool), wrap=True)
        return _on_triangles(grid.reshape(-1, 3)[faces])
    return _on_triangles(np.concatenate([piece.vertices[piece.faces] for piece in surface._pieces()]))


def _on_triangles(corners: Array) -> tuple[Array, Array]:
    """The middles of the sides of triangles (F, 3, 3) integrate quadratic polynomials exactly."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    middles = (corners + np.roll(corners, 1, axis=1)) / 2
    return middles.reshape(-1, 3), np.repeat(np.linalg.norm(normals, axis=1) / 6, 3)


def _revolved(profile: Profile) -> tuple[Array, Array]:
    """Four points on each ring at Gauss's heights, and on the ring of either cap that has the disc's second moments."""
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    half = np.diff(profile.z)[:, None] / 2
    z = (profile.z[:-1, None] + half * (1 + nodes)).ravel()
    r, r1, _ = profile.derivatives(z)
    side = 2 * np.pi * r * np.sqrt(1 + r1 * r1) * (half * weights).ravel()
    ends = np.array([0.0, profile.height])
    rim = profile.spline(ends)
    z, areas = np.append(z, ends), np.append(side, np.pi * rim**2)
    r = np.append(r, rim / np.sqrt(2))
    cross = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])
    around = r[:, None, None] * cross
    points = np.concatenate([around, np.broadcast_to(z[:, None, None], (len(z), 4, 1))], axis=2)
    return points.reshape(-1, 3), np.repeat(areas / 4, 4)
