"""What each method makes of the same tangent planes: circles, parallax and the joint adjustment against the bound.

A circle of 40 mm radius at the origin and 12 fixed points around it lie in the plane z = 0, as do the cameras on a line along
y, all of which fixate the origin. Poses are off by 1 mm along both axes of the plane and by 1 mrad about its normal, independently;
every method starts from these noisy poses. The bound is computed from the exact angles, without any code of the estimator.
"""

import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, fields
from functools import cached_property
from multiprocessing import get_context
from typing import Any

import numpy as np

from extremal.estimator import osculating_circle
from extremal.estimator.adjustment import adjust
from extremal.estimator.camera import Array
from extremal.estimator.poses import PosePrior
from extremal.scripts.synthetic import Observation, TangentScene, observe
from extremal.sim import fixating

RADIUS = 0.04  # [m]
FIXED_POINTS, LAYOUT = 12, 12  # number, and the seed of their layout
SPREAD = (0.1, 0.12)  # [m] from the origin to which they reach: in depth, and along the cameras' line
POSITION, ROTATION = 1e-3, 1e-3  # [m], [rad] standard deviations of each pose
NORMAL, TRAVEL = np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0])
CHUNK = 25  # trials that a process does at once

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Planar:
    """Views of the plane: lengths in mm, standard deviation of edges and focal length in px (at the image's centre)."""

    distance_mm: float
    baseline_mm: float
    views: int
    edge_px: float
    focal_px: float = 800.0

    @property
    def sigma(self) -> float:
        """[rad] of every tangent plane."""
        return self.edge_px / self.focal_px

    @cached_property
    def scene(self) -> TangentScene:
        """The circle, then the fixed points, as lines across the plane."""
        along = 1e-3 * self.baseline_mm * np.linspace(-0.5, 0.5, self.views)
        cameras = along[:, None] * TRAVEL - (1e-3 * self.distance_mm, 0.0, 0.0)
        around = np.random.default_rng(LAYOUT).uniform(-1, 1, (FIXED_POINTS, 2)) * SPREAD
        n = 1 + FIXED_POINTS
        return TangentScene(
            fixating(cameras, np.zeros(3)),
            np.pad(around, ((1, 0), (0, 1))),
            np.array([RADIUS, *np.zeros(FIXED_POINTS)]),
            np.zeros(n),
            np.tile(NORMAL, (n, 1)),
            np.zeros((0, 3)),
        )

    @property
    def errors(self) -> PosePrior:
        """Errors of the poses: along x and z of the camera, and about its y axis, which is normal to the plane."""
        root = np.zeros((self.views, 6, 3))
        root[:, (0, 2, 4), range(3)] = POSITION, POSITION, ROTATION
        return PosePrior(self.scene.T_world_camera, root)

    @cached_property
    def reference(self) -> int:
        """The fixed point nearest to the extremal boundary: that of parallax."""
        points = self.scene.contacts[:, self.views // 2]
        return 1 + int(np.argmin(np.linalg.norm(points[1:] - points[0], axis=1)))


HALF_ARC = 2e3 * np.tan(0.3)  # [mm] the line that subtends +-0.3 rad at 1 m
CASES = (
    Planar(500, 100, 3, 0.1),
    Planar(600, 400, 15, 0.1),
    Planar(600, 400, 60, 0.1),
    Planar(1000, 800, 60, 0.02),
    Planar(1000, float(HALF_ARC), 21, 0.1, 1500),
)


@dataclass(frozen=True)
class JointRow:
    """Standard deviations of R [mm] over the trials of one case.

    Attributes:
        known_mm: bound with poses known exactly; bound_mm: Cramer-Rao bound with the poses' prior.
        three_views_mm: circle of the ends and the middle; absolute_mm: circle of all views; parallax_mm: its R less
            that of the fixed point nearest to it; joint_mm: bundle adjustment.
        ratio, bias_mm, nees, coverage: of the joint estimate: its deviation over the bound, mean error, mean square of
            error over sigma, share of errors within 1.96 sigma.
        converged: share of trials. Those that did not are left out of the columns before.
    """

    distance_mm: float
    baseline_mm: float
    views: int
    edge_px: float
    focal_px: float
    known_mm: float
    three_views_mm: float
    absolute_mm: float
    parallax_mm: float
    joint_mm: float
    bound_mm: float
    ratio: float
    bias_mm: float
    nees: float
    coverage: float
    converged: float


def joint_study(trials: int, progress: Progress | None = None) -> list[JointRow]:
    """All cases; `progress` is told of trials done and of their number."""
    found = in_processes(planar_trials, len(CASES), trials, progress)
    return [joint_row(case, estimates) for case, estimates in zip(CASES, found, strict=True)]


def in_processes(
    work: Callable[[tuple[int, int, int]], Array], cases: int, trials: int, progress: Progress | None
) -> list[Array]:
    """What `work` returns of trials (case, first, number), put together by case; two processes at a time."""
    jobs = [(i, start, min(CHUNK, trials - start)) for i in range(cases) for start in range(0, trials, CHUNK)]
    found: list[list[Array]] = [[] for _ in range(cases)]
    done = 0
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        for (i, _, count), result in zip(jobs, pool.map(work, jobs), strict=True):
            found[i].append(result)
            done += count
            if progress:
                progress(done, trials * cases)
    return [np.concatenate(parts) for parts in found]


def study_table(rows: Sequence[Any]) -> str:
    """Rows of one study as a table in GitHub's Markdown."""
    names = [field.name for field in fields(rows[0])]
    lines = [" | ".join(names), " | ".join(["---:"] * len(names))]
    lines += [" | ".join(_cell(name, getattr(row, name)) for name in names) for row in rows]
    return "\n".join(f"| {line} |" for line in lines)


def _cell(name: str, value: str | float) -> str:
    if isinstance(value, str | int):
        return str(value)
    if name.endswith(("coverage", "converged")):
        return f"{value:.1%}"
    return f"{value:.3f}" if name.startswith(("ratio", "bias", "nees")) else f"{value:.3g}"


def planar_trials(job: tuple[int, int, int]) -> Array:
    """Estimates (trials, 6) [m] of a case, for the trials from a first one on: three views, all, parallax, joint and its
    sigma; and whether this converged."""
    case, start, count = job
    rng = np.random.default_rng([case, start])
    return np.array([_estimates(CASES[case], rng) for _ in range(count)])


def _estimates(case: Planar, rng: np.random.Generator) -> tuple[float, ...]:
    seen = observe(case.scene, case.errors, case.sigma, rng)
    every = np.arange(case.views)
    three = _circle_radii(seen, every[[0, case.views // 2, -1]], case.sigma)
    radii = _circle_radii(seen, every, case.sigma)
    found = adjust(seen.prior, seen.features)
    shape = found.shapes[0]
    joint, sigma = float(shape.radius[0]), float(shape.sigma_radius[0])
    return three[0], radii[0], radii[0] - radii[case.reference], joint, sigma, found.converged


def _circle_radii(seen: Observation, views: np.ndarray, sigma: float) -> Array:
    """R (n,) of circles through some views, with poses as they are believed."""
    poses, normals = seen.prior.T_world_camera, seen.features[0].normals[:, 0]
    rays = np.cross(NORMAL, np.einsum("nvk,vjk->nvj", normals, poses.rotation.as_matrix()))
    rays *= -np.sign(rays[..., :1] * poses.translation[:, :1])
    return osculating_circle(poses.translation[views], rays[:, views], sigma, NORMAL).radius


def joint_row(case: Planar, estimates: Array) -> JointRow:
    """Deviations of `planar_trials`."""
    converged = estimates[:, 5] > 0
    error, sigma = estimates[converged, 3] - RADIUS, estimates[converged, 4]
    known, bound = radius_bounds(case)
    three, absolute, parallax = (1e3 * float(np.std(estimates[:, k])) for k in range(3))
    return JointRow(
        case.distance_mm,
        case.baseline_mm,
        case.views,
        case.edge_px,
        case.focal_px,
        1e3 * known,
        three,
        absolute,
        parallax,
        1e3 * float(error.std()),
        1e3 * bound,
        float(error.std()) / bound,
        1e3 * float(error.mean()),
        float(np.mean((error / sigma) ** 2)),
        float(np.mean(np.abs(error) < 1.96 * sigma)),
        float(converged.mean()),
    )


def radius_bounds(case: Planar) -> tuple[float, float]:
    """Cramer-Rao bounds of R [m]: with poses known, and with their prior."""
    views, n = case.views, 1 + FIXED_POINTS
    J = angle_derivatives(case).reshape(n * views, -1) / case.sigma
    information = J.T @ J
    shape = slice(3 * views, None)
    known = np.linalg.inv(information[shape, shape])
    information[: 3 * views, : 3 * views] += np.diag(
        np.repeat([POSITION**-2, POSITION**-2, ROTATION**-2], views)
    )
    return float(np.sqrt(known[-1, -1])), float(np.sqrt(np.linalg.inv(information)[-1, -1]))


def angle_derivatives(case: Planar) -> Array:
    """Derivatives (n, V, 3 V + 2 n + 1) of the exact angles of all rays in their cameras: by the cameras' x, their y and
    rotations (V each), the features' x and y (n pairs), and R.

    A ray that touches a circle lies at the angle atan2(y, x) + asin(R / d), with (x, y) = centre - camera of length d.
    """
    scene, views = case.scene, case.views
    towards = (scene.centres[:, None] - scene.T_world_camera.translation)[..., :2]
    d, R = np.linalg.norm(towards, axis=-1), scene.radii[:, None]
    length = np.sqrt(d**2 - R**2)
    x, y = towards[..., 0], towards[..., 1]
    by_x, by_y = (-y - R * x / length) / d**2, (x - R * y / length) / d**2
    n = len(d)
    J = np.zeros((n, views, 3 * views + 2 * n + 1))
    every, item = np.arange(views), np.arange(n)
    J[:, every, every], J[:, every, views + every], J[:, every, 2 * views + every] = -by_x, -by_y, -1
    J[item, :, 3 * views + 2 * item], J[item, :, 3 * views + 2 * item + 1] = by_x, by_y
    J[0, :, -1] = 1 / length[0]
    return J


def main() -> None:
    """Print the table for a number of trials: python -m extremal.scripts.joint_study 4000."""
    print(study_table(joint_study(int(sys.argv[1]) if len(sys.argv) > 1 else 1000)))


if __name__ == "__main__":
    main()
