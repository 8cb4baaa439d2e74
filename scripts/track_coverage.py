"""How much of what there is to see was tracked, and how much was tracked that is not there."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from extremal.estimator import Shape, View
from extremal.scenes import Scene, SurfaceCurve
from extremal.sim import Recording

NEAR = 1.0  # [px] from a true edge within which a track is one of it
GAP = 6.0  # [px] along an edge that one tracked point stands for, on each side
LEAST_CONTRAST = 6.0  # [grey levels] across a true edge below which there is nothing to be seen
PARALLEL = 0.08  # sine of the angle to the epipolar line below which an edge shows no motion along it


@dataclass(frozen=True)
class Coverage:
    """Fractions. `complete`: of the visible length of the true apparent contours and creases, seen in every view, that
    lies within reach of a track that lasts the whole sequence; `any`: of any track. `transversal` is `complete`
    without the edges along the epipolar lines, on which no point can be told from the next. `false`: of the tracked
    points that are farther than 1 px from every true edge."""

    complete: float
    any: float
    transversal: float
    false: float


def track_coverage(shape: Shape, recording: Recording, scene: Scene) -> Coverage:
    """Coverage of a look at a scene, in its reference view."""
    views = [
        View(view.camera, pose, view.image)
        for view, pose in zip(recording.views, recording.actual, strict=True)
    ]
    reference = views[shape.reference]
    edges = scene.true_edges(reference.centre)
    pixels, kind, fixed, points, sine = _projected(edges, reference, views[-1].centre - views[0].centre)
    near, _ = KDTree(pixels).query(shape.pixels)
    wanted = (kind != "marking") & _has_contrast(reference, pixels) & _inside(reference, pixels)
    for view in (views[0], views[-1]):  # a contour generator slips, but as a whole it stays in view or not
        wanted &= _inside(view, view.project(points)) & (~fixed | _seen(scene, view, points))

    def share(chosen: np.ndarray, among: np.ndarray) -> float:
        if not chosen.any() or not among.any():
            return 0.0
        distance, _ = KDTree(shape.pixels[chosen]).query(pixels[wanted][among])
        return float(np.mean(distance < GAP))

    everything = np.ones(wanted.sum(), bool)
    return Coverage(
        share(shape.complete, everything),
        share(np.ones(len(shape.pixels), bool), everything),
        share(shape.complete, sine[wanted] > PARALLEL),
        float(np.mean(near > NEAR)),
    )


def _projected(
    edges: list[SurfaceCurve], view: View, travel: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Visible points of the edges every half pixel: pixels, kinds, whether fixed, points, sine to the epipolar line."""
    rows = []
    for edge in edges:
        at = view.project(edge.points)
        ok = edge.visible & np.isfinite(at).all(axis=1)
        ok &= np.isfinite(np.gradient(at, axis=0)).all(axis=1) if len(at) > 1 else False
        if ok.sum() < 2:
            continue
        step = np.linalg.norm(np.gradient(at, axis=0), axis=1)
        keep = np.flatnonzero(ok)[np.unique((np.cumsum(step[ok]) // 0.5).astype(int), return_index=True)[1]]
        tangent = np.gradient(at, axis=0)[keep]
        moved = view.project(edge.points[keep] + 1e-4 * travel) - at[keep]
        across = np.abs(tangent[:, 0] * moved[:, 1] - tangent[:, 1] * moved[:, 0])
        sine = across / np.maximum(np.linalg.norm(tangent, axis=1) * np.linalg.norm(moved, axis=1), 1e-12)
        rows.append((at[keep], np.full(len(keep), edge.kind), edge.points[keep], sine))
    pixels, kind, points, sine = (np.concatenate(column) for column in zip(*rows, strict=True))
    return pixels, kind, kind != "extremal", points, sine


def _inside(view: View, pixels: np.ndarray) -> np.ndarray:
    size = np.array([view.camera.width, view.camera.height])
    with np.errstate(invalid="ignore"):
        return np.all((pixels > 8) & (pixels < size - 9), axis=1)


def _seen(scene: Scene, view: View, points: np.ndarray) -> np.ndarray:
    """Whether fixed points are visible from a view: a true edge of that view passes through them."""
    seen = np.concatenate(
        [e.points[e.visible] for e in scene.true_edges(view.centre) if e.kind != "extremal"]
    )
    distance, _ = KDTree(seen).query(points)
    return distance < 5e-4


def _has_contrast(view: View, pixels: np.ndarray) -> np.ndarray:
    """Whether the image varies around each pixel by more than noise can."""
    image = view.image.astype(float)
    x, y = np.clip(np.rint(pixels).astype(int), 3, np.array(image.shape[::-1]) - 4).T
    steps = np.mgrid[-3:4, -3:4].reshape(2, -1)
    patch = image[y[:, None] + steps[0], x[:, None] + steps[1]]
    quartile = np.percentile(patch, [20, 80], axis=1)
    return quartile[1] - quartile[0] > LEAST_CONTRAST
