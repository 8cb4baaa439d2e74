"""Rendered silhouettes against the exact contour: backlit scenes, edges by the integral along normals."""

from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from scipy.spatial.transform import RigidTransform

from extremal.estimator import Camera, View
from extremal.scenes import Scene
from extremal.scenes.scene import Background
from extremal.sim import scene_model

HALF = 4.0  # [px] of the profile along a normal
STEP = 0.125


@dataclass(frozen=True)
class Edges:
    """Contour points (N, 2) [px], outward image normals (N, 2) and measured minus exact offsets (N,) [px]."""

    pixels: NDArray[np.floating]
    normals: NDArray[np.floating]
    offsets: NDArray[np.floating]

    @property
    def shift(self) -> NDArray[np.floating]:
        """Translation (2,) [px] of the image that explains the offsets best, beside a common outward offset."""
        basis = np.column_stack([self.normals, np.ones(len(self.normals))])
        return np.linalg.lstsq(basis, self.offsets, rcond=None)[0][:2]


def backlit(scene: Scene) -> tuple[Scene, mujoco.MjModel]:
    """The scene without its table, black before a white sky; and its model."""
    objects = tuple(o for o in scene.objects if o.name != "table")
    scene = replace(scene, objects=objects, lights=(), background=Background((1.0, 1.0, 1.0)))
    spec = scene.to_spec()
    for material in spec.materials:
        material.rgba, material.specular, material.emission = [0, 0, 0, 1], 0, 0
    return scene, scene_model(spec)


def silhouette_edges(
    scene: Scene, camera: Camera, pose: RigidTransform, frame: NDArray[np.floating]
) -> Edges:
    """Compare a backlit frame with the scene's contour generators, where they stand against the sky.

    The integral of a profile across a black-to-white edge gives its place whatever the (symmetric) blur; a curved edge,
    s = -t^2 / (2 rho), is seen at its mean over the blur.
    """
    view = View(camera, pose, np.zeros((camera.height, camera.width), np.uint8))
    found = []
    for curve in scene.true_edges(pose.translation):
        if curve.kind != "extremal":
            continue
        pixels = view.project(curve.points)
        normals = _image_normals(camera, pose, curve.points, curve.normals)
        bend = _bend(pixels, normals)
        offsets = _offsets(frame, pixels, normals)
        # The first and last points may belong to a corner.
        use = (
            curve.visible & np.isfinite(offsets) & np.isfinite(bend) & _away_from_ends(curve.visible, pixels)
        )
        variance = camera.blur**2 + 1 / 12
        found.append((pixels[use], normals[use], (offsets - bend * variance)[use]))
    return Edges(*(np.concatenate(part) for part in zip(*found, strict=True)))


def _image_normals(
    camera: Camera, pose: RigidTransform, points: NDArray, surface_normals: NDArray
) -> NDArray[np.floating]:
    """Outward unit normals (N, 2) [px] of the contour's image.

    The tangent plane, n.r = 0 in the camera frame, cuts the ideal image plane in a line with the normal n_xy.
    """
    p = (points - pose.translation) @ pose.rotation.as_matrix()
    line = (surface_normals @ pose.rotation.as_matrix())[:, :2]
    along = 1e-5 * np.stack([-line[:, 1], line[:, 0]], axis=1) / np.linalg.norm(line, axis=1, keepdims=True)
    ideal = p[:, :2] / p[:, 2:]
    tangent = camera.distort(ideal + along) - camera.distort(ideal - along)
    normals = np.stack([tangent[:, 1], -tangent[:, 0]], axis=1)
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def _offsets(frame: NDArray, pixels: NDArray, normals: NDArray) -> NDArray:
    """Places of the edge (N,) [px] along the normals, 0 at `pixels`; NaN where the profile is no step 0 to 255."""
    s = np.arange(-HALF + STEP / 2, HALF, STEP)
    at = pixels[:, None] + s[:, None] * normals[:, None]
    inside = np.all((at > 1) & (at < np.array(frame.shape[::-1]) - 2), axis=(1, 2))
    at = np.where(inside[:, None, None], at, 10.0)
    profile = map_coordinates(frame, [at[..., 1], at[..., 0]], order=5, mode="mirror")
    step = (np.abs(profile[:, :8]).max(axis=1) < 0.6) & (np.abs(profile[:, -8:] - 255).max(axis=1) < 0.6)
    return np.where(inside & step, HALF - STEP * profile.sum(axis=1) / 255, np.nan)


def _bend(pixels: NDArray, normals: NDArray) -> NDArray:
    """c (N,) [1/px] of s = c t^2, fitted to the exact contour within 4 px of every point."""
    tangents = np.stack([-normals[:, 1], normals[:, 0]], axis=1)
    bend = np.full(len(pixels), np.nan)
    for i in range(len(pixels)):
        near = pixels[max(i - 400, 0) : i + 400] - pixels[i]
        near = near[np.linalg.norm(near, axis=1) < 4]
        t, s = near @ tangents[i], near @ normals[i]
        if len(t) > 4 and t.min() < -2 and t.max() > 2:
            bend[i] = np.polyfit(t, s, 2)[0]
    return bend


def _away_from_ends(visible: NDArray[np.bool_], pixels: NDArray) -> NDArray[np.bool_]:
    hidden = pixels[~visible]
    if len(hidden) == 0:
        return np.ones(len(pixels), bool)
    gaps = np.linalg.norm(pixels[:, None] - hidden[None, :: max(1, len(hidden) // 300)], axis=2)
    return gaps.min(axis=1) > 8
