"""Errors of edges in rendered frames, as the geometric sensor's `EdgeModel` describes them.

Random vases and boxes, an ellipsoid and a sphere are looked at from irregular steps on a line, with exact poses. In each
frame the exact contacts of tracks are compared with the nearest edgel of like direction, which the vision pipeline has found.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from rich.console import Console

from extremal.estimator import Camera, Contours, find_contours
from extremal.estimator.camera import Array
from extremal.scenes import Scene, load_scene, randomised
from extremal.scripts.progress import bar, progress_bars
from extremal.sim import FrameRenderer, LinearMotion, Sensor, scene_model
from extremal.tasks.contacts import Contacts, EdgeGeometry
from extremal.tasks.edge_choice import choose
from extremal.tasks.edge_model import EdgeModel

MOTION = LinearMotion(views=25, baseline=0.3, distance=0.55)
MATCHED = 2.5  # [px] beyond which an edgel belongs to no true edge
ALIKE = np.cos(np.deg2rad(20.0))
FALSE = 6.0  # robust standard deviations from which another edge was taken
VASES = 20  # that are looked at, unless told otherwise
LEAST_FOUND = 0.5  # of the views: edges that are found less often have too little contrast to be tracked
LONGEST_TURN = 0.2  # [rad] over which a bias is taken to stay the same: a third of the arc that is seen
FARTHEST_LAG = 8  # views between which biases are compared


@dataclass(frozen=True, eq=False)
class EdgeErrors:
    """Errors (n, V) [px] across n edges in V views, NaN where no edge was found or none was there;
    there: (n, V); limb: (n,) whether it is one; turn: [rad] of the line of sight between two views."""

    error: Array
    there: np.ndarray
    limb: np.ndarray
    turn: float


def edge_errors(scene: Scene, quality: str, rng: np.random.Generator) -> EdgeErrors:
    """Errors of edges of one scene along the motion."""
    camera, sensor, geometry = Camera(), Sensor(), EdgeGeometry(scene)
    poses = MOTION.poses(scene.target, rng)
    matrices, middle = poses.as_matrix(), MOTION.views // 2
    travel = matrices[-1, :3, 3] - matrices[0, :3, 3]
    travel /= np.linalg.norm(travel)
    at = matrices[middle]
    contacts, _ = choose(geometry, camera, at[:3, :3], at[:3, 3], travel)
    planes = np.cross(travel, contacts.points - at[:3, 3])
    planes /= np.linalg.norm(planes, axis=1, keepdims=True)
    columns: list[tuple[Array, np.ndarray]] = [(np.zeros(0), np.zeros(0))] * MOTION.views
    with FrameRenderer(scene_model(scene.to_spec()), camera, quality) as renderer:
        for order in (range(middle, -1, -1), range(middle + 1, MOTION.views)):
            moved = contacts
            for view in order:
                moved = geometry.advance(moved, matrices[view, :3, 3], planes)
                image = sensor.read(renderer.render(poses[view]), camera, rng)
                columns[view] = _compared(
                    find_contours(image, camera), camera, geometry, moved, matrices[view]
                )
    error, there = (np.stack(parts, axis=1) for parts in zip(*columns, strict=True))
    turn = 2 * np.arctan(MOTION.baseline / 2 / MOTION.distance) / (MOTION.views - 1)
    return EdgeErrors(error, there.astype(bool), contacts.curve < 0, float(turn))


def _compared(
    contours: Contours, camera: Camera, geometry: EdgeGeometry, contacts: Contacts, pose: Array
) -> tuple[Array, np.ndarray]:
    """Errors (n,) [px] of edgels nearest to contacts, and whether there is an edge."""
    away = contacts.points - pose[:3, 3]
    pixels = camera.project(away @ pose[:3, :3])
    normal = (contacts.normals @ pose[:3, :3])[:, :2] / (camera.fx, camera.fy)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    there = contacts.there & ~geometry.hidden(pose[:3, 3], contacts.points)
    there &= np.all((pixels > 4) & (pixels < (camera.width - 5, camera.height - 5)), axis=1)
    off = contours.positions[None] - pixels[:, None]
    across = np.einsum("nmk,nk->nm", off, normal)
    along = np.einsum("nmk,nk->nm", off, np.stack([-normal[:, 1], normal[:, 0]], axis=1))
    alike = np.abs(normal @ contours.normals.T) > ALIKE
    distance = np.where(alike & (np.abs(along) < 4), np.abs(across) + 0.1 * np.abs(along), np.inf)
    nearest = np.argmin(distance, axis=1)
    rows = np.arange(len(pixels))
    found = there & (distance[rows, nearest] < MATCHED)
    # the contour's tangent carries the edgel's error to the contact
    n, e = contours.normals[nearest], off[rows, nearest]
    error = np.einsum("nk,nk->n", e, n) * np.sign(np.einsum("nk,nk->n", n, normal))
    nan = np.full(len(rows), np.nan)
    return np.where(found, error, nan), there


def fitted(samples: list[EdgeErrors]) -> EdgeModel:
    """The model of a typical track: false edges and dropouts counted, noise and bias from the covariance between views, once each
    track's mean is taken out."""
    products: list[list[Array]] = [[] for _ in range(FARTHEST_LAG + 1)]
    false, missing, seen = [], 0, 0
    for s in samples:
        expected = s.there.sum(axis=1)
        kept = (np.isfinite(s.error).sum(axis=1) >= LEAST_FOUND * expected) & (expected > 0)
        error, there = s.error[kept], s.there[kept]
        missing, seen = missing + int((there & np.isnan(error)).sum()), seen + int(there.sum())
        centred = error - np.nanmedian(error, axis=1, keepdims=True)
        wrong = np.abs(centred) > FALSE * 1.48 * np.nanmedian(np.abs(centred))
        false.append(error[wrong])
        error = np.where(wrong, np.nan, error)
        error = error - np.nanmean(
            error, axis=1, keepdims=True
        )  # what stays the same in all views is no error of R
        for lag in range(FARTHEST_LAG + 1):
            products[lag].append(_mean(error[:, lag:] * error[:, : error.shape[1] - lag]))
    covariance = np.array([np.nanmedian(np.concatenate(p)) for p in products])  # of the tracks
    covariance += covariance[0] / (samples[0].error.shape[1] - 1)  # what taking out the means has taken
    bias, turn = _bias(covariance, samples[0].turn)
    offsets = np.concatenate(false)
    found = max(seen - missing, 1)
    return EdgeModel(
        float(np.sqrt(max(covariance[0] - bias**2, 1e-6))),
        bias,
        turn,
        missing / max(seen, 1),
        len(offsets) / found,
        float(np.sqrt(np.mean(offsets**2))) if len(offsets) else 0.0,
    )


def _mean(values: Array) -> Array:
    """Means (n,) of the finite values of each row; NaN where there are none."""
    known = np.isfinite(values)
    count = known.sum(axis=1)
    return np.where(count > 0, np.where(known, values, 0.0).sum(axis=1) / np.maximum(count, 1), np.nan)


def _bias(covariance: Array, turn: float) -> tuple[float, float]:
    """Standard deviation [px] and correlation angle [rad] of what neighbouring views share, from covariances at lags (L + 1):
    the least-squares b^2 exp(-lag / angle)."""
    lag = turn * np.arange(1, len(covariance))
    best = (np.inf, 0.0, float(turn))
    for angle in np.geomspace(turn, LONGEST_TURN, 30):
        shape = np.exp(-lag / angle)
        square = max(float(shape @ covariance[1:] / (shape @ shape)), 0.0)
        misfit = float(np.sum((square * shape - covariance[1:]) ** 2))
        if misfit < best[0]:
            best = (misfit, float(np.sqrt(square)), float(angle))
    return best[1], best[2]


def sensor_study(
    seeds: int, quality: str = "preview", progress: Callable[[int, int], None] | None = None
) -> EdgeModel:
    """The model fitted to `seeds` random vases with a box, and to the ellipsoid and the sphere."""
    scenes = [randomised(load_scene("vase-and-box"), np.random.default_rng(k)) for k in range(seeds)]
    scenes += [load_scene("ellipsoid"), load_scene("sphere")]
    samples = []
    for i, scene in enumerate(scenes):
        samples.append(edge_errors(scene, quality, np.random.default_rng([11, i])))
        if progress:
            progress(i + 1, len(scenes))
    limbs = fitted([_taken(s, s.limb) for s in samples])
    fixed = fitted([_taken(s, ~s.limb) for s in samples if not s.limb.all()])
    return replace(fitted(samples), sigma_px=limbs.sigma_px, fixed_sigma_px=fixed.sigma_px)


def _taken(errors: EdgeErrors, rows: np.ndarray) -> EdgeErrors:
    return EdgeErrors(errors.error[rows], errors.there[rows], errors.limb[rows], errors.turn)


def main() -> None:
    """Print the model; the number of random vases is the first argument."""
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else VASES
    with progress_bars(Console(stderr=True)) as progress:
        found = sensor_study(seeds, progress=bar(progress, "scenes"))
    print(found)


if __name__ == "__main__":
    main()
