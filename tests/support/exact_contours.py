"""Contours of objects as exact as their geometry, without images; and strips of them."""

import numpy as np
from scipy.spatial.transform import RigidTransform

from extremal.estimator import Camera, Contours, View
from extremal.estimator.camera import Array
from extremal.estimator.contours import ROWS
from extremal.estimator.splines import arc_length, fit, knots
from extremal.estimator.strip import Strip, recover_strip
from extremal.scenes import Ellipsoid, Lathe, Sphere, Surface
from extremal.sim import LinearMotion

CAMERA = Camera()
TARGET = np.array([0.0, 0.0, 0.06])
VIEWS = 15
SIGMA = 0.01  # [px] of an edgel
KNOTS = 12.0  # [px]
PLACE = RigidTransform.from_translation(TARGET)
OBJECTS: dict[str, Surface] = {
    "sphere": Sphere(radius=0.045, T_world_object=PLACE),
    "ellipsoid": Ellipsoid(a=0.035, b=0.05, c=0.06, T_world_object=PLACE),
    "waisted vase": Lathe(
        profile_z=(0.0, 0.03, 0.06, 0.09, 0.12), profile_r=(0.035, 0.042, 0.034, 0.04, 0.037)
    ),
}


def cameras(views: int = VIEWS, baseline: float = 0.4) -> list[View]:
    poses = LinearMotion(views, baseline, 0.6).poses(TARGET, np.random.default_rng(0))
    return [seen_from(pose) for pose in poses]


def seen_from(pose: RigidTransform) -> View:
    return View(CAMERA, pose, np.zeros((CAMERA.height, CAMERA.width), np.uint8))


def exact_contours(surface: Surface, view: View, rng: np.random.Generator | None = None) -> Contours:
    """The contours of an object before a bright background, their edgels exact, or off by SIGMA."""
    pixels, pieces = [], 0
    numbers = []
    for curve in surface.contour_generator(view.centre):
        runs = np.split(np.arange(len(curve.visible)), np.flatnonzero(np.diff(curve.visible)) + 1)
        for run in (r for r in runs if curve.visible[r[0]] and len(r) > 50):
            piece = _edgels(surface, view, curve.points[run])
            if len(piece) > 8:
                pixels.append(piece)
                numbers.append(np.full(len(piece), pieces))
                pieces += 1
    positions, contour = np.concatenate(pixels), np.concatenate(numbers)
    u, breaks = arc_length(positions, contour)
    t = knots(u, contour, breaks, np.full(len(u), KNOTS), np.bincount(contour) - 3, 1.5 * ROWS)
    measured = positions if rng is None else positions + SIGMA * rng.standard_normal(positions.shape)
    weights = np.full(len(u), 1 / SIGMA)
    found = fit(u, measured, weights, t, breaks)
    at, _, normals, bend = found.splines.frame(u)
    sigma, ones = np.sqrt(found.variance()), np.ones(len(u))
    return Contours(
        found.splines, u, contour, at, normals, bend, sigma, SIGMA * ones, 100 * ones, 0 * ones, 1.0
    )


def _edgels(surface: Surface, view: View, points: Array) -> Array:
    """Exact pixels (n, 2), ROWS apart along the image of a contour generator, the outside to the left."""
    rough = view.project(points)
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(rough, axis=0), axis=1))])
    at = np.arange(0.5 * ROWS, along[-1], ROWS)
    start = np.stack([np.interp(at, along, x) for x in points.T], axis=1)
    across = np.cross(start - view.centre, surface.normals(start))
    exact = surface.contour_points_in_planes(start, view.centre, across)
    pixels = view.project(exact)
    outside = view.project(exact + 1e-5 * surface.normals(exact)) - pixels
    tangent = np.gradient(pixels, axis=0)
    left = np.mean(np.sum(np.stack([tangent[:, 1], -tangent[:, 0]], axis=1) * outside, axis=1)) > 0
    return pixels if left else pixels[::-1]


def strip_of(surface: Surface, rng: np.random.Generator | None = None) -> Strip:
    seen = cameras()
    return recover_strip(seen, [exact_contours(surface, v, rng) for v in seen])[1]
