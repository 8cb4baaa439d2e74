"""`extremal strip`: the surface near extremal boundaries, what lies beyond it, and a look at views it was not made of."""

import json
import time
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from rich.box import SIMPLE
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from extremal.estimator import InvalidInput, PosePrior, View, all_contours
from extremal.estimator.contours import Contours
from extremal.estimator.extrapolation import Extrapolation, extrapolate
from extremal.estimator.strip import Strip, recover_strip
from extremal.estimator.strip_prediction import Prediction, predict
from extremal.scenes import Scene, load_scene
from extremal.scripts.output import output_folder
from extremal.scripts.poses import known_poses
from extremal.scripts.progress import bar, progress_bars
from extremal.scripts.report import Report
from extremal.scripts.strip_files import save_grid, save_surface, surface_mesh
from extremal.scripts.strip_motion import UNSEEN, WithUnseen
from extremal.scripts.strip_pictures import draw_extrapolation, draw_prediction, draw_strip
from extremal.scripts.strip_score import StripScore, score_strip
from extremal.scripts.surface_report import surface_report
from extremal.sim import LinearMotion, Recording, record
from extremal.sim.arm_errors import ArmName
from extremal.sim.rig import Rig

PACKAGES = ("extremal", "mujoco", "numpy", "scipy", "opencv-python-headless", "trimesh")


PICTURES = {
    "strip.png": "The conjugate grid over the first view, and its vertices' distances to the truth beside their sigma.",
    "prediction.png": "The strip in views that it was not made of, and the edges there against the prediction.",
    "extrapolation.png": "The surface continued beyond the strip, as far as its own sigma lets it be trusted.",
}


@dataclass(frozen=True)
class StripSettings:
    """Recover the strip of surface that extremal boundaries sweep while a camera moves along a line, continue it, and compare
    it with two views that it was not made of."""

    scene: str = "vase-and-box"
    """a preset's name, or a TOML file"""
    views: Annotated[int, tyro.conf.arg(metavar="N")] = 15
    """number of frames that make the strip, at least 3"""
    baseline: Annotated[float, tyro.conf.arg(metavar="M")] = 0.4
    """length of the camera's path [m]"""
    distance: Annotated[float, tyro.conf.arg(metavar="M")] = 0.6
    """from the path's centre to the target [m]"""
    quality: str = "standard"
    """of rendering: preview, standard or metrology"""
    noise: float | None = None
    """read noise [grey levels]; by default the camera's, 2"""
    arm: ArmName = "ideal"
    """how good the arm is: ideal poses are exact; calibrated 0.1 mm / 0.1 mrad, typical 1 mm / 1 mrad, poor 3 mm / 5 mrad"""
    seed: int = 0
    """of camera steps, noise and pose errors"""
    out: Path = Path("out/strip")
    """folder that is written; what was there of the same names is replaced"""


@dataclass(frozen=True, eq=False)
class StripResult:
    """A strip and all it came from.

    Attributes:
        recording: the frames, those of the unseen views (`UNSEEN`) last.
        views: those that made the strip, with the poses that the estimate used; unseen: the others.
        contours: of all views, as recorded.
        strip, extrapolation: the surface. predictions: one for each unseen view.
        scores: against the truth.
        timing: [s].
    """

    recording: Recording
    views: list[View]
    unseen: list[View]
    contours: list[Contours]
    strip: Strip
    extrapolation: Extrapolation
    predictions: list[Prediction]
    scores: StripScore
    timing: dict[str, float]


def strip(settings: StripSettings) -> None:
    """Recover, compare, and write surface, pictures and result.json to `settings.out`."""
    console = Console(markup=False)
    with output_folder(settings.out) as folder:
        scene = load_scene(settings.scene)
        with progress_bars(console) as progress:
            result = take_strip(scene, settings, progress)
        content = _content(settings, result)
        _write(folder, settings, result, content)
        table = _table(result, content)
        _report(folder, scene, settings, result, table, content).save(folder / "report.html")
    console.print(table)
    console.print(
        f"wrote {settings.out}/: report.html, surface.ply, surface.glb, strip.npz, result.json and three pictures"
    )


def take_strip(
    scene: Scene, settings: StripSettings, progress: Progress | None = None, workers: int | None = None
) -> StripResult:
    """Record a scene, recover the strip from images and poses alone, and score it; `workers` processes render."""
    started = time.perf_counter()
    if settings.seed < 0:
        raise InvalidInput(f"--seed is {settings.seed}; accepted: a whole number from 0")
    motion = WithUnseen(LinearMotion(settings.views, settings.baseline, settings.distance))
    rig = Rig.individual(settings.arm, "ideal", settings.seed)
    if settings.noise is not None:
        rig = replace(rig, sensor=replace(rig.sensor, noise=settings.noise))
    count = settings.views + len(UNSEEN)

    recording = record(
        scene,
        rig.camera,
        motion,
        settings.quality,
        rig.sensor,
        rig.errors,
        np.random.default_rng(settings.seed),
        workers,
        bar(progress, "rendering", count),
        geometry=rig.geometry,
        believed=rig.believed,
        believed_camera=rig.believed_camera,
    )
    rendered = time.perf_counter()
    believed, prior = known_poses("robot", recording, rig, None)
    contours = all_contours(believed, bar(progress, "contours", count))
    used, unseen = believed[: settings.views], believed[settings.views :]
    views, found = recover_strip(used, contours[: settings.views], _of_first(prior, settings.views))
    recovered = time.perf_counter()
    beyond = extrapolate(found)
    predictions = [predict(found, v, c) for v, c in zip(unseen, contours[settings.views :], strict=True)]
    ended = time.perf_counter()
    timing = {
        "render": recording.render_seconds,
        "strip": recovered - rendered,
        "prediction": ended - recovered,
        "total": ended - started,
    }
    scores = score_strip(scene, found, beyond)
    return StripResult(recording, views, unseen, contours, found, beyond, predictions, scores, timing)


def _of_first(prior: PosePrior, views: int) -> PosePrior:
    return replace(
        prior,
        T_world_camera=prior.T_world_camera[:views],
        root=prior.root[:views],
        common=prior.common[:views],
    )


def _content(settings: StripSettings, result: StripResult) -> dict[str, Any]:
    """What result.json holds."""
    names = ("views", "baseline", "distance", "quality", "noise", "arm")
    offsets = np.concatenate([p.offset[p.found] for p in result.predictions])
    return {
        "version": version("extremal"),
        "versions": {name: version(name) for name in PACKAGES},
        "scene": settings.scene,
        "settings": {name: getattr(settings, name) for name in names},
        "seed": settings.seed,
        "timing_s": result.timing,
        **result.scores.whole.numbers(),
        "arcs": len(result.strip.run),
        "strips": [part.numbers() | {"object": name} for name, part in result.scores.strips],
        "prediction_rms_px": float(np.sqrt(np.mean(offsets**2))) if len(offsets) else None,
        "prediction": [_prediction(name, p) for name, p in zip(UNSEEN, result.predictions, strict=True)],
        "extrapolation": [
            part.numbers() | {"trusted_to_m": level} for level, part in result.scores.extrapolated
        ],
    }


def _prediction(name: str, prediction: Prediction) -> dict[str, Any]:
    found = prediction.found
    offset, sigma = prediction.offset[found], prediction.sigma[found]
    return {
        "view": name,
        "points": int(prediction.valid.sum()),
        "found": int(found.sum()),
        "rms_px": prediction.rms if found.any() else None,
        "p95_px": float(np.percentile(np.abs(offset), 95)) if found.any() else None,
        "sigma_px": float(np.median(sigma)) if found.any() else None,
    }


def _write(folder: Path, settings: StripSettings, result: StripResult, content: dict[str, Any]) -> None:
    (folder / "result.json").write_text(json.dumps(content, indent=1, allow_nan=False) + "\n")
    save_surface(result.extrapolation, folder)
    save_grid(result.strip, folder / "strip.npz")
    title = (
        f"{settings.scene}: {settings.views} views over {settings.baseline:g} m at {settings.distance:g} m"
    )
    draw_strip(result.views[0], result.strip, result.scores.distance, title, folder / "strip.png")
    draw_prediction(result.unseen, result.strip, result.predictions, UNSEEN, folder / "prediction.png")
    draw_extrapolation(result.extrapolation, result.scores.beyond, folder / "extrapolation.png")


def _report(
    folder: Path,
    scene: Scene,
    settings: StripSettings,
    result: StripResult,
    table: Table,
    content: dict[str, Any],
) -> Report:
    unseen = content["prediction_rms_px"]
    facts = {} if unseen is None else {"unseen views, rms": f"{unseen:.3f} px"}
    mesh = surface_mesh(result.extrapolation)
    return surface_report(
        "strip", folder, scene, result.views, mesh, facts, PICTURES, table, content, asdict(settings)
    )


def _table(result: StripResult, content: dict[str, Any]) -> Table:
    table = Table(title="distance to the true surface [mm]", box=SIMPLE)
    for name in ("what", "vertices", "rms", "95 %", "sigma", "within 2 sigma"):
        table.add_column(name, justify="left" if name == "what" else "right", no_wrap=True)
    rows = [(f"strip on {s['object']}", s) for s in content["strips"]]
    rows += [(f"beyond, trusted to {1e3 * e['trusted_to_m']:g} mm", e) for e in content["extrapolation"]]
    for name, part in rows:
        if part["vertices"]:
            lengths = [f"{1e3 * part[key]:.3f}" for key in ("rms_m", "p95_m", "sigma_m")]
            table.add_row(name, str(part["vertices"]), *lengths, f"{100 * part['coverage_2sigma']:.1f} %")
    told = [
        f"{p['view']}: {p['rms_px']:.3f} px rms ({p['found']} of {p['points']} points)"
        for p in content["prediction"]
        if p["found"]
    ]
    table.caption = "prediction in unseen views: " + ("; ".join(told) or "no edge found")
    return table
