"""`extremal doctor`: whether offscreen rendering works here, how exactly, how fast."""

import platform
import time
from dataclasses import dataclass
from importlib import metadata

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.spatial.transform import RigidTransform

from extremal.estimator import Camera
from extremal.estimator.errors import RenderingError
from extremal.scenes import Appearance, Background, Scene, Sphere, load_scene
from extremal.sim import FrameRenderer, fixating, scene_model
from extremal.sim.gl import Backend, select_backend

PACKAGES = ("extremal", "mujoco", "numpy", "scipy", "opencv-python-headless")
SPHERE = Sphere(name="sphere", radius=0.1, appearance=Appearance(rgba=(0.0, 0.0, 0.0, 1.0)))
CENTRE = np.array([0.11, -0.07, 0.8])  # of the sphere, in the camera's frame [m]
TOLERANCE = 0.005  # [px] between the rendered silhouette and the exact one
SPEED_SCENE = "vase-and-box"
SPEED_SECONDS = 1.0


@dataclass(frozen=True)
class DoctorSettings:
    """Check this machine: versions, offscreen OpenGL, a rendered silhouette against the exact one, speed."""


@dataclass(frozen=True)
class Silhouette:
    """How far a rendered silhouette is from the exact one [px]: outwards on average, and its centroid's shift (2,)."""

    outwards: float
    shift: np.ndarray

    @property
    def good(self) -> bool:
        return bool(max(abs(self.outwards), *np.abs(self.shift)) < TOLERANCE)


def doctor(settings: DoctorSettings) -> None:
    """Print one screen; RenderingError with the remedy when something is not well."""
    console = Console()
    table = Table(title="extremal doctor", show_header=False)
    table.add_row("python", f"{platform.python_version()}, {platform.platform()}")
    for package in PACKAGES:
        table.add_row(package, metadata.version(package))
    try:
        _examine_rendering(table)
    finally:
        console.print(table)
    console.print("all is well")


def _examine_rendering(table: Table) -> None:
    try:
        backend = select_backend()
    except RenderingError:
        table.add_row("offscreen OpenGL", "does not work")
        raise
    table.add_row("offscreen OpenGL", f"{backend.name}: {backend.renderer}")
    table.add_row("tried in vain", _failures(backend))
    silhouette = examine_silhouette()
    shift = ", ".join(f"{value:+.4f}" for value in silhouette.shift)
    table.add_row(
        "silhouette of a backlit sphere",
        f"{silhouette.outwards:+.4f} px outwards of the exact one, shifted by ({shift}) px",
    )
    table.add_row("frames per second", f"{frame_rate():.0f} of {SPEED_SCENE} at 640 x 480 in preview quality")
    if not silhouette.good:
        raise RenderingError(
            f"{backend.name} ({backend.renderer}) draws silhouettes wrong by more than {TOLERANCE} px; "
            f"try MUJOCO_GL={'osmesa' if backend.name == 'egl' else 'egl'}"
        )


def _failures(backend: Backend) -> str:
    return "; ".join(f"{name}: {reason}" for name, reason in backend.failed) or "nothing"


def examine_silhouette() -> Silhouette:
    """Compare area and centroid of the rendered silhouette, which blur conserves, with the exact ellipse."""
    camera = Camera()
    scene = Scene((SPHERE,), lights=(), background=Background((1.0, 1.0, 1.0)))
    pose = RigidTransform.from_translation(-CENTRE)  # the sphere stands in the world's origin
    with FrameRenderer(scene_model(scene.to_spec()), camera, "standard") as renderer:
        darkness = 1 - renderer.render(pose).astype(float) / 255
    area, centre, perimeter = exact_silhouette(camera, CENTRE, SPHERE.radius)
    rows, columns = np.mgrid[: camera.height, : camera.width]
    measured = darkness.sum()
    centroid = np.array([(darkness * columns).sum(), (darkness * rows).sum()]) / measured
    return Silhouette((measured - area) / perimeter, centroid - centre)


def exact_silhouette(camera: Camera, centre: np.ndarray, radius: float) -> tuple[float, np.ndarray, float]:
    """Area [px^2], centre (2,) [px] and perimeter [px] of a sphere's image, an ellipse.

    Rays d on the cone of tangents satisfy d' (|c|^2 - r^2) d - (c.d)^2 = 0.
    """
    to_ray = np.linalg.inv(camera.matrix)
    conic = to_ray.T @ ((centre @ centre - radius**2) * np.eye(3) - np.outer(centre, centre)) @ to_ray
    quadratic, linear = conic[:2, :2], conic[:2, 2]
    middle = -np.linalg.solve(quadratic, linear)
    axes = np.sqrt(-(conic[2, 2] + linear @ middle) / np.linalg.eigvalsh(quadratic))
    angle = np.linspace(0, 2 * np.pi, 1000, endpoint=False)
    perimeter = 2 * np.pi * np.hypot(axes[0] * np.sin(angle), axes[1] * np.cos(angle)).mean()
    return float(np.pi * axes.prod()), middle, float(perimeter)


def frame_rate() -> float:
    """Frames per second of the default scene, by one process in preview quality."""
    scene = load_scene(SPEED_SCENE)
    pose = fixating(np.array([[-0.6, 0.0, scene.target[2]]]), scene.target)[0]
    with FrameRenderer(scene_model(scene.to_spec()), Camera(), "preview") as renderer:
        renderer.render(pose)
        frames, started = 0, time.perf_counter()
        while time.perf_counter() - started < SPEED_SECONDS:
            renderer.render(pose)
            frames += 1
        return frames / (time.perf_counter() - started)
