"""Are the joint adjustment's standard deviations honest in space? Spheres, straight lines and points by Monte Carlo.

Cameras on a line of 0.8 m, 1 m from the objects, with irregular steps; every pose is off by 1 mm and 1 mrad in all six directions.
The spheres are cut obliquely. Sigma is exact in the limit of small errors only: as the plane of a section is believed, it passes
1 mm beside the true one, and its circle is off by about (1 mm)^2 / 2 R. With edges of 0.02 px that shows: it makes a NEES of 1.10
of one of 0.98.
"""

import sys
from dataclasses import dataclass
from typing import cast

import numpy as np

from extremal.estimator.adjustment import Adjustment, adjust
from extremal.estimator.camera import Array
from extremal.estimator.poses import PosePrior, pose_log
from extremal.estimator.support import Sections
from extremal.scripts.joint_study import POSITION, ROTATION, Progress, in_processes, study_table
from extremal.scripts.synthetic import Observation, TangentScene, observe
from extremal.sim import LinearMotion

CONTOURS, POINTS = 20, 50  # half of the contours are spheres, half are straight lines
HAND_EYE = (2e-3, 2e-3)  # [m], [rad] standard deviations of what all poses share
FOCAL = 3e-3  # of the focal length
FOCAL_PX = 800.0


@dataclass(frozen=True)
class Spatial:
    """Views of a scene in space; `common` adds a wrong hand-eye transform and a wrong focal length."""

    views: int
    edge_px: float
    common: bool = False


CASES = (Spatial(15, 0.1), Spatial(60, 0.1), Spatial(60, 0.02), Spatial(15, 0.1, common=True))


@dataclass(frozen=True)
class SpatialRow:
    """Errors over sigma in all trials of one case.

    Attributes:
        sigma_mm: median sigma of R of the spheres.
        nees_sphere, sphere_coverage: of their R; nees_line, line_coverage: of R = 0 of lines held fixed.
        nees_point: of coordinates of points; nees_pose: of poses (6 each); nees_focal: of the focal length; 0 where it is known.
        converged: share of trials; the other columns leave out those that did not.
    """

    views: int
    edge_px: float
    errors: str
    sigma_mm: float
    nees_sphere: float
    sphere_coverage: float
    nees_line: float
    line_coverage: float
    nees_point: float
    nees_pose: float
    nees_focal: float
    converged: float


def spatial_study(trials: int, progress: Progress | None = None) -> list[SpatialRow]:
    """All cases; `progress` is told of trials done and of their number."""
    found = in_processes(spatial_trials, len(CASES), trials, progress)
    return [spatial_row(case, scores) for case, scores in zip(CASES, found, strict=True)]


def spatial_trials(job: tuple[int, int, int]) -> Array:
    """Scores (trials, 9): the columns of a row from sigma_mm on, as means within a trial."""
    case, start, count = job
    rng = np.random.default_rng([100 + case, start])
    return np.array([_scores(*_trial(CASES[case], rng)) for _ in range(count)])


def _trial(case: Spatial, rng: np.random.Generator) -> tuple[TangentScene, Observation, Adjustment]:
    scene = random_scene(case.views, CONTOURS, POINTS, rng)
    seen = observe(scene, pose_errors(scene, case.common), case.edge_px / FOCAL_PX, rng)
    return scene, seen, adjust(seen.prior, seen.features)


def random_scene(views: int, contours: int, points: int, rng: np.random.Generator) -> TangentScene:
    """Spheres on both sides of their limbs and straight lines, by turns, and points, within 0.12 m around the origin."""
    radii = rng.choice([-1, 1], contours) * rng.uniform(0.015, 0.06, contours)
    radii[1::2] = 0.0
    return TangentScene(
        LinearMotion(views, baseline=0.8, distance=1.0).poses(np.zeros(3), rng),
        rng.uniform(-0.12, 0.12, (contours, 3)),
        radii,
        rng.uniform(-0.5, 0.5, contours) * np.abs(radii),
        np.array([0.0, 0.0, 1.0]) + 0.4 * rng.standard_normal((contours, 3)),
        rng.uniform(-0.12, 0.12, (points, 3)),
    )


def pose_errors(scene: TangentScene, common: bool) -> PosePrior:
    """Independent errors of all views; with `common` also those that they share, and of the focal length."""
    views = len(scene.T_world_camera)
    root = np.tile(np.diag(np.repeat([POSITION, ROTATION], 3)), (views, 1, 1))
    if not common:
        return PosePrior(scene.T_world_camera, root)
    shared = np.tile(np.diag(np.repeat(HAND_EYE, 3)), (views, 1, 1))
    return PosePrior(scene.T_world_camera, root, shared, FOCAL)


def _scores(scene: TangentScene, seen: Observation, found: Adjustment) -> tuple[float, ...]:
    contours, points = found.shapes
    error = contours.radius - scene.section_radii(cast(Sections, seen.features[0]))
    z = error / contours.sigma_radius
    sphere = scene.radii != 0
    at = seen.features[1].origin + points.theta - scene.points
    missed = pose_log(found.T_world_camera.inv() * scene.T_world_camera)
    return (
        1e3 * float(np.median(contours.sigma_radius[sphere])),
        float(np.mean(z[sphere] ** 2)),
        float(np.mean(np.abs(z[sphere]) < 1.96)),
        float(np.mean(z[~sphere] ** 2)),
        float(np.mean(np.abs(z[~sphere]) < 1.96)),
        mean_square(at, points.covariance),
        mean_square(missed, found.pose_covariance),
        (found.focal - seen.focal) ** 2 / found.focal_sigma**2 if found.focal_sigma else 0.0,
        found.converged,
    )


def mean_square(errors: Array, covariance: Array) -> float:
    """Normalised square per component of errors (n, k) with covariances (n, k, k): 1 where these are right."""
    return float(np.mean(errors * np.linalg.solve(covariance, errors[..., None])[..., 0]))


def spatial_row(case: Spatial, scores: Array) -> SpatialRow:
    """Means of `spatial_trials`."""
    converged = scores[:, -1] > 0
    means = scores[converged].mean(axis=0)[:-1]
    errors = "hand-eye and focal length, too" if case.common else "of each pose"
    return SpatialRow(case.views, case.edge_px, errors, *map(float, means), converged=float(converged.mean()))


def main() -> None:
    """Print the table for a number of trials: python -m extremal.scripts.spatial_study 500."""
    print(study_table(spatial_study(int(sys.argv[1]) if len(sys.argv) > 1 else 500)))


if __name__ == "__main__":
    main()
