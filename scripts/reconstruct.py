"""`extremal reconstruct`: a whole object from contours seen from all around, beside a visual hull and stereo."""

import json
import time
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
import tyro
from rich.box import SIMPLE
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from extremal.estimator import Camera, InvalidInput, View
from extremal.estimator.closed_mesh import ClosedMesh
from extremal.estimator.hull import carve
from extremal.estimator.level_surface import level_surface
from extremal.estimator.whole import WholeSurface
from extremal.estimator.whole import reconstruct as surface_from_views
from extremal.scenes import Scene, load_scene
from extremal.scripts.output import output_folder
from extremal.scripts.progress import bar, progress_bars
from extremal.scripts.reconstruct_figures import draw_distances, draw_frames
from extremal.scripts.reconstruct_files import save_surface, surface_mesh
from extremal.scripts.reconstruct_score import Distances, Judge
from extremal.scripts.stereo import stereo_points
from extremal.scripts.surface_report import surface_report
from extremal.sim.around import CircularMotion, record_around
from extremal.sim.sensor import Sensor

PACKAGES = ("extremal", "mujoco", "numpy", "scipy", "opencv-python-headless", "trimesh")
METHODS = {"contours": "contours", "visual_hull": "visual hull", "stereo": "stereo (SGBM)"}


PICTURES = {
    "contours.png": "Outlines in frames, and the contour generators of the recovered surface as they are seen there.",
    "distances.png": "Distance to the truth by method, from the side: red outside, blue inside.",
}


@dataclass(frozen=True)
class ReconstructSettings:
    """Recover a whole object: the camera goes around it, alone before a plain background, and its apparent contours give one
    closed surface; the same frames go through voxel carving and stereo."""

    scene: str = "waisted-vase"
    """a preset's name, or a TOML file; of several objects the one nearest to the scene's target is taken"""
    views: Annotated[int, tyro.conf.arg(metavar="N")] = 36
    """number of frames around the object"""
    distance: Annotated[float, tyro.conf.arg(metavar="M")] = 0.6
    """from the camera to the object's middle [m]"""
    elevation: Annotated[float, tyro.conf.arg(metavar="DEG")] = 12.0
    """of the camera above the object's middle [degrees]"""
    resolution: int = 128
    """vertices along the object's longest side; the visual hull's voxels are as large"""
    quality: str = "standard"
    """of rendering: preview, standard or metrology"""
    noise: float = 2.0
    """read noise [grey levels]"""
    seed: int = 0
    """of camera steps and noise"""
    out: Path = Path("out/reconstruct")
    """folder that is written; what was there of the same names is replaced"""


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """A whole object and all it came from.

    Attributes:
        scene: the object alone.
        views: the frames, with their poses, in order around it.
        surface: recovered; its `outlines` are the contours that made it.
        hull: the visual hull by voxel carving. stereo: (n, 3) points [m].
        distances: by method (`METHODS`), to the truth.
        timing: by stage [s].
    """

    scene: Scene
    views: tuple[View, ...]
    surface: WholeSurface
    hull: ClosedMesh
    stereo: np.ndarray
    distances: dict[str, Distances]
    timing: dict[str, float]

    def content(self) -> dict[str, Any]:
        """The results of result.json."""
        scores = {name: self.distances[name].summary() for name in METHODS}
        return scores["contours"] | {
            "visual_hull": scores["visual_hull"],
            "stereo": scores["stereo"],
            "residual_px": self.surface.residual_px if np.isfinite(self.surface.residual_px) else None,
            "vertices": len(self.surface.sigma),
            "resolution_m": self.surface.grid.spacing,
            "timing_s": self.timing,
        }


def reconstruct(settings: ReconstructSettings) -> None:
    """Run the whole chain and write report.html, surface.ply, .glb and .stl, figures, frames and result.json to `settings.out`."""
    console = Console(markup=False)
    with output_folder(settings.out) as folder:
        scene = alone(load_scene(settings.scene))
        with progress_bars(console) as progress:
            result = take_around(scene, settings, progress)
        _write(folder, settings, result)
    console.print(table(result))
    console.print(
        f"wrote {settings.out}/: report.html, surface.ply, .glb, .stl, result.json, two figures and the frames"
    )


def alone(scene: Scene) -> Scene:
    """The object nearest to a scene's target without all others, in the middle of what the camera sees."""
    distance = [abs(float(s.signed_distance(np.array([scene.target]))[0])) for s in scene.objects]
    chosen = scene.objects[int(np.argmin(distance))]
    x, y, z = (float(c) for c in chosen.bounding_sphere[0])
    return replace(scene, objects=(chosen,), target=(x, y, z))


def take_around(
    scene: Scene, settings: ReconstructSettings, progress: Progress | None = None, workers: int | None = None
) -> Reconstruction:
    """Record one object from all around, recover it by three methods, and score them.

    `workers` processes render; by default as many as pay.
    """
    if settings.seed < 0:
        raise InvalidInput(f"--seed is {settings.seed}; accepted: a whole number from 0")
    if not 16 <= settings.resolution <= 512:
        raise InvalidInput(f"--resolution is {settings.resolution}; accepted: a whole number from 16 to 512")
    rng, judge_rng = np.random.default_rng(settings.seed).spawn(2)
    motion = CircularMotion(settings.views, settings.distance, float(np.radians(settings.elevation)))
    clock = _Clock()
    views = record_around(
        scene, Camera(), motion, settings.quality, Sensor(noise=settings.noise), rng, workers, bar(progress, "rendering")
    )  # fmt: skip
    clock.stop("render")
    surface = surface_from_views(views, bar(progress, "contours"), settings.resolution)
    clock.stop("vision")
    inside = carve(views, [outline.mask for outline in surface.outlines], surface.grid)
    vertices, faces = level_surface(np.where(inside, -1.0, 1.0))
    hull = ClosedMesh(surface.grid.world(vertices), faces)
    clock.stop("visual_hull")
    low, high = surface.grid.world(np.zeros(3)), surface.grid.world(np.array(surface.grid.shape) - 1.0)
    cloud = stereo_points(surface.outlines, low, high, bar(progress, "stereo"))
    clock.stop("stereo")
    judge = Judge(scene, surface, judge_rng)
    distances = {
        "contours": judge.of_mesh(surface.mesh),
        "visual_hull": judge.of_mesh(hull),
        "stereo": judge.of_points(cloud),
    }
    clock.stop("scores")
    return Reconstruction(scene, views, surface, hull, cloud, distances, clock.seconds)


class _Clock:
    """Seconds that stages took."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last = time.perf_counter()

    def stop(self, stage: str) -> None:
        now = time.perf_counter()
        self.seconds[stage], self._last = now - self._last, now


def _write(folder: Path, settings: ReconstructSettings, result: Reconstruction) -> None:
    save_surface(result.surface, folder)
    draw_frames(result.surface, folder / "contours.png")
    draw_distances({METHODS[k]: d for k, d in result.distances.items()}, folder / "distances.png")
    frames = folder / "frames"
    frames.mkdir()
    for i, view in enumerate(result.views):
        cv2.imwrite(str(frames / f"{i:03d}.png"), view.image)
    chosen = {k: v for k, v in asdict(settings).items() if k not in ("scene", "seed", "out")}
    content = {
        "version": version("extremal"),
        "scene": settings.scene,
        "settings": chosen,
        "seed": settings.seed,
    }
    content |= {"versions": {name: version(name) for name in PACKAGES}} | result.content()
    (folder / "result.json").write_text(json.dumps(content, indent=1, allow_nan=False) + "\n")
    hull = content["visual_hull"]["rms_m"]
    facts = {} if hull is None else {"visual hull, rms": f"{1e3 * hull:.3f} mm"}
    facts["of the surface seen"] = f"{100 * content['completeness']:.0f} %"
    mesh, made = surface_mesh(result.surface), table(result)
    surface_report(
        "reconstruct",
        folder,
        result.scene,
        result.views,
        mesh,
        facts,
        PICTURES,
        made,
        content,
        asdict(settings),
    ).save(folder / "report.html")


def table(result: Reconstruction) -> Table:
    """The methods beside each other."""
    made = Table(
        title=f"{result.scene.objects[0].name}: distance to the truth where contours swept", box=SIMPLE
    )
    made.add_column("method", no_wrap=True)
    for name in ("rms [mm]", "95 % [mm]", "complete [%]", "time [s]"):
        made.add_column(name, justify="right", no_wrap=True)
    seconds = {"contours": "vision", "visual_hull": "visual_hull", "stereo": "stereo"}
    for key, name in METHODS.items():
        score = result.distances[key].summary()
        lengths = [f"{1e3 * score[k]:.3f}" if score[k] is not None else "-" for k in ("rms_m", "p95_m")]
        made.add_row(
            name, *lengths, f"{100 * score['completeness']:.1f}", f"{result.timing[seconds[key]]:.1f}"
        )
    made.caption = (
        f"{len(result.views)} views, {len(result.surface.sigma)} vertices {1e3 * result.surface.grid.spacing:.2f} mm apart; "
        f"apparent contours of the surface and of the images differ by {result.surface.residual_px:.3f} px rms"
    )
    return made
