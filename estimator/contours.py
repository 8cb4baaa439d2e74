"""Image contours of one view: detected, localised to sub-pixel accuracy, and joined into B-splines with sigma."""

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.interpolate import BSpline
from scipy.ndimage import maximum_filter1d

from extremal.estimator.camera import Array, Camera
from extremal.estimator.detection import Chains, detect_chains, noise_level
from extremal.estimator.pooling import window_sum
from extremal.estimator.profile import HALF_WIDTH, PIXEL_VARIANCE, fit_profiles, offsets
from extremal.estimator.splines import DEGREE, Splines, arc_length, fit, knots

ROWS = 5  # lines across the contour, 1 px apart, that are averaged for one edgel
FIRST_SPACING = 8.0  # [px] knots of the splines through the detected pixels
SPACING = 16.0  # [px] knots of the splines through the edgels, closer where a contour is bent:
BEND_SPACING = 1.2  # times radius^(3/4): a cubic is then within 0.005 px of a circle
SHARED = 4  # edgels on each side that share their misfit to the spline
LONGEST_GAP = 3  # edgels that a contour may miss in a row
HUBER = 2.5  # standard deviations beyond which an edgel loses weight
SUBPIXEL = 32  # cv2.remap quantises coordinates to this fraction of a pixel: ask only for such
SYSTEMATIC = (
    0.0065  # [px] what models of shading leave, alike in neighbouring edgels: no spline averages it out
)
RIVAL = 0.45  # of an edge's own gradient, from which an edge beside it counts
CLEAR = 0.06  # [px] sigma above which an edgel hangs on its model of shading, which neighbours share
FAINT = 0.8  # of what lies above, that no spline averages out
CROWDED = 0.05  # [px] the same with another edge within the profile
KINK = 1.5  # [px^2] error of the spline per change of curvature [1/px] within 5 px to each side
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

    def nearest_edgel(self, u: Array) -> np.ndarray:
        """Number of the edgel whose parameter is nearest to each u."""
        after = np.clip(np.searchsorted(self.u, u), 1, len(self.u) - 1)
        return after - ((u - self.u[after - 1]) < (self.u[after] - u))


def find_contours(image: np.ndarray, camera: Camera, ignored: np.ndarray | None = None) -> Contours:
    """All contours of an image (height, width[, 3]) uint8 that stand clear of its noise, outside `ignored` (height, width)."""
    grey = camera.linear(image)
    noise = noise_level(grey)
    chains = detect_chains(grey, noise, ignored)
    if len(chains.chain) == 0:
        return _nothing(noise)
    curves = _through_pixels(chains)
    return _localised(grey, curves, chains.edges, noise, camera)


def _through_pixels(chains: Chains) -> Splines:
    u, breaks = arc_length(chains.positions, chains.chain)
    count = np.bincount(chains.chain)
    t = knots(u, chains.chain, breaks, np.full(len(u), FIRST_SPACING), count // 3, 2.0)
    return fit(u, chains.positions, np.ones(len(u)), t, breaks).splines


def _localised(
    grey: np.ndarray, curves: Splines, gradient: np.ndarray, noise: float, camera: Camera
) -> Contours:
    """Edgels from profiles across the curves, and the splines through them."""
    u, contour = _window_starts(curves)
    lines = u[:, None] + np.arange(ROWS) + 0.5
    position, _, normal, curvature = curves.frame(lines)
    profiles = _profiles(grey, position, normal)
    clear = _clearance(gradient, position, normal)
    edges = fit_profiles(profiles, noise, ROWS, camera.blur, contour, clear)
    middle, bend = normal[:, ROWS // 2], curvature.mean(axis=1)
    # blur draws a curved edge towards its centre of curvature
    offset = edges.offset - 0.5 * (camera.blur**2 + PIXEL_VARIANCE) * bend
    keep, contour = _runs(edges.sigma < LARGEST_SIGMA, contour)
    if not keep.any():
        return _nothing(noise)
    positions = (position[:, ROWS // 2] + offset[:, None] * middle)[keep]
    sigma = np.hypot(edges.sigma, edges.ambiguity)[keep]
    u, breaks = arc_length(positions, contour)
    splines, spline_sigma = _through_edgels(u, positions, sigma, bend[keep], contour, breaks)
    position, _, normal, bend = splines.frame(u)
    systematic = np.where(clear[keep] <= HALF_WIDTH, CROWDED, SYSTEMATIC)
    kink = KINK * _bend_change(bend, contour)
    faint = FAINT * np.maximum(sigma - CLEAR, 0.0)
    spline_sigma = np.sqrt(spline_sigma**2 + systematic**2 + edges.ambiguity[keep] ** 2 + kink**2 + faint**2)
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
    px, py, nx, ny = position[..., :1], position[..., 1:], normal[..., :1], normal[..., 1:]
    x = np.rint((px + s * nx) * SUBPIXEL) / SUBPIXEL
    y = np.rint((py + s * ny) * SUBPIXEL) / SUBPIXEL
    # rounding moves a sample along the normal too: correct its value by the slope that its line shows there
    moved = (x - px) * nx + (y - py) * ny - s
    n, rows, count = moved.shape
    x32, y32 = (v.astype(np.float32).reshape(n * rows, count) for v in (x, y))
    values = cv2.remap(grey, x32, y32, cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REPLICATE)
    mean = values.reshape(n, rows, count).mean(axis=1)
    slope = np.gradient(mean, axis=1)
    return mean - slope * moved.mean(axis=1)


def _clearance(edges: np.ndarray, position: Array, normal: Array) -> Array:
    """Distance (n,) [px] along the normals of the lines (n, ROWS, 2) to the nearest edge beside this one; else far.

    An edge that crosses the window meets single lines; one that runs beside the contour meets nearly all of them. The
    shading of a limb may pass for an edge, too, but for a faint one.
    """
    s = offsets()
    x, y = (np.rint(position[..., i, None] + s * normal[..., i, None]) for i in range(2))
    height, width = edges.shape
    at = np.minimum(np.maximum(y, 0), height - 1) * width + np.minimum(np.maximum(x, 0), width - 1)
    gradient = edges.ravel()[at.astype(np.intp)]
    near = slice(HALF_WIDTH - 2, HALF_WIDTH + 3)  # these may be the contour's own pixels
    own = gradient[..., near].max(axis=2).mean(axis=1)
    hit = gradient > RIVAL * own[:, None, None]
    hit[..., near] = False
    lines = (hit[..., :-1] | hit[..., 1:]).sum(axis=1)
    beside = np.maximum(np.pad(lines, ((0, 0), (0, 1))), np.pad(lines, ((0, 0), (1, 0)))) >= ROWS - 1
    beside &= hit.any(axis=1)
    return np.where(beside, np.abs(s), 2.0 * HALF_WIDTH).min(axis=1)


def _runs(good: np.ndarray, contour: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Edgels to keep (n,), and the contours (k,) of those: broken at gaps of LONGEST_GAP, none of fewer than two."""
    index = np.flatnonzero(good)
    if len(index) == 0:
        return good, contour[index]
    new = (np.diff(index) > LONGEST_GAP) | (np.diff(contour[index]) != 0)
    run = np.concatenate([[0], np.cumsum(new)])
    enough = np.bincount(run)[run] >= 2
    keep = np.zeros_like(good)
    keep[index[enough]] = True
    return keep, np.unique(run[enough], return_inverse=True)[1]


def _through_edgels(
    u: Array, positions: Array, sigma: Array, bend: Array, contour: np.ndarray, breaks: Array
) -> tuple[Splines, Array]:
    """Splines through the edgels, and their sigma (n,) across themselves, widened where they do not fit."""
    radius = 1 / np.maximum(maximum_filter1d(np.abs(bend), 3), 1e-4)
    spacing = np.clip(BEND_SPACING * radius**0.75, 1.5 * ROWS, SPACING)
    t = knots(u, contour, breaks, spacing, np.bincount(contour) - 3, 1.5 * ROWS)
    weights = 1 / sigma
    found = fit(u, positions, weights, t, breaks)
    at, _, normal, _ = found.splines.frame(u)
    misfit = np.abs(np.sum((positions - at) * normal, axis=1)) / sigma
    weights = np.minimum(1.0, HUBER / np.maximum(misfit, 1e-9)) / sigma
    found = found.again(positions, weights)
    splines, variance = found.splines, found.variance()
    at, _, normal, _ = splines.frame(u)
    misfit = (np.sum((positions - at) * normal, axis=1) * weights) ** 2
    freedom = np.maximum(1 - variance * weights**2, 0.0)  # what the spline leaves of each edgel's residual
    chi2, _ = window_sum(misfit, contour, SHARED)
    left, _ = window_sum(freedom, contour, SHARED)
    excess = (chi2 + 1e-3) / (left + np.sqrt(2 * left) + 1e-3)  # beyond one standard deviation of chi2
    return splines, np.sqrt(variance * np.maximum(1.0, excess))


def _bend_change(bend: Array, contour: np.ndarray) -> Array:
    """Largest change (n,) of curvature to the next edgels on the same contour."""
    change = np.where(contour[1:] == contour[:-1], np.abs(np.diff(bend)), 0.0)
    return np.maximum(np.append(change, 0.0), np.append(0.0, change))


def _nothing(noise: float) -> Contours:
    t = np.repeat([0.0, 1.0], 4)
    empty, none = np.zeros(0), np.zeros((0, 2))
    splines = Splines(BSpline(t, np.zeros((4, 2)), DEGREE), np.array([0.0, 1.0]))
    return Contours(splines, empty, np.zeros(0, int), none, none, empty, empty, empty, empty, empty, noise)
