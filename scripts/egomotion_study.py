"""What limits R: renderer, edges, intrinsics and egomotion, one after the other, on the same rendered frames.

The frames of each random vase are rendered once, with a board in front of it. What is known of the poses is drawn by the laws
that each arm states: T_believed = T_actual exp(-e), e with its errors common to all views and those of each view.
"""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from io import StringIO
from multiprocessing import get_context
from typing import get_args

import numpy as np
from rich.console import Console
from scipy.linalg import block_diag
from scipy.spatial.transform import RigidTransform

from extremal.estimator import Camera, Contours, NotConverged, PosePrior, all_contours, shape_from_contours
from extremal.estimator.board import Board
from extremal.estimator.poses import pose_exp
from extremal.estimator.projection import INTRINSICS, intrinsics, with_intrinsics
from extremal.estimator.shape import Estimator
from extremal.scenes import load_scene, randomised
from extremal.scenes.board import CalibrationBoard
from extremal.scripts.calibrate import CalibrateSettings, simulated_calibration
from extremal.scripts.poses import Egomotion, board_poses, prior_of, with_poses, without_board
from extremal.scripts.scoring import Scored, score
from extremal.sim import LinearMotion, Recording, Sensor, record
from extremal.sim.arm_errors import ArmName
from extremal.sim.board_place import board_in_view
from extremal.sim.rig import Rig

MOTION = LinearMotion(views=15, baseline=0.4, distance=0.6)
NOISE = 2.0  # [grey levels]
ARMS = tuple(name for name in get_args(ArmName) if name != "ideal")
ESTIMATORS: tuple[Estimator, ...] = get_args(Estimator)


@dataclass(frozen=True)
class BudgetRow:
    """Extremal boundaries of all vases, seen with what is known of poses and camera: number of points, median |R error| and
    sigma [mm], share within 1.96 sigma."""

    known: str
    estimator: str
    points: int
    radius_error_mm: float
    sigma_mm: float
    coverage: float


@dataclass(frozen=True, eq=False)
class _Known:
    """What is wrong, what is known of it, and the contours that are used."""

    name: str
    camera: Camera
    prior: PosePrior
    contours: list[Contours]
    estimators: Sequence[Estimator]


def egomotion_study(
    vases: int, progress: Callable[[int, int], None] | None = None, first: int = 0
) -> list[BudgetRow]:
    """Rows for everything that may be wrong, over `vases` random vases from seed `first`."""
    settings = CalibrateSettings(arm="typical", camera="industrial", seed=first)
    fit, *_ = simulated_calibration(settings, Board(), Console(file=StringIO()))
    lens = np.linalg.cholesky(fit.calibration.covariance_of(INTRINSICS))
    found: dict[tuple[str, str], list[np.ndarray]] = {}
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        for i, result in enumerate(pool.map(_vase, [(first + k, lens) for k in range(vases)])):
            for key, errors in result.items():
                found.setdefault(key, []).append(errors)
            if progress:
                progress(i + 1, vases)
    return [_row(*key, np.concatenate(errors)) for key, errors in found.items()]


def _vase(job: tuple[int, np.ndarray]) -> dict[tuple[str, str], np.ndarray]:
    """Errors and sigmas (n, 2) [m] of R for everything that is known, by every estimator."""
    seed, lens = job
    rng = np.random.default_rng(seed)
    scene, camera = randomised(load_scene("vase-and-box"), rng), Camera()
    placed = board_in_view(scene, camera, MOTION.poses(scene.target, rng))
    watched = replace(scene, objects=(*scene.objects, placed))
    silent = record(watched, camera, MOTION, sensor=Sensor(0.0), rng=rng, workers=1)
    seen = board_poses(silent.views, placed.board)
    quiet = replace(silent, views=tuple(without_board(silent.views, placed.board, seen)))
    noisy = replace(quiet, views=tuple(replace(v, image=_noisy(v.image, camera, rng)) for v in quiet.views))
    results = {}
    for known in _everything(quiet, noisy, placed, lens, rng):
        views = [replace(view, camera=known.camera) for view in with_poses(noisy.views, known.prior)]
        for estimator in known.estimators:
            try:
                shape = shape_from_contours(views, known.contours, estimator, known.prior)
            except NotConverged:
                continue
            results[known.name, estimator] = _errors(score(shape, noisy, watched))
    return results


def _noisy(image: np.ndarray, camera: Camera, rng: np.random.Generator) -> np.ndarray:
    return Sensor(NOISE).read(image.astype(np.float32), camera, rng)


def _everything(
    quiet: Recording, noisy: Recording, placed: CalibrationBoard, lens: np.ndarray, rng: np.random.Generator
) -> Iterator[_Known]:
    """From nothing wrong but the renderer to poor arms."""
    camera, actual = quiet.camera, RigidTransform.concatenate(quiet.actual)
    exact = PosePrior(actual, np.zeros((len(actual), 6, 0)))
    yield _Known("exact poses, no noise", camera, exact, all_contours(quiet.views), ("circle",))
    contours = all_contours(noisy.views)
    yield _Known("exact poses", camera, exact, contours, ("circle",))
    for arm in ARMS:
        rig = Rig.individual(arm, "ideal", 0)
        root = np.asarray(block_diag(lens, rig.root[len(INTRINSICS) :]))
        z = rng.standard_normal(root.shape[1])
        believed = with_intrinsics(camera, intrinsics(camera) - root[: len(INTRINSICS)] @ z)
        rig = replace(rig, believed_camera=believed, root=root)
        if arm == ARMS[0]:
            yield _Known("exact poses, calibrated intrinsics", believed, exact, contours, ("circle",))
        z[: lens.shape[1]] = 0.0  # the camera has these
        prior = rig.prior(quiet.readings, quiet.T_world_base)
        own = np.einsum("vik,vk->vi", prior.root, rng.standard_normal(prior.root.shape[::2]))
        robot = replace(prior, T_world_camera=actual * pose_exp(-(own + prior.common @ z)))
        seen = board_poses([replace(view, camera=believed) for view in noisy.views], placed.board)
        for egomotion in get_args(Egomotion):
            if egomotion == "board" and arm != ARMS[0]:
                continue  # the arm has no part in it
            name = "board" if egomotion == "board" else f"{arm} arm, {egomotion}"
            found = prior_of(egomotion, robot, seen, placed.T_world_object, believed, root[: len(INTRINSICS)])
            yield _Known(name, believed, found, contours, ESTIMATORS)


def _errors(scored: Scored) -> np.ndarray:
    """(n, 2) error and sigma of R [m] of what is an extremal boundary."""
    error = scored.column("radius_m") - scored.column("true_radius_m")
    chosen = np.isfinite(error) & (scored.column("true_label") == "extremal")
    return np.stack([error, scored.column("sigma_radius_m")], axis=1)[chosen]


def _row(known: str, estimator: str, errors: np.ndarray) -> BudgetRow:
    error, sigma = np.abs(errors).T
    return BudgetRow(
        known,
        estimator,
        len(errors),
        1e3 * float(np.median(error)),
        1e3 * float(np.median(sigma)),
        float(np.mean(error < 1.96 * sigma)),
    )


def egomotion_table(rows: Sequence[BudgetRow]) -> str:
    """The rows as a markdown table."""
    lines = [
        "| known | estimator | points | median abs(R error) [mm] | median sigma [mm] | within 1.96 sigma |",
        "|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {r.known} | {r.estimator} | {r.points} | {r.radius_error_mm:.3f} | {r.sigma_mm:.3f} | {100 * r.coverage:.1f} % |"
        for r in rows
    ]
    return "\n".join(lines)
