"""The whole object: one closed surface that has the apparent contours that were seen from all around.

    minimise   sum r^2 / sigma^2  +  BENDING integral (2 H)^2 dA

over shifts d of the vertices along their normals. r is the distance of the surface from the tangent plane of an
outline's point (`contour_generators`), linear in d; 2 H = the mean curvature, by the cotangents' Laplacian. The visual
hull is the start; Gauss-Newton steps end at a surface whose own apparent contours are those of the images. Between
contour generators of neighbouring views it is as smooth as a thin plate. BENDING has no unit, so that it means the same for
objects of all sizes: white noise in 2 H of variance 1 / (BENDING dA). An edge of the object bends more than that; it
weighs less, as errors of Cauchy's distribution do.

The standard deviation of each vertex is that of draws from the posterior, the same equations with random right-hand sides.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import SuperLU, splu

from extremal.estimator.camera import Array, View
from extremal.estimator.closed_mesh import ClosedMesh
from extremal.estimator.contour_generators import Touches, touches
from extremal.estimator.errors import DegenerateGeometry, InvalidInput
from extremal.estimator.hull import Grid, bounds, hull_distance
from extremal.estimator.level_surface import level_surface
from extremal.estimator.silhouette import Outline, find_outline
from extremal.estimator.swept import beside, closed, inner, swept

RESOLUTION = 128  # vertices along the longest side of the object
BENDING = 3000.0
MOST_STEPS = 14
SETTLED = 3  # steps after which it stays the same what was seen
CONVERGED = 0.02  # vertex spacings, rms, of the step that is the last
GATE, CLOSER_GATE = (
    8.0,
    3.0,
)  # [px] within which mesh and outline belong together, in the first step and later
LONGEST = 1.0  # vertex spacings that a vertex moves in one step at most
SHARP = 3.0  # times the median of |2 H|, beyond which bending counts for less
DAMPING = 0.03  # of bending: steps are smooth where nothing else determines them
ROUGH, SPREAD = 10, 2  # times that vertices are spread, before and between steps
RIM = 2  # rings of vertices beside what was not seen, which may bend around an edge of the object
DRAWS = 40
FEWEST = 3


@dataclass(frozen=True, eq=False)
class WholeSurface:
    """A closed surface around an object.

    Attributes:
        mesh: vertices (V, 3) [m] and faces (F, 3).
        sigma: (V,) standard deviation [m] of each vertex along its normal; infinite where nothing was seen.
        observed: (V,) vertices over which contour generators swept; elsewhere the surface merely closes.
        outlines: of all views.
        grid: on which the visual hull was sampled; its spacing is the surface's resolution.
        residual_px: rms distance of the surface's apparent contours from the images' [px].
    """

    mesh: ClosedMesh
    sigma: Array
    observed: NDArray[np.bool_]
    outlines: tuple[Outline, ...]
    grid: Grid
    residual_px: float


def reconstruct(
    views: Sequence[View], progress: Callable[[int, int], None] | None = None, resolution: int = RESOLUTION
) -> WholeSurface:
    """The surface of an object before a plain background, from views around it in order.

    Args:
        views: at least three; only where neighbours differ by less than about 50 degrees is the surface followed.
        progress: called with (stages done, stages in all).
        resolution: vertices along the longest side.

    Raises:
        InvalidInput: too few views, or one without an object.
        DegenerateGeometry: views that do not see one object from around, or are too far apart.
    """
    if len(views) < FEWEST:
        raise InvalidInput(f"{len(views)} views; accepted: at least {FEWEST}")
    report = progress or (lambda done, total: None)
    total = len(views) + MOST_STEPS + 2
    outlines: list[Outline] = []
    for i, view in enumerate(views):
        outlines.append(find_outline(view))
        report(len(outlines), total)
        if not outlines[-1].mask.any():
            raise InvalidInput(
                f"nothing stands out from the background in view {i}; accepted: one object before a plain background"
            )
    grid = hull_grid(outlines, resolution)
    start = hull_mesh(outlines, grid)
    report(len(views) + 1, total)
    return fit_surface(start, outlines, grid, lambda k: report(len(views) + 1 + k, total))


def hull_grid(outlines: Sequence[Outline], resolution: int = RESOLUTION) -> Grid:
    """The grid around the visual hull of outlines, its spacing the longest side over `resolution`."""
    low, high = bounds([o.view for o in outlines], [o.mask for o in outlines])
    return Grid.around(low, high, float(np.max(high - low)) / resolution)


def hull_mesh(outlines: Sequence[Outline], grid: Grid) -> ClosedMesh:
    """The visual hull as a mesh."""
    distance = hull_distance([o.view for o in outlines], [o.mask for o in outlines], grid)
    vertices, faces = level_surface(distance)
    return ClosedMesh(grid.world(vertices), faces)


def fit_surface(
    start: ClosedMesh,
    outlines: Sequence[Outline],
    grid: Grid,
    report: Callable[[int], None] = lambda done: None,
) -> WholeSurface:
    """The surface near `start` that has the outlines for apparent contours; `report` hears of each step."""
    mesh = start.spread(ROUGH, 0.3)
    observed = np.ones(len(mesh.vertices), bool)
    for step in range(MOST_STEPS):
        if step < SETTLED:
            observed = swept(mesh, outlines)
            if not observed.any():
                raise DegenerateGeometry(
                    "no part of the surface is seen as a contour in views that follow each other; accepted: sharp views, in "
                    "order, less than about 50 degrees apart"
                )
        if step > 0:
            mesh = closed(mesh, observed)
        system = _System(
            mesh, touches(mesh, outlines, observed, CLOSER_GATE if step else GATE), observed, step > 0
        )
        longest = LONGEST * grid.spacing
        shift = np.clip(system.solve(-system.gradient), -longest, longest)
        mesh = mesh.moved(mesh.vertices + shift[:, None] * mesh.normals)
        report(step + 1)
        if step >= SETTLED and np.sqrt(np.mean(shift[observed] ** 2)) < CONVERGED * grid.spacing:
            break
        mesh = mesh.spread(SPREAD)
    mesh = closed(mesh, observed)
    found = touches(mesh, outlines, observed, CLOSER_GATE)
    deviation = _System(mesh, found, observed, True).deviation(np.random.default_rng(0))
    observed = inner(mesh, observed, RIM) & beside(mesh, found.points, found.view)
    sigma = np.where(observed, deviation, np.inf)
    rms = float(np.sqrt(np.mean(found.pixels**2))) if len(found.pixels) else np.inf
    report(MOST_STEPS + 1)
    return WholeSurface(mesh, sigma, observed, tuple(outlines), grid, rms)


class _System:
    """Normal equations of one Gauss-Newton step, for the vertices that are free (V,)."""

    def __init__(self, mesh: ClosedMesh, data: Touches, free: NDArray[np.bool_], robust: bool) -> None:
        self._data, self._free = data, np.flatnonzero(free)
        stiffness = mesh.stiffness.tocoo()
        turn = np.sum(mesh.normals[stiffness.row] * mesh.normals[stiffness.col], axis=1)
        entries = (stiffness.data * turn, (stiffness.row, stiffness.col))
        self._bend = sparse.csr_array(sparse.coo_array(entries, shape=stiffness.shape))
        curvature = np.sum((mesh.stiffness @ mesh.vertices) * mesh.normals, axis=1)  # 2 H times the area
        whole = inner(mesh, free, 1)
        mean = np.abs(curvature / mesh.areas)
        usual = SHARP * float(np.median(mean[whole])) if whole.any() else np.inf
        keep = 1 / (1 + (mean / max(usual, 1e-9)) ** 2) if robust else np.ones(len(mean))
        self._stiff = np.where(whole, BENDING * keep / mesh.areas, 0.0)
        self._weights = data.weights
        self.gradient = data.jacobian.T @ (self._weights * data.distance) + self._bend.T @ (
            self._stiff * curvature
        )
        self._factor = self._factorised(mesh)

    def _factorised(self, mesh: ClosedMesh) -> SuperLU:
        j, b = self._data.jacobian, self._bend
        normal = j.T @ sparse.diags_array(self._weights) @ j + b.T @ sparse.diags_array(self._stiff) @ b
        damping = DAMPING * BENDING / float(mesh.areas.mean())
        ridge = sparse.diags_array(np.full(len(mesh.vertices), 1e-3 * damping))
        matrix = sparse.csr_array(normal + damping * mesh.stiffness + ridge)[self._free][:, self._free]
        symmetric = {"SymmetricMode": True}
        return splu(matrix.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=symmetric)

    def solve(self, right: Array) -> Array:
        """Shifts (V,) [m], 0 where vertices are not free."""
        shift = np.zeros(len(right))
        shift[self._free] = self._factor.solve(right[self._free])
        return shift

    def deviation(self, rng: np.random.Generator) -> Array:
        """Standard deviation (V,) [m] of the shifts, from DRAWS draws; larger where the data fit worse than they should."""
        total = np.zeros(len(self.gradient))
        for _ in range(DRAWS):
            noise = self._data.jacobian.T @ (np.sqrt(self._weights) * rng.standard_normal(len(self._weights)))
            noise += self._bend.T @ (np.sqrt(self._stiff) * rng.standard_normal(len(self._stiff)))
            total += self.solve(noise) ** 2
        return np.sqrt(total / DRAWS) * max(1.0, self._data.misfit)
