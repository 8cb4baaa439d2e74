"""How good is second-order shape from general motion? Exact contours of random objects, with noise, against the truth."""

from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import RigidTransform, Rotation

from extremal.estimator import Camera
from extremal.estimator.parallel_sections import columns
from extremal.estimator.second_order import SecondOrderShape, second_order_shape
from extremal.estimator.tangent_planes import TangentPlanes, surroundings
from extremal.scenes import Ellipsoid, Lathe, Surface, SurfaceCurve
from extremal.sim import fixating

Maker = Callable[[np.random.Generator], Surface]

VIEWS, HALF_ARC = 25, 0.35  # [rad] of azimuth to either side
NOISE, SPACING = 0.05, 5.0  # [px] across the contour, independent for edgels that far apart
DEPTH_ERROR = 0.003  # [m] of the rough depths
SHORTEST = 40.0  # [px] of visible contour
RADIUS = 0.3  # [m] largest principal radius whose relative error is counted
SADDLE = 20.0  # [1/m^2] |K| above which its sign is counted
FAR = 1e3  # [m] at which a centre sees the contour generator of parallel rays


@dataclass(frozen=True)
class GeneralRow:
    """Accuracy over the points of one kind of object; shares from 0 to 1.

    Attributes:
        objects: what was looked at.
        points, invalid: all of them, and those that the estimator declared invalid.
        counted: share of valid points whose principal radii are both below RADIUS, over which errors are relative.
        smaller_error, larger_error: median relative error of the smaller and the larger principal radius.
        smaller_coverage, larger_coverage: share of principal curvatures of all valid points within 1.96 sigma.
        radii_coverage: the same of both principal radii, where counted.
        sign_right, clear: share of points with the right sign of K where |K| > SADDLE; and where |K| > 3 sigma.
        nees, nees_99: mean and 99th percentile of the normalised estimation error squared of the six parameters, per
            parameter.
        ray_cost, contour_cost: median of sigma over the Cramer-Rao bound of beta and alpha for a surface whose higher
            terms are known.
    """

    objects: str
    points: int
    invalid: int
    counted: float
    smaller_error: float
    larger_error: float
    smaller_coverage: float
    larger_coverage: float
    radii_coverage: float
    sign_right: float
    clear: float
    nees: float
    nees_99: float
    ray_cost: float
    contour_cost: float


def general_study(objects: int = 100, points: int = 10) -> list[GeneralRow]:
    """Rows for ellipsoids, waisted vases, and vases whose profile is a cubic spline of few pieces."""
    kinds: dict[str, Maker] = {
        "ellipsoids": random_ellipsoid,
        "waisted vases": lambda rng: random_vase(rng, 81),
        "waisted vases of 8 cubic pieces": lambda rng: random_vase(rng, 9),
    }
    return [study_of(name, make, objects, points) for name, make in kinds.items()]


def study_of(name: str, make: Maker, objects: int, points: int) -> GeneralRow:
    """The row of `points` random points on each of `objects` random objects."""
    return _row(name, [trial(make, points, np.random.default_rng([11, i])) for i in range(objects)])


def general_table(rows: list[GeneralRow]) -> str:
    """The rows as a table in GitHub's Markdown, an object a column."""
    lines = ["| " + " | ".join(["", *(row.objects for row in rows)]) + " |", "|---" * (len(rows) + 1) + "|"]
    for name in [field.name for field in fields(GeneralRow)][1:]:
        lines.append("| " + " | ".join([name, *(_cell(name, getattr(row, name)) for row in rows)]) + " |")
    return "\n".join(lines)


def _cell(name: str, value: float) -> str:
    if name in ("points", "invalid"):
        return str(value)
    return f"{value:.2f}" if name.startswith("nees") or name.endswith("cost") else f"{100 * value:.2f} %"


# Objects and views.


def random_ellipsoid(rng: np.random.Generator) -> Ellipsoid:
    """Semi-axes of 25 to 80 mm, any orientation."""
    a, b, c = rng.uniform(0.025, 0.08, 3).tolist()
    return Ellipsoid(a=a, b=b, c=c, T_world_object=RigidTransform.from_rotation(Rotation.random(rng=rng)))


def random_vase(rng: np.random.Generator, knots: int) -> Lathe:
    """A waist between two bellies, tilted by up to half a radian; its profile passes through `knots` points."""
    height = 0.2 * rng.uniform(0.92, 1.08)
    u = np.linspace(0, 1, knots)
    r = rng.uniform(0.036, 0.042) + rng.uniform(0.006, 0.009) * np.cos(
        2 * np.pi * (u - rng.uniform(-0.08, 0.08))
    )
    for frequency, largest in ((0.5, 0.003), (1.5, 0.002)):
        r = r + rng.uniform(0, largest) * np.sin(2 * np.pi * (frequency * u + rng.uniform()))
    tilt = Rotation.from_rotvec(rng.uniform(-0.5, 0.5, 3))
    pose = RigidTransform.from_components(-tilt.apply([0, 0, height / 2]), tilt)
    return Lathe(profile_z=u * height, profile_r=r, T_world_object=pose)


def curved_path(rng: np.random.Generator) -> np.ndarray:
    """Camera centres (VIEWS, 3) about the origin: irregular steps along an arc that weaves and changes its distance."""
    u = np.sort(rng.uniform(-1, 1, VIEWS))
    u[[0, -1]] = -1, 1
    elevation = 0.2 + 0.12 * np.sin(3 * rng.uniform(0.7, 1.3) * u + rng.uniform(0, 2 * np.pi))
    distance = rng.uniform(0.5, 0.6) + 0.03 * np.sin(2 * u + rng.uniform(0, 2 * np.pi))
    azimuth = HALF_ARC * u
    along = np.cos(elevation)
    return distance[:, None] * np.stack(
        [-along * np.cos(azimuth), along * np.sin(azimuth), np.sin(elevation)], axis=1
    )


@dataclass(frozen=True, eq=False)
class Edgels:
    """Noisy edgels (E,) of all views, the exact contour points (E, 3) under them, and the views (E,) they are of."""

    planes: TangentPlanes
    points: np.ndarray
    view: np.ndarray


def noisy_edgels(surface: Surface, centres: np.ndarray, rng: np.random.Generator) -> Edgels:
    """Visible apparent contours seen from `centres` (V, 3), sampled every SPACING pixels."""
    found = []
    for i, (centre, pose) in enumerate(zip(centres, fixating(centres, np.zeros(3)), strict=True)):
        for curve in surface.contour_generator(centre):
            for points in _visible_runs(curve):
                found += _sampled(points, centre, pose.rotation.as_matrix(), i, rng)
    *planes, points, view = (np.concatenate(column) for column in zip(*found, strict=True))
    return Edgels(TangentPlanes(*planes), points, view)


def _visible_runs(curve: SurfaceCurve) -> list[np.ndarray]:
    index = np.flatnonzero(curve.visible)
    runs = np.split(index, np.flatnonzero(np.diff(index) > 1) + 1)
    return [curve.points[run] for run in runs if len(run) > 10]


def _sampled(
    points: np.ndarray, centre: np.ndarray, rotation: np.ndarray, view: int, rng: np.random.Generator
) -> list[tuple[np.ndarray, ...]]:
    """Edgels of one run: positions with noise across the contour, tangents from both neighbours."""
    camera = Camera()
    points = points[np.concatenate([[True], np.linalg.norm(np.diff(points, axis=0), axis=1) > 1e-7])]
    pixels = camera.project((points - centre) @ rotation)
    u = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(pixels, axis=0), axis=1))])
    if u[-1] < SHORTEST:
        return []
    at = np.arange(rng.uniform(0, SPACING), u[-1], SPACING)
    curve = CubicSpline(u, pixels)
    position = curve(at) + NOISE * rng.normal(size=(len(at), 1)) * _across(curve(at, 1))
    chord, position, at = position[2:] - position[:-2], position[1:-1], at[1:-1]
    ray = camera.rays(position)
    normal = np.cross(ray, np.concatenate([chord, np.zeros((len(chord), 1))], axis=1))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    per_pixel = (camera.rays(position + 1e-3 * _across(chord)) - ray) / 1e-3
    sigma = NOISE * np.abs(np.sum(per_pixel * normal, axis=1))
    centres, views = np.tile(centre, (len(at), 1)), np.full(len(at), view)
    return [(centres, ray @ rotation.T, normal @ rotation.T, sigma, CubicSpline(u, points)(at), views)]


def _across(tangent: np.ndarray) -> np.ndarray:
    return np.stack([-tangent[:, 1], tangent[:, 0]], axis=1) / np.linalg.norm(tangent, axis=1, keepdims=True)


# Trials.


@dataclass(frozen=True, eq=False)
class Trial:
    """Points (n,) of one object: estimates, true principal curvatures (n, 2), errors (n, 6) of the parameters and their
    bound (n, 6)."""

    shape: SecondOrderShape
    curvatures: np.ndarray
    error: np.ndarray
    bound: np.ndarray


def trial(make: Maker, points: int, rng: np.random.Generator) -> Trial:
    """Estimates at random points of the middle view's contours of a random object."""
    surface = make(rng)
    edgels = noisy_edgels(surface, curved_path(rng), rng)
    middle = np.flatnonzero(edgels.view == VIEWS // 2)
    seeds = rng.choice(middle, min(points, len(middle)), replace=False)
    planes = edgels.planes
    depth = np.linalg.norm(edgels.points[seeds] - planes.centres[seeds], axis=1)
    depth += DEPTH_ERROR * rng.normal(size=len(seeds))
    return scored(surface, edgels, seeds, *surroundings(planes, seeds, depth))


def scored(
    surface: Surface, edgels: Edgels, seeds: np.ndarray, index: np.ndarray, sigma: np.ndarray
) -> Trial:
    """Second-order shapes from the edgels at `index` (n, M), against the surface."""
    planes = edgels.planes
    rays, normals = planes.rays[index], planes.normals[index]
    shape = second_order_shape(planes.centres[index], rays, normals, sigma)
    section = np.cross(normals[:, 0], rays[:, 0])
    start, far = edgels.points[seeds], shape.position - FAR * rays[:, 0]
    truth = np.concatenate(
        [
            surface.contour_points_in_planes(start[i, None], far[i], section[i, None])
            for i in range(len(seeds))
        ]
    )
    n = surface.normals(truth)
    t1 = rays[:, 0]
    t2 = np.cross(n, t1) * np.sign(np.sum(np.cross(n, t1) * shape.frame[:, 2], axis=1))[:, None]
    beta, gamma, alpha = _contour_parameters(surface, truth, t1, t2)
    off = shape.position - truth
    error = np.stack(
        [
            np.sum(off * shape.frame[:, 0], axis=1),
            np.sum(off * t1, axis=1),
            -np.sum(n * shape.frame[:, 2], axis=1),
            shape.ray_radius - beta,
            shape.skew - gamma,
            shape.contour_curvature - alpha,
        ],
        axis=1,
    )
    contours = edgels.points[index]
    local = np.stack([n, t1, t2], axis=1)
    bound = _bound(
        np.einsum("nij,nmj->nmi", local, contours - truth[:, None]),
        np.einsum("nij,nmj->nmi", local, surface.normals(contours)),
        np.linalg.norm(contours - planes.centres[index], axis=2) * sigma,
    )
    return Trial(shape, surface.principal_curvatures(truth), error, bound)


def _contour_parameters(
    surface: Surface, points: np.ndarray, t1: np.ndarray, t2: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """True beta, gamma, alpha (n,) from normal curvatures along t1, t2 and between them."""
    along, across, between = (surface.normal_curvature(points, d) for d in (t1, t2, t1 + t2))
    mixed = between - 0.5 * (along + across)
    return 1 / along, -mixed / along, across - mixed**2 / along


def _bound(points: np.ndarray, normals: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """Cramer-Rao bound (n, 6) of the parameters, from true points and normals (n, M, 3) and sigma (n, M) [m]."""
    in_section = np.hypot(normals[..., 0], normals[..., 1])
    J = columns(np.arctan2(normals[..., 1], normals[..., 0]), points[..., 2], 2) * in_section[..., None]
    J = J / sigma[..., None]
    scale = np.linalg.norm(J, axis=1)
    J = J / scale[:, None]
    return np.sqrt(np.einsum("nii->ni", np.linalg.inv(np.swapaxes(J, 1, 2) @ J))) / scale


def _row(name: str, trials: list[Trial]) -> GeneralRow:
    def cat(get: Callable[[Trial], np.ndarray]) -> np.ndarray:
        return np.concatenate([get(t)[t.shape.valid] for t in trials])

    curvatures, error = cat(lambda t: t.curvatures), cat(lambda t: t.error)
    found, sigma = cat(lambda t: t.shape.principal_curvatures), cat(lambda t: t.shape.sigma_curvatures)
    radii, sigma_radii = cat(lambda t: t.shape.principal_radii), cat(lambda t: t.shape.sigma_radii)
    K, sigma_K = cat(lambda t: t.shape.gaussian), cat(lambda t: t.shape.sigma_gaussian)
    covariance = cat(lambda t: t.shape.covariance)
    order = np.argsort(-np.abs(curvatures), axis=1)  # the smaller radius first
    counted = np.all(np.abs(curvatures) > 1 / RADIUS, axis=1)
    relative = np.take_along_axis(np.abs(radii * curvatures - 1), order, 1)[counted]
    inside = np.take_along_axis(np.abs(found - curvatures) < 1.96 * sigma, order, 1)
    truth = np.prod(curvatures, axis=1)
    right = np.sign(K) == np.sign(truth)
    nees = np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariance), error) / 6
    cost = np.sqrt(np.einsum("nii->ni", covariance)) / cat(lambda t: t.bound)
    return GeneralRow(
        name,
        sum(len(t.error) for t in trials),
        int(sum((~t.shape.valid).sum() for t in trials)),
        float(counted.mean()),
        float(np.median(relative[:, 0])),
        float(np.median(relative[:, 1])),
        float(inside[:, 0].mean()),
        float(inside[:, 1].mean()),
        float(np.mean(np.abs(radii - 1 / curvatures)[counted] < 1.96 * sigma_radii[counted])),
        float(right[np.abs(truth) > SADDLE].mean()),
        float(right[np.abs(K) > 3 * sigma_K].mean()),
        float(nees.mean()),
        float(np.quantile(nees, 0.99)),
        float(np.median(cost[:, 3])),
        float(np.median(cost[:, 5])),
    )
