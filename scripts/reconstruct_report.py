"""The report of `extremal reconstruct`."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rich.table import Table
from scipy.spatial.transform import RigidTransform

from extremal.estimator import View
from extremal.estimator.whole import WholeSurface
from extremal.scenes import Scene
from extremal.scripts.reconstruct_files import surface_mesh
from extremal.scripts.report import Report
from extremal.scripts.surface_report import surface_view

PICTURES = {
    "contours.png": "Outlines in frames, and the contour generators of the recovered surface as they are seen there.",
    "distances.png": "Distance to the truth by method, from the side: red outside, blue inside.",
}


def reconstruct_report(
    folder: Path,
    scene: Scene,
    views: tuple[View, ...],
    surface: WholeSurface,
    table: Table,
    content: Mapping[str, Any],
    settings: Mapping[str, Any],
) -> Report:
    """The surface in 3D, the pictures of the `folder`, and the command's table; `content` is that of result.json."""
    facts = {
        name: f"{1e3 * content[key]:.3f} mm"
        for name, key in (("rms to truth", "rms_m"), ("95 %", "p95_m"))
        if content[key] is not None
    }
    hull = content["visual_hull"]["rms_m"]
    if hull is not None:
        facts["visual hull, rms"] = f"{1e3 * hull:.3f} mm"
    facts["of the surface seen"] = f"{100 * content['completeness']:.0f} %"
    report = Report(
        f"extremal reconstruct: {settings['scene']}", f"{settings['views']} views, seed {settings['seed']}"
    )
    poses = RigidTransform.concatenate([view.T_world_camera for view in views])
    images = [np.asarray(view.image, np.uint8) for view in views]
    report.facts(facts).scene(
        *surface_view(scene, views[0].camera, poses, images, surface_mesh(surface), surface.sigma)
    )
    for name, words in PICTURES.items():
        stored = cv2.imread(str(folder / name))
        if stored is not None:
            report.picture(cv2.cvtColor(stored, cv2.COLOR_BGR2RGB).astype(np.uint8), words)
    return (
        report.table(table).section("How it was made").settings({**settings, "timing_s": content["timing_s"]})
    )
