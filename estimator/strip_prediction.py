"""What a strip foretells of a view that it was not made of, and how far that view's edges are from it.

A new camera centre v touches the surface where n . (r - v) = 0. On every arc, continued beyond the views, this point is
found and projected: the predicted apparent contour. It is compared with the image's own contours, along their normals.
"""

from dataclasses import dataclass

import numpy as np

from extremal.estimator.camera import Array, View
from extremal.estimator.contours import Contours
from extremal.estimator.extrapolation import extrapolate
from extremal.estimator.matching import ALIKE, EdgelMap
from extremal.estimator.strip import Strip
from extremal.estimator.strip_grid import normal_sigma
from extremal.estimator.tracking import GATE, LEAST_GATE

REACH = 8  # [px] within which the image's edge is looked for
ANGLE = 0.4  # [rad] beyond the strip in which the new contour generator is looked for
NEWTON_STEPS = 4


@dataclass(frozen=True, eq=False)
class Prediction:
    """A predicted apparent contour, a point for each of S arcs, and what the image shows.

    Attributes:
        points: (S, 3) [m] of the surface; pixels: (S, 2).
        normals: (S, 2) unit image normals, out of the surface.
        sigma: (S,) [px] along them.
        valid: (S,) whether the arc reaches the new contour generator, in front of the camera and within its image.
        beyond: (S,) whether that lies past the arc's own views.
        found: (S,) whether an edge of the image runs there.
        offset: (S,) [px] from the prediction to that edge along the normal, positive outwards; NaN where not found.
    """

    points: Array
    pixels: Array
    normals: Array
    sigma: Array
    valid: np.ndarray
    beyond: np.ndarray
    found: np.ndarray
    offset: Array

    @property
    def rms(self) -> float:
        """Root mean square [px] of the offsets; NaN where nothing was found."""
        offset = self.offset[self.found]
        return float(np.sqrt(np.mean(offset**2))) if len(offset) else float("nan")


def predict(strip: Strip, view: View, contours: Contours) -> Prediction:
    """The apparent contour of the strip in a view, and its distance from the contours of that view's image."""
    phi, reached = _contact(strip, view.centre)
    points, covariance, normals = (a[:, 0] for a in strip.at(phi[:, None]))
    pixels = view.project(points)
    image_normals = view.project(points + 1e-6 * normals) - pixels
    with np.errstate(invalid="ignore"):
        scale = np.linalg.norm(image_normals, axis=1) / 1e-6  # [px/m] of a shift along the normal
        image_normals = image_normals / (1e-6 * scale[:, None])
        size = (view.camera.width - 0.5, view.camera.height - 0.5)
        valid = reached & np.all((pixels > -0.5) & (pixels < size), axis=1)
    sigma = np.hypot(normal_sigma(normals, covariance), _pose_sigma(view, points, normals)) * scale
    beyond = (phi < strip.arcs.first) | (phi > strip.arcs.last)
    found, offset = _offsets(contours, view, pixels, image_normals, np.where(valid, sigma, np.nan))
    return Prediction(points, pixels, image_normals, sigma, valid, beyond, found, offset)


def _contact(strip: Strip, centre: Array) -> tuple[Array, np.ndarray]:
    """phi (S,) [rad] at which each arc is touched from a centre (3,), 0 where it is not; and whether it is."""
    grid = extrapolate(strip, ANGLE)
    height = np.einsum("skj,skj->sk", grid.normals, grid.points - centre)
    usable = grid.valid & np.isfinite(height)
    crossing = (height[:, :-1] * height[:, 1:] <= 0) & usable[:, :-1] & usable[:, 1:]
    rows, k = np.arange(len(height)), np.argmax(crossing, axis=1)
    a, b = height[rows, k], height[rows, k + 1]
    part = np.where(a == b, 0.5, a / np.where(a == b, 1.0, a - b))
    phi = grid.phi[rows, k] + part * (grid.phi[rows, k + 1] - grid.phi[rows, k])
    reached = crossing.any(axis=1)
    return np.where(reached, phi, 0.0), reached


def _pose_sigma(view: View, points: Array, normals: Array) -> Array:
    """Standard deviation [m] along the normals (S, 3) by which the pose of the view moves points (S, 3)."""
    rotation = view.T_world_camera.rotation.as_matrix()
    n, arm = normals @ rotation, (points - view.centre) @ rotation
    lever = np.concatenate([n, np.cross(arm, n)], axis=1)
    return np.sqrt(np.einsum("ni,ij,nj->n", lever, view.pose_covariance, lever))


def _offsets(
    contours: Contours, view: View, pixels: Array, normals: Array, sigma: Array
) -> tuple[np.ndarray, Array]:
    """Whether a contour runs along each predicted point (S,), and how far [px] outside it (S,).

    As in tracking, a contour is another one where it is farther than `sigma` (S,) [px] allows, which is NaN where nothing is
    predicted.
    """
    if len(contours.u) == 0:
        return np.zeros(len(pixels), bool), np.full(len(pixels), np.nan)
    edgels = EdgelMap(contours, view.camera.width, view.camera.height, REACH)
    valid = np.isfinite(sigma)
    at = np.where(valid[:, None], pixels, 0.0)
    index = edgels.lookup(at)
    start = np.maximum(index, 0)
    contour, u = contours.contour[start], contours.u[start]
    for _ in range(NEWTON_STEPS):  # to the foot of the predicted point
        position, tangent, _, _ = contours.splines.frame(u)
        speed = np.linalg.norm(contours.splines.curve(u, 1), axis=-1)
        step = np.sum((at - position) * tangent, axis=1) / speed
        u = contours.splines.clamp(u + np.clip(step, -REACH, REACH), contour)
    position, tangent, normal, _ = contours.splines.frame(u)
    apart = position - at
    ends = np.abs(np.sum(apart * tangent, axis=1)) > 0.5  # beyond the end of its contour
    alike = np.abs(np.sum(normal * normals, axis=1)) > ALIKE
    offset = np.sum(apart * normals, axis=1)
    gate = LEAST_GATE + GATE * np.hypot(sigma, contours.sigma_at(u))
    found = valid & (index >= 0) & alike & ~ends & (np.abs(offset) < np.minimum(gate, REACH))
    return found, np.where(found, offset, np.nan)
