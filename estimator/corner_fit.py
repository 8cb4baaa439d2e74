"""Where is the corner of a chessboard? Two blurred edges that cross, fitted to the pixels around it.

With u, v the signed distances from the two edges, measured in standard deviations of the blur, and rho the correlation of the
blur along their normals, a point is black where u v > 0, and the blurred image is

    I = W (1 - B) + K B,     B = P(x < u, y < v) + P(x > u, y > v),     x, y ~ N(0, [[1, rho], [rho, 1]])

W and K, the levels of white and black, vary linearly. In a ChArUco board B also counts two corners of markers, which stand in
the white squares a known gap away. All of this is symmetric about the corner but for the slopes: blur, levels, edges that are
a little bent and whatever else is alike on both sides does not move it.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr

from extremal.estimator.camera import Array
from extremal.estimator.errors import InvalidInput

RADIUS = 10  # [px] of the largest window
CLEAR = 2.5  # standard deviations of the blur that the window stays away from what is not in the model
FEWEST = 40  # pixels
FINEST = 0.01  # [px] of blur
LEAST_AREA = 1.0  # [px^2] of a square in the image
FARTHEST = 1000.0  # [px] beyond the image, from which on nothing is a window
STEPS = 12
SETTLED = 2e-4  # [px]
LONGEST = np.array(
    [0.7, 0.7, 0.1, 0.1, 0.35, 0.35]
)  # step of corner [px], directions [rad], log of the blurs
FAR = 5.0  # standard deviations from either edge, beyond which the correlation does not matter
NODES, WEIGHTS = np.polynomial.legendre.leggauss(5)


@dataclass(frozen=True, eq=False)
class Windows:
    """Windows of n corners.

    Attributes:
        centre: (n, 2) [px] where the corners are expected.
        first, second: (n, 2, 2), (n, 2, 2, 2) derivatives there of the pixel by the place on the board [squares].
        dark: (n,) 1 where the squares towards (+, +) and (-, -) are black, -1 where they are white.
        gap, ring: [squares] from the corner to the markers beside it, and the width of their black border.
        blur: (2,) [px] across either edge, expected.

    Raises InvalidInput for other shapes, and numbers that are none of these. Centres and derivatives need not be finite.
    """

    centre: Array
    first: Array
    second: Array
    dark: Array
    gap: float
    ring: float
    blur: Array

    def __post_init__(self) -> None:
        n = len(np.atleast_1d(self.centre))
        names, accepted = ("centre", "first", "second", "dark"), ((n, 2), (n, 2, 2), (n, 2, 2, 2), (n,))
        for name, shape in zip(names, accepted, strict=True):
            if np.shape(getattr(self, name)) != shape:
                raise InvalidInput(f"{name} of windows is {np.shape(getattr(self, name))}; accepted: {shape}")
        if not np.all(np.abs(self.dark) == 1):
            raise InvalidInput(
                f"dark of windows holds {np.unique(self.dark)[:5].tolist()}; accepted: 1 and -1"
            )
        for name in ("gap", "ring"):
            if not 0 <= getattr(self, name) <= 1:
                raise InvalidInput(
                    f"{name} of windows is {getattr(self, name)!r}; accepted: 0 to 1 [squares]"
                )
        if np.shape(self.blur) != (2,) or not np.all((self.blur >= FINEST) & (self.blur <= RADIUS)):
            raise InvalidInput(
                f"blur of windows is {self.blur!r}; accepted: two numbers from {FINEST} to {RADIUS} px"
            )


@dataclass(frozen=True, eq=False)
class CornerFit:
    """Fits of n corners.

    Attributes:
        pixels: (n, 2); covariance: (n, 2, 2) [px^2] for noise of one grey level.
        variance: (n,) [grey levels^2] of the residuals.
        contrast: (n,) [grey levels] white minus black.
        blur: (n, 2) [px] across either edge, the pixel's area included.
        settled: (n,) whether the fit converged, on a window that is large enough.
    """

    pixels: Array
    covariance: Array
    variance: Array
    contrast: Array
    blur: Array
    settled: np.ndarray


def fit_corners(grey: Array, windows: Windows) -> CornerFit:
    """Fit all corners at once in an image (height, width) of grey levels (Gauss and Newton).

    A corner whose window is not all inside the image, or not known in finite numbers, has not settled.

    Raises InvalidInput for an image of another shape, or with grey levels that are not finite.
    """
    if np.ndim(grey) != 2 or 0 in np.shape(grey) or not np.all(np.isfinite(grey)):
        raise InvalidInput(f"grey levels are {np.shape(grey)}; accepted: finite numbers (height, width)")
    windows, sound = _sound(windows, grey.shape)
    pixels, inside = _pixels(grey.shape, windows.centre)
    values = grey[pixels[..., 1], pixels[..., 0]].astype(float)
    d = _straightened(pixels - windows.centre[:, None], windows)
    inverse = np.linalg.inv(windows.first)
    mask = _mask(d @ np.swapaxes(inverse, 1, 2), windows, inverse)
    large = sound & (mask.sum(axis=1) >= FEWEST) & ~np.any(mask & ~inside, axis=1)
    mask &= large[:, None]
    model = _Model(d, mask, inverse, windows)
    p = np.tile(np.append(np.zeros(4), np.log(windows.blur)), (len(d), 1))
    step = np.full(p.shape, np.inf)
    for _ in range(STEPS):
        step = model.step(p, values)
        p = p + np.clip(step, -LONGEST, LONGEST)
        if not np.any(np.abs(step[large, :2]) > SETTLED):
            break
    variance, covariance, contrast = model.quality(p, values)
    settled = large & np.all(np.abs(step[:, :2]) < 10 * SETTLED, axis=1)
    return CornerFit(windows.centre + p[:, :2], covariance, variance, contrast, np.exp(p[:, 4:]), settled)


def _sound(windows: Windows, shape: tuple[int, ...]) -> tuple[Windows, np.ndarray]:
    """Windows with those replaced that are far from the image, squeezed or not finite; and which (n,) are as they were."""
    n = len(windows.centre)
    numbers = [np.reshape(getattr(windows, name), (n, -1)) for name in ("centre", "first", "second")]
    sound = np.all(np.abs(np.concatenate(numbers, axis=1)) < 2.0 * max(shape) + FARTHEST, axis=1)
    first = np.where(sound[:, None, None], windows.first, np.eye(2))
    sound &= np.abs(np.linalg.det(first)) > LEAST_AREA
    kept = (
        np.where(sound.reshape(-1, *[1] * (value.ndim - 1)), value, instead)
        for value, instead in ((windows.centre, 0.0), (windows.first, 10 * np.eye(2)), (windows.second, 0.0))
    )
    return replace(windows, **dict(zip(("centre", "first", "second"), kept, strict=True))), sound


def _pixels(shape: tuple[int, ...], centre: Array) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (n, P, 2) of round windows, moved to the border where they lie outside, and whether they are inside (n, P)."""
    i, j = np.mgrid[-RADIUS : RADIUS + 1, -RADIUS : RADIUS + 1]
    around = np.stack([j, i], axis=-1)[np.hypot(i, j) <= RADIUS + 0.5]
    wanted = np.rint(centre).astype(int)[:, None] + around
    pixels = np.clip(wanted, 0, np.array(shape[::-1]) - 1)
    return pixels, np.all(pixels == wanted, axis=-1)


def _straightened(d: Array, windows: Windows) -> Array:
    """Displacements (n, P, 2) [px] without perspective and distortion: linear in the place on the board."""
    x, y = np.moveaxis(d @ np.swapaxes(np.linalg.inv(windows.first), 1, 2), -1, 0)
    squares = np.stack([0.5 * x * x, x * y, 0.5 * y * y], axis=-1)
    xx, xy, yy = windows.second[..., 0, 0], windows.second[..., 0, 1], windows.second[..., 1, 1]
    return d - squares @ np.stack([xx, xy, yy], axis=1)


def _mask(place: Array, windows: Windows, inverse: Array) -> np.ndarray:
    """Pixels (n, P) that see nothing but the two edges and the outer corners of the markers."""
    margin = CLEAR * windows.blur * np.linalg.norm(inverse, axis=2)
    x, y = np.moveaxis(np.abs(place), -1, 0)
    white = place[..., 0] * place[..., 1] * windows.dark[:, None] < 0
    within = windows.gap + windows.ring - margin
    bits = white & (x > within[:, :1]) & (y > within[:, 1:])
    return (x < 1 - margin[:, :1]) & (y < 1 - margin[:, 1:]) & ~bits


class _Model:
    """The images of n corners in their windows of P pixels, as functions of (n, 6): corner, directions, log of the blurs.

    The levels of white and black, six numbers a corner in which the image is linear, are eliminated in every step.
    """

    def __init__(self, d: Array, mask: np.ndarray, inverse: Array, windows: Windows) -> None:
        spacing = 1 / np.linalg.norm(inverse, axis=2)  # [px] a square, perpendicular to the edges
        # turned so that black is where both distances have the same sign
        self.normals = inverse * (spacing * np.stack([np.ones(len(d)), windows.dark], axis=1))[..., None]
        self.correlation = np.clip(np.sum(self.normals[:, 0] * self.normals[:, 1], axis=1), -0.95, 0.95)
        self.gap = windows.gap * spacing
        self.d, self.mask = d, mask
        self.planes = np.concatenate([np.ones((*d.shape[:2], 1)), d / RADIUS], axis=-1)

    def step(self, p: Array, values: Array) -> Array:
        """Gauss-Newton steps (n, 6)."""
        _, columns, residual = self._linearised(p, values)
        return self._solved(columns, residual)[0]

    def quality(self, p: Array, values: Array) -> tuple[Array, Array, Array]:
        """Variance (n,) of the residuals, covariance (n, 2, 2) of the corner per unit of it, contrast (n,)."""
        levels, columns, residual = self._linearised(p, values)
        covariance = self._solved(columns, residual)[1][:, :2, :2]
        freedom = np.maximum(self.mask.sum(axis=1) - 12, 1)
        return np.sum(residual**2, axis=1) / freedom, covariance, levels[:, 0] - levels[:, 3]

    def _linearised(self, p: Array, values: Array) -> tuple[Array, Array, Array]:
        """Best levels (n, 6), derivatives (n, P, 6) without what levels explain, and residuals (n, P)."""
        black, by_p = self._black(p)
        basis = np.concatenate(
            [self.planes * (1 - black)[..., None], self.planes * black[..., None]], axis=-1
        )
        basis *= self.mask[..., None]
        normal = np.swapaxes(basis, 1, 2) @ basis + 1e-6 * np.eye(6)
        levels = np.linalg.solve(normal, np.swapaxes(basis, 1, 2) @ values[..., None])
        residual = (values - (basis @ levels)[..., 0]) * self.mask
        contrast = (self.planes @ (levels[:, 3:] - levels[:, :3]))[..., 0] * self.mask
        columns = by_p * contrast[..., None]
        columns = columns - basis @ np.linalg.solve(normal, np.swapaxes(basis, 1, 2) @ columns)
        return levels[..., 0], columns, residual

    def _solved(self, columns: Array, residual: Array) -> tuple[Array, Array]:
        """Steps (n, 6) and inverses (n, 6, 6) of the normal matrices."""
        normal = np.swapaxes(columns, 1, 2) @ columns
        scale = np.sqrt(np.einsum("nii->ni", normal)) + 1e-9
        inverse = np.linalg.inv(normal / (scale[:, :, None] * scale[:, None]) + 1e-9 * np.eye(6))
        inverse /= scale[:, :, None] * scale[:, None]
        return (inverse @ np.swapaxes(columns, 1, 2) @ residual[..., None])[..., 0], inverse

    def _black(self, p: Array) -> tuple[Array, Array]:
        """Black share (n, P) of what each pixel sees, and its derivatives (n, P, 6)."""
        away = self.d - p[:, None, :2]
        along = np.stack([-self.normals[..., 1], self.normals[..., 0]], axis=-1)
        cosine, sine = np.cos(p[:, 2:4, None]), np.sin(p[:, 2:4, None])
        normals, along = cosine * self.normals + sine * along, cosine * along - sine * self.normals
        sigma = np.exp(p[:, None, 4:])
        z, turn = away @ np.swapaxes(normals, 1, 2) / sigma, away @ np.swapaxes(along, 1, 2) / sigma
        gap, rho = self.gap[:, None] / sigma, self.correlation[:, None]
        both, by_both = orthant(z, rho)
        black = 1 - ndtr(z[..., 0]) - ndtr(z[..., 1]) + 2 * both
        by_z = 2 * by_both - np.exp(-0.5 * z**2) / np.sqrt(2 * np.pi)
        by_sigma = -z * by_z
        for side in (np.array([1.0, -1.0]), np.array([-1.0, 1.0])):
            beyond = side * z - gap
            marker, by_marker = orthant(beyond, -rho)
            black = black + marker
            by_z = by_z + side * by_marker
            by_sigma = by_sigma - beyond * by_marker
        by_corner = -(by_z / sigma) @ normals
        return black, np.concatenate([by_corner, by_z * turn, by_sigma], axis=-1)


def orthant(z: Array, rho: Array) -> tuple[Array, Array]:
    """P(x < z0, y < z1) (...) for normal x, y of correlation rho (...), and its derivatives (..., 2) by z (..., 2).

    Plackett's integral over the correlation, r = sin t (Genz 2004, Stat. Comput. 14:251), by Gauss and Legendre.
    """
    h, k = z[..., 0], z[..., 1]
    value = ndtr(h) * ndtr(k)
    near = np.maximum(np.abs(h), np.abs(k)) < FAR
    h, k, top = h[near], k[near], np.broadcast_to(np.arcsin(rho), value.shape)[near]
    total = np.zeros(len(h))
    for node, weight in zip(0.5 * (NODES + 1), 0.5 * WEIGHTS, strict=True):
        sine = np.sin(node * top)
        total += weight * np.exp(-0.5 * (h * h - 2 * h * k * sine + k * k) / (1 - sine * sine))
    value[near] += total * top / (2 * np.pi)
    density = np.exp(-0.5 * z**2) / np.sqrt(2 * np.pi)
    other = (z[..., ::-1] - rho[..., None] * z) / np.sqrt(1 - rho[..., None] ** 2)
    return value, density * ndtr(other)
