"""`extremal calibrate`: camera, hand-eye transform and arm from images of a board, simulated or your own."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import tyro
from rich.box import SIMPLE
from rich.console import Console
from rich.progress import Progress, track
from rich.table import Table
from scipy.spatial.transform import RigidTransform

from extremal.estimator import InvalidInput
from extremal.estimator.board import Board
from extremal.estimator.calibrate import CalibrationFit, fixed_poses
from extremal.estimator.calibrate import calibrate as fit_calibration
from extremal.estimator.calibration import HAND_EYE, Simulation
from extremal.estimator.calibration_file import save_calibration
from extremal.estimator.camera import Camera
from extremal.estimator.corners import Corners, find_corners
from extremal.estimator.photographs import read_photographs, write_poses
from extremal.estimator.poses import pose_log
from extremal.estimator.projection import INTRINSICS, intrinsics
from extremal.scenes import Scene
from extremal.scenes.scene import Background, Light
from extremal.scripts.calibrate_report import calibrate_report
from extremal.scripts.calibration_picture import draw_calibration
from extremal.scripts.output import output_folder
from extremal.sim import Recording, get_arm, record
from extremal.sim.arm_errors import ArmName
from extremal.sim.board_motion import BoardMotion
from extremal.sim.board_place import upright_board
from extremal.sim.cameras import CameraName
from extremal.sim.chain import NOMINAL
from extremal.sim.rig import Rig

CENTRE = (0.0, 0.0, 0.25)  # of the simulated board [m]
LIGHTS = (Light((1.0, 0.2, -0.4), diffuse=0.5, ambient=0.3, specular=0.0),)
SKY = (0.6, 0.62, 0.65)


@dataclass(frozen=True)
class CalibrateSettings:
    """Calibrate camera, hand-eye transform and arm by a ChArUco board: in simulation, or from your own photographs."""

    images: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """folder of photographs of the board, PNG or JPEG; with --poses"""
    poses: Annotated[Path | None, tyro.conf.arg(metavar="CSV")] = None
    """T_base_flange of each photograph: image,x,y,z,qx,qy,qz,qw or image,x,y,z,rx,ry,rz [m, rad]; see docs/calibration.md"""
    arm: ArmName = "calibrated"
    """how good the arm is; of photographs, how good its poses are taken to be at first"""
    camera: CameraName = "industrial"
    """simulated lens and sensor"""
    views: Annotated[int, tyro.conf.arg(metavar="N")] = 30
    """number of simulated views"""
    quality: str = "standard"
    """of rendering: preview, standard or metrology"""
    board: tuple[int, int] = (9, 6)
    """squares along x and y"""
    square: float = 0.03
    """side of a square [m]"""
    marker: float | None = None
    """side of a marker [m]; by default 3/4 of the square"""
    dictionary: str = "DICT_4X4_100"
    """of the markers, as OpenCV calls it"""
    seed: int = 0
    """of the individual arm, its motion and the noise"""
    frames: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """also keep the simulated frames and poses.csv, in the format of --images and --poses"""
    out: Annotated[Path, tyro.conf.arg(metavar="FILE")] = Path("calibration.toml")
    """what is written; report.html, calibration.png, and in simulation calibration.json, go beside it"""


@dataclass(frozen=True, eq=False)
class Truth:
    """What a simulated calibration should have found."""

    camera: Camera
    T_flange_camera: RigidTransform
    T_board_camera: RigidTransform


def calibrate(settings: CalibrateSettings) -> None:
    """Calibrate, and write the calibration, its picture and, in simulation, its errors."""
    console = Console(markup=False)
    if (settings.images is None) != (settings.poses is None):
        raise InvalidInput("--images and --poses go together; accepted: both, or neither to simulate")
    if settings.out.suffix != ".toml":
        raise InvalidInput(f"--out is {str(settings.out)!r}; accepted: a file that ends in .toml")
    if settings.seed < 0:
        raise InvalidInput(f"--seed is {settings.seed}; accepted: a whole number from 0")
    marker = 0.75 * settings.square if settings.marker is None else settings.marker
    board = Board(*settings.board, settings.square, marker, settings.dictionary)
    with output_folder(settings.out.parent) as folder:
        if settings.images is not None and settings.poses is not None:
            fit, images = _from_photographs(settings, board, settings.images, settings.poses, console)
            errors = None
        else:
            fit, truth, recording = simulated_calibration(settings, board, console)
            errors, images = calibration_errors(fit, truth), [view.image for view in recording.views]
            (folder / "calibration.json").write_text(json.dumps(errors, indent=1) + "\n")
            if settings.frames is not None:
                _keep(settings.frames, recording)
        save_calibration(fit.calibration, folder / settings.out.name)
        draw_calibration(fit, folder / "calibration.png")
        table, summary = _table(fit), _summary(fit, errors)
        report = calibrate_report(fit, images, table, summary, asdict(settings))
        report.save(folder / "report.html")
    console.print(table)
    console.print(summary)
    beside = "report.html, calibration.png" + (" and calibration.json" if errors else "")
    console.print(f"wrote {settings.out}, {beside} beside it")


def simulated_calibration(
    settings: CalibrateSettings, board: Board, console: Console
) -> tuple[CalibrationFit, Truth, Recording]:
    """Carry a camera of the settings' kind around a board, calibrate it, and say what is true.

    Raises:
        DegenerateGeometry: the views do not tell all that is to be calibrated.
        InvalidInput: an unknown quality, or poses that the arm can't take.
    """
    rig = Rig.individual(settings.arm, settings.camera, settings.seed)
    placed = upright_board(board, np.array(CENTRE))
    scene = Scene((placed,), LIGHTS, Background(SKY), CENTRE, "calibration")
    motion = BoardMotion(views=settings.views, distance=1.67 * float(np.max(board.size)))
    with Progress(console=console, transient=True) as progress:
        task = progress.add_task("rendering", total=settings.views)
        recording = record(
            scene,
            rig.camera,
            motion,
            settings.quality,
            rig.sensor,
            rig.errors,
            np.random.default_rng([settings.seed, 2]),
            progress=lambda done, total: progress.update(task, completed=done, total=total),
            geometry=rig.geometry,
        )
    known = Camera(rig.camera.width, rig.camera.height, blur=rig.camera.blur, gamma=rig.camera.gamma)
    corners = _corners([view.image for view in recording.views], known, board, console)
    flange = rig.errors.flange_model(NOMINAL, recording.readings)
    fit = fit_calibration(
        board,
        corners,
        flange,
        (known.width, known.height),
        known,
        arm_sigma=dict(zip(flange.names, flange.scales.tolist(), strict=True)),
    )
    made = Simulation(settings.arm, settings.seed, settings.camera)
    fit = replace(fit, calibration=replace(fit.calibration, simulation=made))
    actual = RigidTransform.concatenate(recording.actual)
    truth = Truth(rig.camera, rig.geometry.T_flange_camera, placed.T_world_object.inv() * actual)
    return fit, truth, recording


def _from_photographs(
    settings: CalibrateSettings, board: Board, images: Path, poses: Path, console: Console
) -> tuple[CalibrationFit, list[np.ndarray]]:
    _, photographs, T_base_flange = read_photographs(images, poses)
    height, width = photographs[0].shape[:2]
    corners = _corners(photographs, None, board, console)
    errors = get_arm(settings.arm)
    position, rotation = max(errors.position, 1e-5), max(errors.rotation, 1e-5)
    flange = fixed_poses(T_base_flange, position, rotation)
    return fit_calibration(board, corners, flange, (width, height), scale_view_errors=True), photographs


def _corners(
    images: Sequence[np.ndarray], camera: Camera | None, board: Board, console: Console
) -> list[Corners]:
    return [
        find_corners(image, camera, board)
        for image in track(images, "corners", console=console, transient=True)
    ]


def _keep(folder: Path, recording: Recording) -> None:
    """The frames, and the flange poses that the robot believes, as photographs come."""
    names = [f"{i:03d}.png" for i in range(len(recording.views))]
    with output_folder(folder) as made:
        for name, view in zip(names, recording.views, strict=True):
            cv2.imwrite(str(made / name), view.image)
        write_poses(made / "poses.csv", names, NOMINAL.flange_poses(recording.readings))


def calibration_errors(fit: CalibrationFit, truth: Truth) -> dict[str, float]:
    """Errors against truth. coverage_95: share of all numbers (intrinsics, hand-eye transform, poses of the views) that lie
    within 1.96 standard deviations of the truth."""
    found = fit.calibration
    mounting = pose_log(found.T_flange_camera.inv() * truth.T_flange_camera)
    poses = pose_log(fit.T_board_camera.inv() * truth.T_board_camera)
    lens = np.subtract(intrinsics(truth.camera), intrinsics(found.camera))
    sigma = found.sigma
    used = ~fit.blunders
    pose_sigma = np.sqrt(np.diagonal(fit.pose_covariance[used], axis1=1, axis2=2))
    scaled = np.concatenate(
        [
            lens / [sigma[name] for name in INTRINSICS],
            mounting / [sigma[name] for name in HAND_EYE],
            (poses[used] / pose_sigma).ravel(),
        ]
    )
    return {
        "hand_eye_translation_error_m": float(np.linalg.norm(mounting[:3])),
        "hand_eye_rotation_error_rad": float(np.linalg.norm(mounting[3:])),
        "focal_error_fraction": float(np.max(np.abs(lens[:2]) / [truth.camera.fx, truth.camera.fy])),
        "coverage_95": float(np.mean(np.abs(scaled) < 1.96)),
        "coverage_95_intrinsics_and_hand_eye": float(np.mean(np.abs(scaled[:15]) < 1.96)),
        "pose_translation_rms_m": float(np.sqrt(np.mean(poses[used, :3] ** 2))),
        "pose_rotation_rms_rad": float(np.sqrt(np.mean(poses[used, 3:] ** 2))),
    }


def _table(fit: CalibrationFit) -> Table:
    found = fit.calibration
    sigma = found.sigma
    table = Table(title=f"calibration from {found.views} views", box=SIMPLE)
    for name in ("", "value", "sigma"):
        table.add_column(name, justify="left" if not name else "right", no_wrap=True)
    for name, value in zip(INTRINSICS, intrinsics(found.camera), strict=True):
        digits = 3 if name in INTRINSICS[:4] else 5
        unit = " [px]" if name in INTRINSICS[:4] else ""
        table.add_row(name + unit, f"{value:.{digits}f}", f"{sigma[name]:.{digits}f}")
    turn = found.T_flange_camera.rotation.as_rotvec()
    for k, name in enumerate(HAND_EYE):
        value = found.T_flange_camera.translation[k] if k < 3 else turn[k - 3]
        table.add_row(
            f"{name.replace('_', ' ', 1)} [{'mm' if k < 3 else 'mrad'}]",
            f"{1e3 * value:.3f}",
            f"{1e3 * sigma[name]:.3f}",
        )
    return table


def _summary(fit: CalibrationFit, errors: dict[str, float] | None) -> str:
    found, left_out = fit.calibration, int(fit.blunders.sum())
    text = f"corners: {found.rms:.3f} px rms"
    if left_out:
        text += f"; {left_out} of {len(fit.blunders)} views left out: robot or board off by more than can be"
    if errors:
        text += (
            f"; against truth: hand-eye {1e3 * errors['hand_eye_translation_error_m']:.3f} mm, "
            f"{1e3 * errors['hand_eye_rotation_error_rad']:.3f} mrad; focal length {100 * errors['focal_error_fraction']:.4f} %; "
            f"{100 * errors['coverage_95']:.1f} % within 1.96 sigma"
        )
    return text
