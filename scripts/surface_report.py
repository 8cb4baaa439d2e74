"""The report of a surface that was recovered: its 3D view, coloured by sigma and by its distance to the truth, which lies beneath."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import matplotlib
import numpy as np
import trimesh
from numpy.typing import NDArray
from rich.table import Table
from scipy.spatial.transform import RigidTransform

from extremal.estimator import Camera, View
from extremal.estimator.camera import Array
from extremal.scenes import Scene
from extremal.scripts.report import Report
from extremal.scripts.report_mesh import DisplayMesh
from extremal.scripts.report_scene import Scene3D

NEARER = 0.4  # of the cameras' distance from which the view starts
AWAY = 0.01  # [m] farther from all objects than that, a surface is not of the scene and has the last colour


def surface_report(
    command: str,
    folder: Path,
    scene: Scene,
    views: Sequence[View],
    surface: trimesh.Trimesh,
    facts: Mapping[str, str],
    pictures: Mapping[str, str],
    table: Table,
    content: Mapping[str, Any],
    settings: Mapping[str, Any],
) -> Report:
    """The surface in 3D, pictures of the `folder`, and the command's table.

    Args:
        views: that the surface was made from.
        surface: in the world [m], with the attribute `sigma` of its n vertices, along their normals [m].
        facts: besides the distances to the truth. pictures: file names and captions. content: of result.json.
    """
    distances = {
        name: f"{1e3 * content[key]:.3f} mm"
        for name, key in (("rms to truth", "rms_m"), ("95 %", "p95_m"))
        if content[key] is not None
    }
    report = Report(
        f"extremal {command}: {settings['scene']}", f"{settings['views']} views, seed {settings['seed']}"
    )
    poses = RigidTransform.concatenate([view.T_world_camera for view in views])
    images = [np.asarray(view.image, np.uint8) for view in views]
    sigma = np.asarray(surface.vertex_attributes["sigma"], float)
    report.facts({**distances, **facts}).scene(
        *surface_view(scene, views[0].camera, poses, images, surface, sigma)
    )
    for name, words in pictures.items():
        stored = cv2.imread(str(folder / name))
        if stored is not None:
            report.picture(cv2.cvtColor(stored, cv2.COLOR_BGR2RGB).astype(np.uint8), words)
    report.table(table).section("How it was made")
    return report.settings({**settings, "timing_s": content["timing_s"]})


def surface_view(
    scene: Scene,
    camera: Camera,
    T_world_camera: RigidTransform,
    images: Sequence[NDArray[np.uint8]],
    surface: trimesh.Trimesh,
    sigma: Array,
) -> tuple[Scene3D, str]:
    """The view and what to say below it.

    Args:
        T_world_camera, images: (V) views that the surface was made from.
        surface: in the world [m], of n vertices. sigma: (n,) their standard deviations along the normal [m].
    """
    # near enough to see the surface: the cameras may stand all around it
    target = np.asarray(scene.target)
    view = Scene3D.beside(target, target + NEARER * (T_world_camera.translation - target))
    caption = "The camera on its way, and no surface: none was found."
    if len(surface.faces):
        error = true_distance(scene, np.array(surface.vertices))
        seen = np.minimum(np.stack([error, sigma])[:, np.isfinite(error + sigma)], AWAY)
        top = float(f"{max(np.percentile(seen, 95), 1e-6):.1g}") if seen.size else AWAY
        view.mesh("surface/by distance to the truth", DisplayMesh.of(surface, colours_of(error, top)))
        view.mesh("surface/by sigma", DisplayMesh.of(surface, colours_of(sigma, top)), visible=False)
        caption = (
            f"The surface, coloured by its distance to the truth: violet 0, yellow {1e3 * top:g} mm and more. The button at the lower "
            "right opens the tree of parts: the surface by its sigma, in the same colours, and the true objects are hidden at first."
        )
    return view.objects(scene, opacity=0.6, visible=False).cameras(camera, T_world_camera, images), caption


def true_distance(scene: Scene, points: Array) -> Array:
    """Distance (n,) [m] of points (n, 3) from the nearest object's surface."""
    return np.min([np.abs(surface.signed_distance(points)) for surface in scene.objects], axis=0)


def colours_of(values: Array, top: float) -> NDArray[np.uint8]:
    """Colours (n, 3) of values (n,) from 0 (violet) to `top` (yellow)."""
    return np.asarray(matplotlib.colormaps["viridis"](np.clip(values / top, 0, 1), bytes=True), np.uint8)[
        :, :3
    ]
