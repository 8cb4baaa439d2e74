"""Does a match continue its track, or has the track gone over to another contour?

Poses are off by more than contours lie apart, so that it tells little how far a match is from where its track is expected. But
an error of the pose moves all contours together, and hardly anything else changes from one view to the next: by how much a
track misses its prediction, once the error that all share is taken out; the direction of its edge; and the edge's contrast. A
track that goes without matches for some views is none the worse for it, whereas one on another contour bends its radius and,
through the poses, those of all others. So what is doubtful is left out.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from extremal.estimator.camera import Array, View
from extremal.estimator.matching import Crossings
from extremal.estimator.pooling import windows
from extremal.estimator.poses import pose_exp, square_root

LEAST_MATCHES = 12  # from which on they tell of the pose that they share
ROUNDS = 6
LEAST_SPREAD = 0.1  # [px] of predictions among each other
GATE, LEAST_GATE = (
    4.0,
    1.0,
)  # robust standard deviations, and [px], by which a match may be off what most tracks share
STEP, STEP_GROWTH = (
    0.6,
    0.2,
)  # [px] by which a miss changes to the next view, and more for each view without the track
TURN, TURN_GROWTH = np.deg2rad(5.0), np.deg2rad(1.0)  # [rad] by which an edge turns, likewise
LONGEST_GAP = 10  # views, from which on they add no more
CONTRAST, NOISY = 0.3, 4.0  # share of the contrast, and standard deviations of a pixel, by which it changes
SHARP = 0.05  # [1/px] of a contour's curvature, as at the end of an edge, where it goes on along another
CONFIRMED = 2  # views in a row that a track has to be found in after it was lost
FIRST_STEP, FIRST_GATE = 0.5, 3.0  # [px], standard deviations: of the same in views from which tracks start
BESIDE = 3  # edgels to each side on a contour whose misses a match has to share there


@dataclass(frozen=True, eq=False)
class Shared:
    """The error of a view's pose that its n matches share.

    Attributes:
        left: (n,) [rad] by which matches are off their predictions without it, across the contours. scale: [rad] of most of them.
        T_world_camera: the pose without it.
    """

    left: Array
    scale: float
    T_world_camera: RigidTransform


def shared_error(ok: np.ndarray, view: View, points: Array, normals: Array) -> Shared:
    """What most of the matches `ok` (n,) tell of the error of the view's pose.

    An error d of the pose moves all contours together: a tangent plane n (in the camera frame) passes its contact point p by
    n.p = [n, p x n] d. The likeliest d for most of the tracks is that of Huber's M-estimator, by reweighted least squares.

    Args:
        points: (n, 3) [m] predicted contact points, in the world. normals: (n, 3) unit, of the tangent planes, in the camera frame.
    """
    root = pose_root(view)
    p = (points - view.centre) @ view.T_world_camera.rotation.as_matrix()
    distance = np.linalg.norm(p, axis=1)
    misses = np.sum(normals * p, axis=1) / distance
    A = np.concatenate([normals, np.cross(p, normals)], axis=1) @ root / distance[:, None]
    z, left, scale = np.zeros(A.shape[1]), misses, LEAST_SPREAD / view.camera.fx
    for _ in range(ROUNDS):
        scale = max(1.48 * float(np.median(np.abs(left[ok]))), LEAST_SPREAD / view.camera.fx)
        weighted = A.T * (ok / (scale * np.maximum(np.abs(left), scale)))  # of far ones, the sign counts
        z = np.linalg.solve(weighted @ A + np.eye(len(z)), weighted @ misses)
        left = misses - A @ z
    return Shared(left, scale, view.T_world_camera * pose_exp(root @ z))


class Continuity:
    """What n tracks were like when they were last seen.

    Attributes:
        left: (n,) [rad] as of `Shared`; before, the same of the last match, which may not have been believed. contrast: (n,) [grey
            levels]. gap: (n,) views since then. row: (n,) views in a row with a match. NaN where nothing is known.
    """

    def __init__(self, n: int) -> None:
        self.left, self.before, self.contrast = (np.full(n, np.nan) for _ in range(3))
        self.gap, self.row = np.zeros(n), np.full(n, CONFIRMED)

    def kept(
        self, ok: np.ndarray, view: View, noise: float, points: Array, found: Crossings, direction: Array
    ) -> np.ndarray:
        """Which matches `ok` (n,) of a view, with `noise` [grey levels], continue their tracks.

        Args:
            points: (n, 3) [m] predicted contact points. direction: (n, 3) of the edges as they were last seen, to their brighter sides.
        """
        ok = ok & ~found.crowded & (np.abs(found.curvature) < SHARP)
        if np.count_nonzero(ok) < LEAST_MATCHES:
            self.gap += 1
            return ok
        shared = shared_error(
            ok, view, points, found.tangent_planes @ view.T_world_camera.rotation.as_matrix()
        )
        pixel, gap = 1 / view.camera.fx, np.minimum(self.gap, LONGEST_GAP)
        left, step = shared.left, STEP * pixel + shared.scale - LEAST_SPREAD * pixel
        ok &= np.abs(left) < LEAST_GATE * pixel + GATE * shared.scale
        ok &= turn(view, direction, found.directions) < np.sin(TURN + TURN_GROWTH * gap)
        ok &= ~other_contrast(found.contrast, self.contrast, noise)
        ok &= ~(np.abs(left - self.left) > step + STEP_GROWTH * gap * pixel)
        ok &= ~(np.abs(left - self.before) > step)
        self.row, self.before = np.where(ok, self.row + 1, 0), np.where(ok, left, np.nan)
        ok &= self.row >= CONFIRMED
        self.left, self.contrast = np.where(ok, left, self.left), np.where(ok, found.contrast, self.contrast)
        self.gap = np.where(ok, 0.0, self.gap + 1)
        return ok


def begun(
    ok: np.ndarray,
    view: View,
    noise: float,
    points: Array,
    found: Crossings,
    contour: np.ndarray,
    contrast: Array,
) -> tuple[np.ndarray, RigidTransform]:
    """Which matches `ok` (n,) hold together in a view from which tracks start, and the pose that these tell of.

    Args:
        contour: (n,) image contour of each track, non-decreasing: neighbours on it have to miss their predictions alike.
        contrast: (n,) [grey levels] in the view where the tracks were chosen. The others as of `Continuity.kept`.
    """
    ok = ok & ~found.crowded & (np.abs(found.curvature) < SHARP)
    if np.count_nonzero(ok) < LEAST_MATCHES:
        return ok, view.T_world_camera
    shared = shared_error(ok, view, points, found.tangent_planes @ view.T_world_camera.rotation.as_matrix())
    pixel = 1 / view.camera.fx
    ok &= np.abs(shared.left) < FIRST_STEP * pixel + FIRST_GATE * shared.scale
    ok &= np.abs(shared.left - _beside(np.where(ok, shared.left, np.nan), contour)) < FIRST_STEP * pixel
    ok &= ~other_contrast(found.contrast, contrast, noise)
    return ok, shared.T_world_camera


def turn(view: View, before: Array, now: Array) -> Array:
    """Sine (n,) of the angle in the image of a view between directions (n, 3) in the world, at most a right one."""
    x, y = view.T_world_camera.rotation.as_matrix()[:, :2].T
    cross = (before @ x) * (now @ y) - (before @ y) * (now @ x)
    return np.abs(cross) / np.maximum(np.hypot(before @ x, before @ y) * np.hypot(now @ x, now @ y), 1e-12)


def other_contrast(one: Array, two: Array, noise: float) -> np.ndarray:
    """Whether contrasts (n,) [grey levels] are those of different edges; not where one is NaN."""
    return np.abs(one - two) > NOISY * noise + CONTRAST * np.maximum(one, two)


def _beside(values: Array, contour: np.ndarray) -> Array:
    """Median (n,) of those values (n,) that are known BESIDE each one on its contour; 0 where none is."""
    first, last = windows(contour, BESIDE)
    rows = np.arange(len(values))[:, None] + np.arange(-BESIDE, BESIDE + 1)
    inside = (rows >= first[:, None]) & (rows < last[:, None])
    around = np.where(inside, values[np.clip(rows, 0, len(values) - 1)], np.nan)
    around[np.isnan(around).all(axis=1)] = 0.0
    return np.nanmedian(around, axis=1)


def pose_root(view: View) -> Array:
    """(6, 6) square root of the pose's covariance, or (6, 0) of an exact pose."""
    root = square_root(view.pose_covariance[None])[0]
    return np.pad(root, ((0, 0), (0, 6 - root.shape[1]))) if root.shape[1] else root
