"""`extremal look`: from rendered frames to curvature with its uncertainty, beside the truth."""

import json
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, Literal

import cv2
import numpy as np
import tyro
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from extremal.estimator import Camera, InvalidInput, Shape, estimate_shape
from extremal.scenes import Scene, load_scene
from extremal.scripts.picture import draw
from extremal.scripts.scoring import Scored, score
from extremal.sim import LinearMotion, PoseErrors, Recording, Sensor, record

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
    noise: float = 2.0
    """sensor noise [grey levels]"""
    position_error: float = 0.0
    """standard deviation of each view's believed position [m]"""
    rotation_error: float = 0.0
    """standard deviation of each view's believed orientation [rad]"""
    seed: int = 0
    """of camera steps, noise and pose errors"""
    out: Path = Path("out/look")
    """folder that is written (and replaced)"""

    def resolved(self) -> dict[str, Any]:
        """The settings in full, as in result.json."""
        own = {k: getattr(self, k) for k in ("views", "baseline", "distance")}
        chosen = EXPERIMENTS[self.experiment] | {k: v for k, v in own.items() if v is not None}
        names = ("quality", "noise", "position_error", "rotation_error")
        return chosen | {name: getattr(self, name) for name in names}


@dataclass(frozen=True, eq=False)
class Look:
    """One look at a scene: what was recorded, what was estimated, how it compares, how long it took [s]."""

    recording: Recording
    shape: Shape
    scored: Scored
    timing: dict[str, float]


def look(settings: LookSettings) -> None:
    """Run the whole chain and write result.json, the frames and the labelled picture to `settings.out`."""
    console = Console()
    with _output(settings.out) as folder:
        scene = load_scene(settings.scene)
        with _progress(console) as progress:
            result = take_look(scene, settings, progress)
        _write(folder, settings, result)
    console.print(_table(result))
    console.print(f"wrote {settings.out}/: result.json, look.png and {len(result.recording.views)} frames")


def take_look(scene: Scene, settings: LookSettings, progress: Progress | None = None) -> Look:
    """Record a scene, estimate shape from images and poses alone, and score it."""
    started = time.perf_counter()
    rng = np.random.default_rng(_natural(settings.seed, "--seed"))
    chosen = settings.resolved()
    motion = LinearMotion(views=chosen["views"], baseline=chosen["baseline"], distance=chosen["distance"])
    errors = PoseErrors(position=settings.position_error, rotation=settings.rotation_error)
    render = progress.add_task("rendering", total=chosen["views"]) if progress else None
    vision = progress.add_task("contours", total=chosen["views"]) if progress else None

    def bar(task: Any) -> Any:
        return (lambda done, total: progress.update(task, completed=done, total=total)) if progress else None

    recording = record(
        scene,
        Camera(),
        motion,
        settings.quality,
        Sensor(noise=settings.noise),
        errors,
        rng,
        progress=bar(render),
    )
    rendered = time.perf_counter()
    shape = estimate_shape(recording.views, bar(vision))
    seen = time.perf_counter()
    scored = score(shape, recording, scene)
    timing = {
        "render": recording.render_seconds,
        "vision": seen - rendered,
        "total": time.perf_counter() - started,
    }
    return Look(recording, shape, scored, timing)


def _natural(value: int, name: str) -> int:
    if value < 0:
        raise InvalidInput(f"{name} is {value}; accepted: a whole number from 0")
    return value


@contextmanager
def _output(out: Path) -> Iterator[Path]:
    """A temporary folder beside `out` that takes its place when all went well, and vanishes otherwise."""
    if out.exists() and not (out.is_dir() and (not any(out.iterdir()) or (out / "result.json").exists())):
        raise InvalidInput(
            f"--out {out} exists and is no result of look; accepted: a new folder, or one to replace"
        )
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        folder = Path(tempfile.mkdtemp(prefix=f".{out.name}-", dir=out.parent))
    except OSError as error:
        raise InvalidInput(
            f"--out {out} can't be written: {error.strerror}; accepted: a writable folder"
        ) from None
    try:
        yield folder
        folder.chmod(0o777 & ~_umask())
        if out.exists():
            old = Path(tempfile.mkdtemp(prefix=f".{out.name}-", dir=out.parent))
            os.replace(out, old / out.name)
            os.replace(folder, out)
            shutil.rmtree(old)
        else:
            os.replace(folder, out)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def _progress(console: Console) -> Progress:
    columns = (TextColumn("{task.description:>10}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    return Progress(*columns, console=console, transient=True)


def _write(folder: Path, settings: LookSettings, result: Look) -> None:
    content = {
        "version": version("extremal"),
        "scene": settings.scene,
        "settings": settings.resolved(),
        "seed": settings.seed,
        "timing_s": result.timing,
        "points": result.scored.points,
    }
    (folder / "result.json").write_text(json.dumps(content, indent=1, allow_nan=False) + "\n")
    frames = folder / "frames"
    frames.mkdir()
    for i, view in enumerate(result.recording.views):
        cv2.imwrite(str(frames / f"{i:03d}.png"), view.image)
    chosen = settings.resolved()
    title = (
        f"{settings.scene}: {chosen['views']} views over {chosen['baseline']:g} m at {chosen['distance']:g} m"
    )
    image = result.recording.views[result.shape.reference].image
    draw(image, result.shape.tangents, result.scored, title, folder / "look.png")


def _table(result: Look) -> Table:
    """What was seen: one row an image contour, medians of its points."""
    table = Table(title="what was seen (medians of the points of each contour)")
    for name, justify in (("contour", "left"), ("object", "left"), ("label", "left"), ("truth", "left"), ("points", "right"),
                          ("depth mm", "right"), ("R mm", "right"), ("sigma mm", "right"), ("true R mm", "right")):  # fmt: skip
        table.add_column(name, justify=justify)
    scored = result.scored
    names = scored.column("contour")
    centre = result.recording.views[result.shape.reference].centre
    depth = np.linalg.norm(scored.column("position_m") - centre, axis=1)
    for name in dict.fromkeys(names):
        rows = names == name

        def median(field: str, rows: np.ndarray = rows) -> str:
            values = scored.column(field)[rows]
            return f"{1e3 * np.nanmedian(values):.2f}" if np.isfinite(values).any() else "-"

        most = [_most(scored.column(field)[rows]) for field in ("object", "label", "true_label")]
        numbers = [f"{1e3 * np.median(depth[rows]):.1f}", median("radius_m"), median("sigma_radius_m")]
        table.add_row(str(name), *most, str(rows.sum()), *numbers, median("true_radius_m"))
    known = np.isfinite(scored.column("true_radius_m"))
    error = np.abs(scored.column("radius_m") - scored.column("true_radius_m"))[known]
    inside = error < 1.96 * scored.column("sigma_radius_m")[known]
    if known.any():
        table.caption = (
            f"{known.sum()} points matched with the scene: median |R error| {1e3 * np.median(error):.2f} mm, "
            f"{100 * inside.mean():.1f} % within 1.96 sigma; vision {result.timing['vision']:.2f} s"
        )
    return table


def _most(values: np.ndarray) -> str:
    names, counts = np.unique(values, return_counts=True)
    return str(names[np.argmax(counts)]) or "-"
