"""A whole object's surface as files that other programs read: PLY with sigma, GLB in colours, STL."""

from pathlib import Path

import matplotlib
import numpy as np
import trimesh
from numpy.typing import NDArray

from extremal.estimator.whole import WholeSurface

UNSEEN = (150, 150, 150, 255)  # RGBA where nothing was seen


def surface_mesh(surface: WholeSurface) -> trimesh.Trimesh:
    """The surface coloured by sigma, grey where it merely closes; attributes `sigma` [m] and `observed` of its vertices."""
    mesh = trimesh.Trimesh(
        surface.mesh.vertices,
        surface.mesh.faces,
        vertex_normals=surface.mesh.normals,
        vertex_colors=_colours(surface.sigma),
        process=False,
    )
    mesh.vertex_attributes["sigma"] = surface.sigma.astype(np.float32)
    mesh.vertex_attributes["observed"] = surface.observed.astype(np.uint8)
    return mesh


def save_surface(surface: WholeSurface, folder: Path) -> None:
    """Write surface.ply, surface.glb and surface.stl [m]."""
    mesh = surface_mesh(surface)
    for kind in ("ply", "glb", "stl"):
        mesh.export(folder / f"surface.{kind}")


def _colours(sigma: NDArray[np.floating]) -> NDArray[np.uint8]:
    """RGBA (n, 4) of standard deviations (n,), violet to yellow from the best known to the 95th percentile."""
    known = np.isfinite(sigma)
    top = float(np.percentile(sigma[known], 95)) if known.any() else 1.0
    colours = matplotlib.colormaps["viridis"](np.clip(sigma / max(top, 1e-12), 0, 1), bytes=True)
    return np.where(known[:, None], colours, np.array(UNSEEN)).astype(np.uint8)
