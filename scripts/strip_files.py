"""A strip's surface as files that other programs read: PLY with sigma, GLB in colours, the grid as NPZ."""

from pathlib import Path

import matplotlib
import numpy as np
import trimesh

from extremal.estimator.extrapolation import Extrapolation
from extremal.estimator.strip import Strip

TRUSTED = 3e-3  # [m] sigma up to which the continuation is written
COLOUR_RANGE = (1e-5, TRUSTED)  # [m] sigma at the ends of the colour scale, which is logarithmic


def surface_mesh(extrapolation: Extrapolation) -> trimesh.Trimesh:
    """The strip and what is trusted beyond it, coloured by sigma; attributes `sigma` [m] and `seen` of its vertices."""
    faces = extrapolation.faces(extrapolation.trusted(TRUSTED))
    used, faces = np.unique(faces, return_inverse=True)
    sigma = extrapolation.shape_sigma.ravel()[used]
    mesh = trimesh.Trimesh(
        extrapolation.points.reshape(-1, 3)[used],
        faces.reshape(-1, 3),
        vertex_normals=extrapolation.normals.reshape(-1, 3)[used],
        vertex_colors=sigma_colours(sigma),
        process=False,
    )
    mesh.vertex_attributes["sigma"] = sigma.astype(np.float32)
    mesh.vertex_attributes["seen"] = extrapolation.seen.ravel()[used].astype(np.uint8)
    return mesh


def sigma_colours(sigma: np.ndarray) -> np.ndarray:
    """RGBA (n, 4) uint8 of standard deviations (n,) [m], from well to badly known."""
    low, high = np.log(COLOUR_RANGE)
    part = np.clip((np.log(np.maximum(sigma, 1e-9)) - low) / (high - low), 0, 1)
    return np.asarray(matplotlib.colormaps["viridis_r"](part, bytes=True), np.uint8)


def save_surface(extrapolation: Extrapolation, folder: Path) -> None:
    """Write surface.ply and surface.glb [m]."""
    mesh = surface_mesh(extrapolation)
    mesh.export(folder / "surface.ply")
    mesh.export(folder / "surface.glb")


def save_grid(strip: Strip, path: Path) -> None:
    """Write the grid with its covariance, as in `Strip`."""
    names = ("points", "covariance", "normals", "valid", "view", "run", "side")
    np.savez_compressed(path, **{name: getattr(strip, name) for name in names})
