"""Shape from rendered frames when the robot is badly calibrated: every estimator on the same frames and pose errors.

The frames of each random vase are rendered and their contours found once; then pose errors are drawn again and again, and
tracking and estimation run as in `look`.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, fields, replace
from multiprocessing import get_context

import numpy as np
from scipy.spatial.transform import RigidTransform

from extremal.estimator import Camera, Contours, NotConverged, Shape, View, all_contours, shape_from_contours
from extremal.estimator.poses import pose_exp
from extremal.estimator.shape import Estimator
from extremal.scenes import Scene, load_scene, randomised
from extremal.scripts.scoring import Scored, score
from extremal.sim import ArmErrors, LinearMotion, Recording, record

ERRORS = ArmErrors(position=1e-3, rotation=1e-3)
MOTIONS = {
    "60 views over 800 mm at 1 m": LinearMotion(views=60, baseline=0.8, distance=1.0),
    "15 views over 400 mm at 0.6 m": LinearMotion(views=15, baseline=0.4, distance=0.6),
}
METHODS: dict[str, Estimator] = {
    "three-view circle": "circle",
    "N-view circle": "circle",
    "parallax": "parallax",
    "joint": "joint",
}
COMPARED = 3  # draws of each vase in which the other methods run beside joint
UPRIGHT = 0.3  # sine of the angle to the epipolar line from which a fixed feature counts as transversal


@dataclass(frozen=True)
class RenderedRow:
    """One motion and method over all trials; lengths in mm, shares from 0 to 1. Of extremal boundaries: points, median
    |R error| and sigma, coverage and NEES, median error of the contour generator: across the ray, as the reference camera
    sees it; along the surface's normal in the robot's world, and relative to the fixed features (after a similarity that
    aligns these). Of transversal fixed features: coverage and share called extremal."""

    motion: str
    method: str
    trials: int
    settled: float
    points: int
    radius_error_mm: float
    sigma_mm: float
    coverage: float
    nees: float
    across_mm: float
    normal_mm: float
    relative_mm: float
    fixed_coverage: float
    fixed_called_extremal: float


@dataclass(frozen=True, eq=False)
class _Sample:
    """What one trial gives: error, sigma and label of extremal and of transversal fixed points, position errors."""

    error: np.ndarray
    sigma: np.ndarray
    across: np.ndarray
    normal: np.ndarray
    relative: np.ndarray
    fixed_error: np.ndarray
    fixed_sigma: np.ndarray
    fixed_called: np.ndarray


def rendered_study(
    vases: int, draws: int, progress: Callable[[int, int], None] | None = None, first: int = 0
) -> list[RenderedRow]:
    """Rows for every motion and method over `vases` random vases, from seed `first`, with `draws` of pose errors each."""
    jobs = [(motion, seed, draws) for motion in MOTIONS for seed in range(first, first + vases)]
    found = []
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        for result in pool.map(_vase, jobs):
            found.append(result)
            if progress:
                progress(len(found), len(jobs))
    rows = []
    for motion in MOTIONS:
        for method in METHODS:
            samples = [s for job, r in zip(jobs, found, strict=True) if job[0] == motion for s in r[method]]
            rows.append(_row(motion, method, samples))
    return rows


def _vase(job: tuple[str, int, int]) -> dict[str, list[_Sample]]:
    motion, seed, draws = job
    scene = randomised(load_scene("vase-and-box"), np.random.default_rng(seed))
    recording = record(scene, Camera(), MOTIONS[motion], rng=np.random.default_rng(seed), workers=1)
    contours = all_contours(recording.views)
    samples: dict[str, list[_Sample]] = {method: [] for method in METHODS}
    for rng in np.random.default_rng([seed, 1]).spawn(draws):
        drawn = _with_errors(recording, rng)
        for method in METHODS if len(samples["joint"]) < COMPARED else ("joint",):
            samples[method].append(_sample(scene, drawn, contours, method))
    return samples


def _with_errors(recording: Recording, rng: np.random.Generator) -> Recording:
    """The recording with other poses believed; to either side errors have the same law."""
    actual = RigidTransform.concatenate(recording.actual)
    _, errors = ERRORS.scatter(len(actual), rng)
    believed = actual * pose_exp(errors)
    views = tuple(
        replace(view, T_world_camera=believed[i], pose_covariance=np.diag(ERRORS.repeatability**2))
        for i, view in enumerate(recording.views)
    )
    return replace(recording, views=views)


def _sample(scene: Scene, recording: Recording, contours: Sequence[Contours], method: str) -> _Sample:
    chosen = list(range(len(recording.views)))
    if method == "three-view circle":
        chosen = [0, len(chosen) // 2, len(chosen) - 1]
    views = tuple(recording.views[i] for i in chosen)
    part = replace(recording, views=views, actual=tuple(recording.actual[i] for i in chosen))
    try:
        shape = shape_from_contours(views, [contours[i] for i in chosen], METHODS[method])
    except NotConverged:
        return _Sample(*[np.zeros(0)] * len(fields(_Sample)))
    return _errors(shape, score(shape, part, scene), views[shape.reference], part.actual[shape.reference])


def _errors(shape: Shape, scored: Scored, view: View, actual: RigidTransform) -> _Sample:
    error = scored.column("radius_m") - scored.column("true_radius_m")
    sigma, truth = scored.column("sigma_radius_m"), scored.column("true_label")
    in_plane = np.cross(shape.epipolar_planes, shape.rays)
    fixed = (truth == "fixed") & (np.abs(np.sum(in_plane * shape.tangent_planes, axis=1)) > UPRIGHT)
    extremal = truth == "extremal"
    position, true = scored.column("position_m"), scored.column("true_position_m")
    here = shape.T_world_camera[shape.reference].inv().apply(position) if len(position) else position
    there = actual.inv().apply(true) if len(true) else true
    rays = there / np.linalg.norm(there, axis=1, keepdims=True)
    off = here - there
    across = np.linalg.norm(off - np.sum(off * rays, axis=1, keepdims=True) * rays, axis=1)
    aligned = _aligned(position, true, shape.covariance, fixed)
    called = scored.column("label") == "extremal"
    return _Sample(
        error[extremal],
        sigma[extremal],
        across[extremal],
        np.abs(np.sum((position - true) * shape.tangent_planes, axis=1))[extremal],
        np.abs(np.sum((aligned - true) * shape.tangent_planes, axis=1))[extremal],
        error[fixed],
        sigma[fixed],
        called[fixed],
    )


def _aligned(position: np.ndarray, true: np.ndarray, covariance: np.ndarray, fixed: np.ndarray) -> np.ndarray:
    """Positions (n, 3) [m] after the small similarity that brings the fixed points to theirs."""
    if fixed.sum() < 4:
        return np.full_like(position, np.nan)
    arm = position - position[fixed].mean(axis=0)
    basis = np.zeros((len(position), 3, 7))
    basis[:, :, :3], basis[:, :, 6] = np.eye(3), arm
    for k in range(3):
        basis[:, :, 3 + k] = np.cross(np.eye(3)[k], arm)
    weight = np.trace(covariance[fixed], axis1=1, axis2=2)[:, None] ** -0.5
    left = (basis[fixed] * weight[..., None]).reshape(-1, 7)
    return position + basis @ np.linalg.lstsq(left, ((true - position)[fixed] * weight).ravel())[0]


def _row(motion: str, method: str, samples: list[_Sample]) -> RenderedRow:
    def all_of(name: str) -> np.ndarray:
        return np.concatenate([getattr(s, name) for s in samples])

    error, sigma, fixed_error = all_of("error"), all_of("sigma"), all_of("fixed_error")
    return RenderedRow(
        motion,
        method,
        len(samples),
        float(np.mean([len(s.error) > 0 for s in samples])),
        len(error),
        1e3 * float(np.median(np.abs(error))),
        1e3 * float(np.median(sigma)),
        float(np.mean(np.abs(error) < 1.96 * sigma)),
        float(np.mean((error / sigma) ** 2)),
        1e3 * float(np.nanmedian(all_of("across"))),
        1e3 * float(np.nanmedian(all_of("normal"))),
        1e3 * float(np.nanmedian(all_of("relative"))),
        float(np.mean(np.abs(fixed_error) < 1.96 * all_of("fixed_sigma"))),
        float(np.mean(all_of("fixed_called"))),
    )


def rendered_table(rows: Sequence[RenderedRow]) -> str:
    """The rows as a markdown table."""
    head = (
        "| motion | method | trials | with an estimate | median abs(R error) [mm] | median sigma [mm] | within 1.96 sigma "
        "| NEES | position across the ray [mm] | along the normal [mm] | the same relative to fixed features [mm] | fixed: within 1.96 sigma "
        "| called extremal |"
    )
    lines = [head, "|" + "---|" * (head.count("|") - 1)]
    for r in rows:
        lines.append(
            f"| {r.motion} | {r.method} | {r.trials} | {100 * r.settled:.1f} % | {r.radius_error_mm:.3f} | {r.sigma_mm:.3f} "
            f"| {100 * r.coverage:.1f} % | {r.nees:.2f} | {r.across_mm:.4f} | {r.normal_mm:.3f} | {r.relative_mm:.3f} "
            f"| {100 * r.fixed_coverage:.1f} % | {100 * r.fixed_called_extremal:.1f} % |"
        )
    return "\n".join(lines)
