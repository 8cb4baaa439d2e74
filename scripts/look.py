"""`extremal look`: from rendered frames to curvature with its uncertainty, beside the truth."""

import json
import time
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, Literal

import cv2
import numpy as np
import tyro
from rich.box import SIMPLE
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from extremal.estimator import InvalidInput, estimate_shape
from extremal.estimator.calibration_file import load_calibration
from extremal.scenes import Scene, load_scene
from extremal.scenes.board import CalibrationBoard
from extremal.scripts.look_report import agreement, look_report
from extremal.scripts.look_result import Look
from extremal.scripts.output import output_folder
from extremal.scripts.picture import draw
from extremal.scripts.poses import Egomotion, known_poses, pose_errors
from extremal.scripts.progress import bar, progress_bars
from extremal.scripts.rerun_recording import require_rerun, write_rerun
from extremal.scripts.scoring import score
from extremal.sim import ArmErrors, Drive, LinearMotion, record
from extremal.sim.arm_errors import ArmName
from extremal.sim.board_place import board_in_view
from extremal.sim.cameras import CameraName
from extremal.sim.rig import Rig

LEAST_SHOWN = 3  # points of a contour that are worth a line of the table
EXPERIMENTS = {
    "metric": {"views": 15, "baseline": 0.4, "distance": 0.6},
    "book": {"views": 3, "baseline": 0.1, "distance": 0.5},
}


@dataclass(frozen=True)
class LookSettings:
    """Look at a scene: a camera on an arm moves along a line; its frames give depth, curvature and labels."""

    scene: str = "vase-and-box"
    """a preset's name, or a TOML file"""
    experiment: Literal["metric", "book"] = "metric"
    """where the next three are not given: metric = 15 views over 0.4 m at 0.6 m; book = 3 views over 0.1 m at 0.5 m"""
    views: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    """number of frames, at least 3"""
    baseline: Annotated[float | None, tyro.conf.arg(metavar="M")] = None
    """length of the camera's path [m]"""
    distance: Annotated[float | None, tyro.conf.arg(metavar="M")] = None
    """from the path's centre to the target [m]"""
    quality: str = "standard"
    """of rendering: preview, standard or metrology"""
    noise: float | None = None
    """read noise [grey levels]; by default the camera's, 2 for the ideal one"""
    estimator: Literal["circle", "parallax", "joint"] | None = None
    """circle: with poses as believed; parallax: relative to references that are found; joint: poses and shape together. By
    default joint where poses are uncertain, else circle"""
    arm: ArmName | None = None
    """how good the arm is: calibrated 0.1 mm / 0.1 mrad, typical 1 mm / 1 mrad, poor 3 mm / 5 mrad; by default ideal, or the
    calibration's"""
    camera: CameraName | None = None
    """lens and sensor: ideal is a pinhole with read noise; by default ideal, or the calibration's"""
    calibration: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """what `extremal calibrate` found; with it the same arm is simulated, or one such as it says where it was a real one"""
    egomotion: Egomotion = "robot"
    """where poses come from: the robot's kinematics, a board in view, or both together"""
    physics: bool = False
    """move the arm by its actuators, wait until it rests, and expose"""
    position_error: float = 0.0
    """standard deviation of each view's believed position, on top of the arm's [m]"""
    rotation_error: float = 0.0
    """standard deviation of each view's believed orientation, on top of the arm's [rad]"""
    seed: int = 0
    """of camera steps, noise and pose errors"""
    rerun: bool = False
    """also write look.rrd, for the Rerun viewer; needs the extra `rerun`"""
    out: Path = Path("out/look")
    """folder that is written; what was there of the same names is replaced"""

    def resolved(self) -> dict[str, Any]:
        """The settings in full, as in result.json."""
        own = {k: getattr(self, k) for k in ("views", "baseline", "distance")}
        chosen = EXPERIMENTS[self.experiment] | {k: v for k, v in own.items() if v is not None}
        names = ("quality", "position_error", "rotation_error", "egomotion", "physics")
        return (
            chosen
            | {name: getattr(self, name) for name in names}
            | {"calibration": str(self.calibration) if self.calibration else None}
        )


def look(settings: LookSettings) -> None:
    """Run the whole chain and write report.html, result.json, the frames and the labelled picture to `settings.out`."""
    console = Console(markup=False)
    if settings.rerun:
        require_rerun()
    with output_folder(settings.out) as folder:
        scene = load_scene(settings.scene)
        with progress_bars(console) as progress:
            result = take_look(scene, settings, progress)
        _write(folder, settings, result)
        table = _table(result)
        look_report(scene, settings.scene, settings.seed, result, table).save(folder / "report.html")
        if settings.rerun:
            write_rerun(folder / "look.rrd", scene, result)
    console.print(table)
    also = " and look.rrd" if settings.rerun else ""
    console.print(
        f"wrote {settings.out}/: report.html, result.json, look.png, {len(result.recording.views)} frames{also}"
    )


def take_look(
    scene: Scene, settings: LookSettings, progress: Progress | None = None, workers: int | None = None
) -> Look:
    """Record a scene, estimate shape from images and poses alone, and score it.

    `workers` processes render; by default as many as pay.
    """
    started = time.perf_counter()
    seed = _natural(settings.seed, "--seed")
    chosen = settings.resolved()
    motion = LinearMotion(views=chosen["views"], baseline=chosen["baseline"], distance=chosen["distance"])
    rig = _rig(settings, seed)
    watched, placed = _with_board(scene, rig, motion) if settings.egomotion != "robot" else (scene, None)

    recording = record(
        watched,
        rig.camera,
        motion,
        settings.quality,
        rig.sensor,
        rig.errors,
        np.random.default_rng(seed),
        workers,
        bar(progress, "rendering", chosen["views"]),
        geometry=rig.geometry,
        believed=rig.believed,
        believed_camera=rig.believed_camera,
        drive=Drive() if settings.physics else None,
    )
    rendered = time.perf_counter()
    views, prior = known_poses(
        settings.egomotion, recording, rig, placed, bar(progress, "board", chosen["views"])
    )
    recording = replace(recording, views=tuple(views))
    estimator = settings.estimator or ("circle" if prior.exact else "joint")
    shape = estimate_shape(views, bar(progress, "contours", chosen["views"]), estimator, prior)
    seen = time.perf_counter()
    scored = score(shape, recording, watched)
    timing = {
        "render": recording.render_seconds,
        "vision": seen - rendered,
        "total": time.perf_counter() - started,
    }
    used = {"arm": rig.arm, "camera": rig.camera_name, "noise": rig.sensor.noise, "estimator": estimator}
    return Look(chosen | used, recording, prior, shape, scored, timing)


def _rig(settings: LookSettings, seed: int) -> Rig:
    """The arm and camera that the settings ask for, with what is believed of them."""
    if settings.calibration is None:
        rig = Rig.individual(settings.arm or "ideal", settings.camera or "ideal", seed)
    else:
        calibration = load_calibration(settings.calibration)
        made = calibration.simulation
        for name, wanted, there in (
            ("--arm", settings.arm, made.arm if made else "real"),
            ("--camera", settings.camera, made.camera if made else "real"),
        ):
            if wanted not in (None, there):
                raise InvalidInput(
                    f"{name} is {wanted}, but {settings.calibration} calibrates {there!r}; accepted: {there}"
                )
        if made:
            rig = Rig.individual(made.arm, made.camera, made.seed).calibrated(calibration)
        else:
            rig = Rig.like(calibration, np.random.default_rng([seed, 1]))
    own = ArmErrors(position=settings.position_error, rotation=settings.rotation_error)
    errors = replace(
        rig.errors,
        position=float(np.hypot(rig.errors.position, own.position)),
        rotation=float(np.hypot(rig.errors.rotation, own.rotation)),
    )
    sensor = rig.sensor if settings.noise is None else replace(rig.sensor, noise=settings.noise)
    return replace(rig, errors=errors, sensor=sensor)


def _with_board(scene: Scene, rig: Rig, motion: LinearMotion) -> tuple[Scene, CalibrationBoard]:
    """The scene with a board that all views show; camera steps don't matter for its place."""
    placed = board_in_view(scene, rig.believed_camera, motion.poses(scene.target, np.random.default_rng(0)))
    return replace(scene, objects=(*scene.objects, placed)), placed


def _natural(value: int, name: str) -> int:
    if value < 0:
        raise InvalidInput(f"{name} is {value}; accepted: a whole number from 0")
    return value


def _write(folder: Path, settings: LookSettings, result: Look) -> None:
    content = {
        "version": version("extremal"),
        "scene": settings.scene,
        "settings": result.settings,
        "seed": settings.seed,
        "timing_s": result.timing,
        "poses": pose_errors(result.recording, result.prior),
        "points": result.scored.points,
    }
    (folder / "result.json").write_text(json.dumps(content, indent=1, allow_nan=False) + "\n")
    frames = folder / "frames"
    frames.mkdir()
    for i, view in enumerate(result.recording.views):
        cv2.imwrite(str(frames / f"{i:03d}.png"), view.image)
    chosen = result.settings
    title = (
        f"{settings.scene}: {chosen['views']} views over {chosen['baseline']:g} m at {chosen['distance']:g} m"
    )
    image = result.recording.views[result.shape.reference].image
    draw(image, result.shape.tangents, result.scored, title, folder / "look.png")


def _table(result: Look) -> Table:
    """What was seen: a row for each side of each image contour, medians of its points."""
    table = Table(title="what was seen: medians over the points of each contour [mm]", box=SIMPLE)
    for name in ("contour", "object", "label", "truth"):
        table.add_column(name, no_wrap=True)
    for name in ("points", "depth", "|R|", "sigma", "true |R|"):
        table.add_column(name, justify="right", no_wrap=True)
    scored = result.scored
    names = np.array([p["contour"].removeprefix("contour-") for p in scored.points])
    groups = np.array(
        [f"{n} {p['label']} {p['side']} {p['true_label']}" for n, p in zip(names, scored.points, strict=True)]
    )
    centre = result.recording.views[result.shape.reference].centre
    depth = np.linalg.norm(scored.column("position_m") - centre, axis=1)
    columns = [depth, *(np.abs(scored.column(f)) for f in ("radius_m", "sigma_radius_m", "true_radius_m"))]
    for group in dict.fromkeys(groups):
        rows = groups == group
        if rows.sum() < LEAST_SHOWN:
            continue
        first = scored.points[int(np.argmax(rows))]
        words = [str(first[k] or "-") for k in ("object", "label", "true_label")]
        medians = [1e3 * np.median(c[rows]) for c in columns]
        numbers = [f"{m:.{1 if k == 0 else 2}f}" if np.isfinite(m) else "-" for k, m in enumerate(medians)]
        table.add_row(str(names[rows][0]), *words, str(rows.sum()), *numbers)
    table.caption = _summary(result)
    return table


def _summary(result: Look) -> str:
    median, inside, known = agreement(result.scored)
    if not known:
        return "no point matches the scene"
    shown = f"{1e3 * median:.2f} mm" if np.isfinite(median) else "-"
    speed = len(result.recording.views) / result.timing["vision"]
    return (
        f"extremal boundaries: median |R error| {shown}; {100 * inside:.1f} % of all {known} points within "
        f"1.96 sigma; vision at {speed:.0f} frames/s"
    )
