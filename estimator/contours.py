"""Image contours of one view: detected, localised to sub-pixel accuracy, and joined into B-splines with sigma."""

from dataclasses import dataclass

import cv2
import numpy as np

from extremal.estimator.camera import Array, Camera
from extremal.estimator.detection import Chains, detect_chains, noise_level
from extremal.estimator.profile import HALF_WIDTH, PIXEL_VARIANCE, fit_profiles, offsets
from extremal.estimator.splines import Splines, arc_length, fit, knots, leverage_variance

ROWS = 5  # lines across the contour, 1 px apart, that are averaged for one edgel
FIRST_SPACING = 12.0  # [px] knots of the splines through the detected pixels
SPACING = 24.0  # [px] knots of the splines through the edgels
SUBPIXEL = 32  # cv2.remap quantises coordinates to this fraction of a pixel: ask only for such
LEAST_SIGMA = 0.004  # [px] floor: what the interpolation and the models of the edge leave
LARGEST_SIGMA = 0.7  # [px] an edgel that is known less well is no edgel


@dataclass(frozen=True, eq=False)
class Contours:
    """Contours of a view as splines, and the n edgels on them, ordered along each contour.

    Attributes:
        splines: the curves; the brighter side lies to the left of their direction.
        u: (n,) parameter of each edgel; contour: (n,) its curve.
        positions: (n, 2) [px]; normals: (n, 2) unit, to the left (brighter) side; curvature: (n,) [1/px], positive
            where the contour bends towards that side.
        sigma: (n,) standard deviation [px] of the curve across itself at the edgel.
        edgel_sigma: (n,) the same of the edgel alone.
        contrast: (n,) [grey levels] bright minus dark; limb: (n,) shading of a limb, from -1 (on the dark side) to 1.
        noise: [grey levels] of a pixel.
    """

    splines: Splines
    u: Array
    contour: np.ndarray
    positions: Array
    normals: Array
    curvature: Array
    sigma: Array
    edgel_sigma: Array
    contrast: Array
    limb: Array
    noise: float

    def sigma_at(self, u: Array) -> Array:
        """Standard deviation [px] of the curves across themselves at u (interpolated between edgels)."""
        return np.interp(u, self.u, self.sigma)


def find_contours(image: np.ndarray, camera: Camera) -> Contours:
    """All contours of an image (height, width[, 3]) uint8 that stand clear of its noise."""
    grey = image.astype(np.float32) if image.ndim == 2 else image.mean(axis=2, dtype=np.float32)
    noise = noise_level(grey)
    chains = detect_chains(grey, noise)
    if len(chains.chain) == 0:
        return _nothing(noise)
    curves = _through_pixels(chains)
    return _localised(grey, curves, noise, camera)


def _through_pixels(chains: Chains) -> Splines:
    u, breaks = arc_length(chains.positions, chains.chain)
    count = np.bincount(chains.chain)
    t = knots(breaks, np.full(len(count), FIRST_SPACING), count // 3)
    return fit(u, chains.positions, None, t, breaks)


def _localised(grey: np.ndarray, curves: Splines, noise: float, camera: Camera) -> Contours:
    """Edgels from profiles across the curves, and the splines through them."""
    u, contour = _window_starts(curves)
    lines = u[:, None] + np.arange(ROWS) + 0.5
    position, _, normal, curvature = curves.frame(lines)
    profiles = _profiles(grey, position, normal)
    edges = fit_profiles(profiles, noise, ROWS, camera.blur, contour)
    middle, bend = normal[:, ROWS // 2], curvature.mean(axis=1)
    # blur draws a curved edge towards its centre of curvature
    offset = edges.offset - 0.5 * (camera.blur**2 + PIXEL_VARIANCE) * bend
    keep = (edges.sigma < LARGEST_SIGMA) & _with_company(edges.sigma < LARGEST_SIGMA, contour)
    if not keep.any():
        return _nothing(noise)
    _, contour = np.unique(contour[keep], return_inverse=True)
    positions = (position[:, ROWS // 2] + offset[:, None] * middle)[keep]
    sigma = np.hypot(edges.sigma[keep], LEAST_SIGMA)
    u, breaks = arc_length(positions, contour)
    splines, spline_sigma = _through_edgels(u, positions, sigma, contour, breaks)
    position, _, normal, bend = splines.frame(u)
    return Contours(
        splines,
        u,
        contour,
        position,
        normal,
        bend,
        spline_sigma,
        sigma,
        edges.contrast[keep],
        edges.limb[keep],
        noise,
    )


def _window_starts(curves: Splines) -> tuple[Array, np.ndarray]:
    """Start (n,) of every window of ROWS lines, centred in each contour, and its contour."""
    length = np.diff(curves.breaks)
    count = (length // ROWS).astype(int)
    contour = np.repeat(np.arange(len(count)), count)
    index = np.arange(len(contour)) - np.repeat(np.cumsum(count) - count, count)
    first = curves.breaks[:-1] + 0.5 * (length - count * ROWS)
    return first[contour] + index * ROWS, contour


def _profiles(grey: np.ndarray, position: Array, normal: Array) -> Array:
    """Mean intensity (n, K) over the lines (n, ROWS, 2) at `offsets()` along their normals."""
    s = offsets()
    at = position[..., None, :] + s[:, None] * normal[..., None, :]
    at = np.rint(at * SUBPIXEL) / SUBPIXEL
    # rounding moves a sample along the normal too: correct its value by the slope that its line shows there
    moved = np.sum((at - position[..., None, :]) * normal[..., None, :], axis=-1) - s
    n, rows, count = moved.shape
    values = cv2.remap(
        grey, at.reshape(n * rows, count, 2).astype(np.float32), None, cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REPLICATE
    ).reshape(n, rows, count)
    mean = values.mean(axis=1)
    slope = np.gradient(mean, axis=1)
    return mean - slope * moved.mean(axis=1)


def _with_company(good: np.ndarray, contour: np.ndarray) -> np.ndarray:
    """Edgels of contours that have at least DEGREE + 1 good ones."""
    return np.bincount(contour, good, minlength=contour[-1] + 1)[contour] >= 4


def _through_edgels(
    u: Array, positions: Array, sigma: Array, contour: np.ndarray, breaks: Array
) -> tuple[Splines, Array]:
    """Splines through the edgels, and their sigma (n,) across themselves, widened where they do not fit."""
    count = np.bincount(contour)
    weights = 1 / sigma
    t = knots(breaks, np.full(len(count), SPACING), np.maximum(count - 3, 1))
    splines = fit(u, positions, weights, t, breaks)
    left, _, normal, _ = splines.frame(u)
    misfit = (np.sum((positions - left) * normal, axis=1) / sigma) ** 2
    intervals = np.bincount(splines.contour_of((t[:-1] + t[1:])[np.diff(t) > 0] / 2), minlength=len(count))
    freedom = np.maximum(count - intervals - 3, 1)
    chi2 = np.bincount(contour, misfit) / freedom
    return splines, np.sqrt(leverage_variance(u, weights, t, u) * np.maximum(chi2, 1.0)[contour])


def _nothing(noise: float) -> Contours:
    t = np.repeat([0.0, 1.0], 4)
    empty, none = np.zeros(0), np.zeros((0, 2))
    splines = fit(np.linspace(0, 1, 4, endpoint=True) * 0.999, np.zeros((4, 2)), None, t, np.array([0.0, 1.0]))
    return Contours(splines, empty, np.zeros(0, int), none, none, empty, empty, empty, empty, empty, noise)
