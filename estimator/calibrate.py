"""Camera, hand-eye transform, board pose and the arm's own errors, from images of one board and the robot's poses.

OpenCV's calibration of the camera and Park's hand-eye calibration are where it starts (`calibration_start`). Then all unknowns
are adjusted together to the corners, each weighted by its own covariance (`calibration_equations`): the most probable values,
and the inverse of their normal equations is their covariance. Blunders are left out, and how well corners and robot are
known is estimated, too (`calibration_noise`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from extremal.estimator.board import Board
from extremal.estimator.bordered import Bordered
from extremal.estimator.calibration import Calibration
from extremal.estimator.calibration_equations import (
    ARM,
    TWIST,
    FlangeModel,
    Linearised,
    Sightings,
    State,
    linearise,
)
from extremal.estimator.calibration_noise import STEADY, find_blunders, likely_scales
from extremal.estimator.calibration_start import FEWEST_CORNERS, spanning, start_state
from extremal.estimator.camera import Array, Camera
from extremal.estimator.corners import Corners
from extremal.estimator.errors import DegenerateGeometry, InvalidInput, NotConverged
from extremal.estimator.poses import PosePrior, square_root

MOST_BLUNDERS = 0.3  # of the views: with more nothing tells which are right
ROUNDS = 40
MOST_SEARCHES = 6  # for factors on standard deviations: they are steady after two or three
STEPS = 30
SETTLED = 1e-5  # decrease of chi2 that a step may still promise
WORST_FOCAL = 0.02  # sd of the focal length, as a fraction of it, beyond which linear error propagation ends


@dataclass(frozen=True, eq=False)
class CalibrationFit:
    """A calibration and what it says of the V views and N corners that it was made from.

    Attributes:
        calibration: the result.
        T_board_camera: (V) poses of the camera, from robot and board together.
        pose_covariance: (V, 6, 6) of their errors (translation [m], rotation vector [rad]) in the camera frame,
            right-multiplied; infinite for blunders.
        residuals: (V, N, 2) predicted minus seen corners [px], zero where not used; used: (V, N) which were.
        blunders: (V,) views whose robot pose is off by more than its standard deviations allow, or most of whose corners
            are; they are not used.
        corner_scale: factor on the corners' standard deviations, at least 1.
        view_scales: (2,) factors on those of single views' translations and rotations.
    """

    calibration: Calibration
    T_board_camera: RigidTransform
    pose_covariance: Array
    residuals: Array
    used: np.ndarray
    blunders: np.ndarray
    corner_scale: float
    view_scales: Array


def fixed_poses(T_base_flange: RigidTransform, position: float, rotation: float) -> FlangeModel:
    """A robot of which nothing but its poses (V) is known, and standard deviations [m], [rad] of each axis in each view."""
    covariance = np.diag([position**2] * 3 + [rotation**2] * 3)
    prior = PosePrior(T_base_flange, square_root(np.tile(covariance, (len(T_base_flange), 1, 1))))
    return lambda c: prior


def calibrate(
    board: Board,
    corners: Sequence[Corners],
    flange: FlangeModel,
    size: tuple[int, int],
    start: Camera | None = None,
    *,
    arm_sigma: Mapping[str, float] | None = None,
    scale_view_errors: bool = False,
) -> CalibrationFit:
    """Calibrate camera, hand-eye transform, board pose and arm together.

    Args:
        board: the board. corners: what V >= 3 views show of it; views of fewer than six corners are not used.
        flange: poses of the flange and their errors.
        size: (width, height) of the images [px].
        start: a first guess of the camera, from which blur and gamma are kept.
        arm_sigma: name and standard deviation [m], [rad] of each of the C common errors of `flange`, in their order.
        scale_view_errors: whether the views' own errors may be smaller than `flange` states, too: for a robot that nothing
            is known of. They are taken for larger in any case where corners and robot say so.

    Raises:
        InvalidInput: numbers of views or sizes that do not fit; robot and images that contradict each other.
        DegenerateGeometry: fewer than three usable views, rotations not about two axes, or views that leave the
            focal length open.
        NotConverged: the adjustment did not settle.
    """
    sigma = dict(arm_sigma or {})
    prior = flange(np.zeros(len(sigma)))
    _check(board, prior, corners, size, start, len(sigma))
    sightings = Sightings.of(board, spanning(board, corners))
    seen, blunders = sightings.used.sum(axis=1), np.zeros(len(corners), bool)
    scales, searches = np.ones(3), 0
    _check_enough(sightings, blunders)
    state = start_state(board, sightings, prior, size, start)
    for _ in range(ROUNDS):
        here, normal = _settled(state, sightings, flange, scales)
        state = here.state
        far, wrong = find_blunders(here, sightings, seen)
        if np.any(far):
            blunders, sightings = blunders | wrong, sightings.without(far)
            _check_enough(sightings, blunders)
            continue
        before, scales = scales, likely_scales(here, sightings, scales, scale_view_errors)
        searches += 1
        if searches == MOST_SEARCHES or np.all(np.abs(np.log(scales / before)) < STEADY):
            return _result(board, here, normal, sightings, blunders, before, sigma)
    raise NotConverged("the calibration did not settle: too many corners or robot poses are blunders")


def _check(
    board: Board,
    prior: PosePrior,
    corners: Sequence[Corners],
    size: tuple[int, int],
    start: Camera | None,
    common: int,
) -> None:
    if len(prior.T_world_camera) != len(corners):
        raise InvalidInput(
            f"{len(corners)} views of the board but {len(prior.T_world_camera)} robot poses; accepted: one for each"
        )
    if prior.common.shape[2] != common:
        raise InvalidInput(
            f"the flange's model has {prior.common.shape[2]} common errors, named are {common}; accepted: as many"
        )
    if start is not None and (start.width, start.height) != tuple(size):
        raise InvalidInput(
            f"images are {size[0]} x {size[1]} px, the camera {start.width} x {start.height}; accepted: the same"
        )
    most = len(board.corners) - 1
    for i, seen in enumerate(corners):
        if len(seen) and not 0 <= seen.ids.min() <= seen.ids.max() <= most:
            raise InvalidInput(
                f"view {i} has corners of ids {seen.ids.min()} to {seen.ids.max()}; accepted: 0 to {most}, the board's"
            )


def _check_enough(sightings: Sightings, blunders: np.ndarray) -> None:
    used = sightings.views
    views = int(used.sum())
    if views < 3:
        raise DegenerateGeometry(
            f"{views} of {len(used)} views show the board well enough ({FEWEST_CORNERS} corners or more, not on one line, that "
            "agree with the robot's pose); accepted: at least three"
        )
    if blunders.sum() > MOST_BLUNDERS * (views + blunders.sum()):
        raise InvalidInput(
            f"robot and images contradict each other in {blunders.sum()} of {views + blunders.sum()} views, among them "
            f"{np.flatnonzero(blunders)[:5].tolist()}; accepted: up to {MOST_BLUNDERS:.0%}"
        )


def _settled(
    state: State, sightings: Sightings, flange: FlangeModel, scales: Array
) -> tuple[Linearised, Bordered]:
    """Gauss-Newton steps, with Levenberg's damping where they overshoot."""
    here, damping = linearise(state, sightings, flange, scales[1:]), 0.0
    for _ in range(STEPS):
        normal = here.normal(scales)
        if abs(normal.decrease) < SETTLED:
            return here, normal
        step = (normal.damped(damping) if damping else normal).step
        there = linearise(here.state.moved(*step), sightings, flange, scales[1:])
        if there.cost(scales[0]) <= here.cost(scales[0]) * (1 + 1e-9) + SETTLED:
            here, damping = there, damping / 10 if damping > 1e-6 else 0.0
        else:
            damping = max(10 * damping, 1e-3)
    raise NotConverged(f"the calibration did not settle in {STEPS} steps")


def _result(
    board: Board,
    here: Linearised,
    normal: Bordered,
    sightings: Sightings,
    blunders: np.ndarray,
    scales: Array,
    arm_sigma: Mapping[str, float],
) -> CalibrationFit:
    state, used = here.state, sightings.used
    by_own, units = here.by_own(scales[1:])[:, TWIST], np.ones(len(normal.common))
    units[ARM] = list(arm_sigma.values())
    covariance = normal.covariance * np.outer(units, units)
    focal = np.sqrt(covariance[0, 0]) / state.camera.fx
    if not focal < WORST_FOCAL:
        raise DegenerateGeometry(
            f"the focal length is known to {focal:.1%} only; accepted: views that tell it within {WORST_FOCAL:.0%}, of boards "
            "slanted by 20 degrees or more"
        )
    pose_covariance = normal.view_covariance(here.by_common[:, TWIST], by_own)
    pose_covariance[blunders] = np.inf * np.ones((6, 6))
    left = np.mean(np.sum(by_own**2, axis=2), axis=0)
    arm = dict(zip(arm_sigma, (units[ARM] * state.c).tolist(), strict=True))
    return CalibrationFit(
        Calibration(
            state.camera,
            state.T_flange_camera,
            state.T_base_board,
            board,
            covariance,
            (float(np.sqrt(left[:3].mean())), float(np.sqrt(left[3:].mean()))),
            float(np.sqrt(np.mean(np.sum(here.residuals[used] ** 2, axis=1)))),
            int(sightings.views.sum()),
            arm,
        ),
        here.T_board_camera,
        pose_covariance,
        here.residuals,
        used,
        blunders,
        float(scales[0]),
        scales[1:],
    )
