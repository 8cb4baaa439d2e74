"""Where is the edge in an intensity profile across it? A bank of edge models, each blurred by the known point spread.

Towards an extremal boundary the surface turns away, so that its intensity follows the square root of the distance s
inside the contour: I(s) = a + b sqrt(s) + c s. A fixed feature has no such term. Every model is linear
but for the edge's offset e, so that for e on a grid the best fit is a projection, the same for all profiles:
chi2(e) = |y|^2 - |Q(e)' y|^2 (variable projection; Golub and Pereyra 1973). Which model holds is decided by evidence
pooled along the contour, and what that leaves open widens sigma.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.special import ndtr

from extremal.estimator.camera import Array
from extremal.estimator.pooling import window_sum

HALF_WIDTH = 7  # [px] samples on each side of the expected edge
RANGE, STEP = 1.75, 0.125  # [px] grid of the offset e
POOLED = 15  # windows over which evidence for a model is summed
PIXEL_VARIANCE = 1 / 12  # [px^2] of the square pixel, along any direction
CAUTION = 2.5  # standard deviations of evidence that an additional parameter has to bring
WIDE = 0.2  # [px] above this sigma the posterior over e is taken as it is, not as a Gaussian

Values = np.ndarray


@dataclass(frozen=True)
class Model:
    """Columns of one edge model: levels on both sides, slope outside, powers of sqrt(s) inside, its side."""

    powers: tuple[int, ...]  # of sqrt(s) inside: 1 is the limb, 2 a slope
    slope_outside: bool
    side: int  # +1: inside lies at positive offsets

    @property
    def limb(self) -> bool:
        return 1 in self.powers

    @property
    def parameters(self) -> int:
        return 3 + len(self.powers) + self.slope_outside


MODELS = (
    Model((), False, 1),
    Model((2,), True, 1),
    *(Model((1, 2), slope, side) for slope in (False, True) for side in (1, -1)),
)
COLUMNS = max(m.parameters for m in MODELS) - 1


@dataclass(frozen=True, eq=False)
class ProfileFit:
    """Edges of n profiles: offset (n,) and sigma (n,) [px] along the profile; ambiguity (n,) [px], that part of the error
    which neighbours share; contrast (n,) [grey levels] from negative to positive offsets; limb (n,) evidence, from -1
    (shaded limb on the negative side) over 0 (none) to 1."""

    offset: Array
    sigma: Array
    ambiguity: Array
    contrast: Array
    limb: Array


def offsets() -> Array:
    """Sampling offsets (K,) [px] of a profile."""
    return np.arange(-HALF_WIDTH, HALF_WIDTH + 1.0)


def blurred_power(s: Array, power: int, spread: float) -> Array:
    """max(s, 0)^(power / 2) blurred by a Gaussian of standard deviation `spread` [px]."""
    if power == 0:
        return ndtr(s / spread)
    if power == 2:
        return s * ndtr(s / spread) + spread * np.exp(-0.5 * (s / spread) ** 2) / np.sqrt(2 * np.pi)
    nodes, weights = np.polynomial.legendre.leggauss(96)
    top = np.sqrt(np.maximum(s + 7 * spread, 0))[..., None]  # integrate over r = sqrt(t): smooth at t = 0
    r = 0.5 * top * (nodes + 1)
    kernel = np.exp(-0.5 * ((s[..., None] - r**2) / spread) ** 2) / (np.sqrt(2 * np.pi) * spread)
    return np.sum(weights * kernel * r**power * 2 * r, axis=-1) * 0.5 * top[..., 0]


def _columns(model: Model, at: Array, spread: float) -> Array:
    inside = [blurred_power(model.side * at, k, spread) for k in model.powers]
    outside = [blurred_power(-model.side * at, 2, spread)] if model.slope_outside else []
    return np.stack([np.ones_like(at), blurred_power(at, 0, spread), *inside, *outside], axis=-1)


@lru_cache(maxsize=16)
def _bank(blur: float, half_width: int, models: tuple[Model, ...]) -> tuple[Values, Values]:
    """Grid (E,) of offsets and orthonormal bases (K, M * E * COLUMNS), zero beyond half_width."""
    spread = float(np.sqrt(blur**2 + PIXEL_VARIANCE))
    grid = np.arange(-RANGE, RANGE + STEP / 2, STEP)
    s = offsets()
    used = np.abs(s) <= half_width
    bank = np.zeros((len(s), len(models), len(grid), COLUMNS), np.float32)
    for i, model in enumerate(models):
        q, _ = np.linalg.qr(_columns(model, s[used] - grid[:, None], spread))
        bank[used, i, :, : q.shape[-1]] = np.moveaxis(q, 1, 0)
    return grid, bank.reshape(len(s), -1)


def fit_profiles(
    profiles: Array, noise: float, rows: int, blur: float, chains: np.ndarray, clear: np.ndarray | None = None
) -> ProfileFit:
    """Edges in profiles (n, K), each the mean of `rows` independent lines across a contour.

    Args:
        profiles: (n, K) intensities at `offsets()`, ordered along the contours.
        noise: standard deviation of a pixel [grey levels].
        rows: lines averaged in a profile.
        blur: optical point spread [px].
        chains: (n,) contour of each profile, non-decreasing: evidence is not pooled across contours.
        clear: (n,) distance [px] to the nearest other edge across the contour, where one is near.
    """
    variance = noise**2 / rows
    y = (profiles - profiles.mean(axis=1, keepdims=True)).astype(np.float32)
    fit = _fit_windows([(y, HALF_WIDTH, chains)], variance, blur, MODELS)
    values, misfit = fit.values, fit.misfit
    # what spoils the wide window may lie outside a narrow one
    spoilt = np.flatnonzero(misfit > 1.5)
    if len(spoilt):
        narrow = _fit_windows([(y[spoilt], HALF_WIDTH // 2 + 1, chains[spoilt])], variance, blur, MODELS)
        better = narrow.misfit * 1.5 + 0.5 < misfit[spoilt]
        values[spoilt[better]], misfit[spoilt[better]] = narrow.values[better], narrow.misfit[better]
    ambiguity = np.zeros(len(y))
    if clear is not None:
        # another edge beside this one looks much like the shading of a limb: a plain step in a window that ends before it
        # is the other reading, and the truth is taken to lie between the two
        width = np.clip(clear - 1.0, 2, HALF_WIDTH).astype(int)
        parts = [(half, np.flatnonzero(width == half)) for half in range(2, HALF_WIDTH)]
        parts = [(half, near) for half, near in parts if len(near)]
        if parts:
            near = np.concatenate([near for _, near in parts])
            windows = [(y[near], half, chains[near]) for half, near in parts]
            ambiguity[near] = _between(
                values, misfit, near, _fit_windows(windows, variance, blur, MODELS[:1])
            )
    offset, sigma, limb = values.T
    positive, negative = profiles[:, -5:-2].mean(axis=1), profiles[:, 2:5].mean(axis=1)
    return ProfileFit(offset, sigma * np.sqrt(np.maximum(misfit, 1.0)), ambiguity, positive - negative, limb)


def _between(values: Array, misfit: Array, near: np.ndarray, step: "_WindowFit") -> Array:
    """Put the mean of two readings into `values`; half their difference."""
    both = np.stack([values[near], step.values])
    only = np.isfinite(both[..., 1]).sum(axis=0) < 2  # one of them found no edge
    first = np.where(np.isfinite(both[0, :, 1:2]), both[0], both[1])
    with np.errstate(invalid="ignore"):
        values[near] = np.where(only[:, None], first, both.mean(axis=0))
        half = np.where(only, 0.0, 0.5 * np.abs(both[0, :, 0] - both[1, :, 0]))
    misfit[near] = np.minimum(misfit[near], step.misfit)
    return half


@dataclass(frozen=True, eq=False)
class _WindowFit:
    values: Array  # (n, 3): offset, sigma, limb
    misfit: Array  # (n,) chi2 per degree of freedom


def _fit_windows(
    windows: list[tuple[Values, int, np.ndarray]], variance: float, blur: float, models: tuple[Model, ...]
) -> _WindowFit:
    """Fits of profiles, half their width that is used, and their chains: each part by itself, one after the other."""
    grid = _bank(blur, HALF_WIDTH, models)[0]
    chi2 = np.concatenate([_chi2(y, variance, blur, half, models) for y, half, _ in windows])
    offset, sigma, lowest = _posterior(chi2.astype(float), grid)
    samples = np.repeat([2 * half + 1 for _, half, _ in windows], [len(y) for y, _, _ in windows])
    parameters = np.array([m.parameters for m in models])
    chains = np.concatenate([c for _, _, c in windows]) * (2 * HALF_WIDTH + 2) + samples
    total, neighbours = window_sum(np.minimum(lowest, 1e6), chains, POOLED // 2)
    pooled = total * (POOLED / neighbours)[:, None]
    # every window has parameters of its own: each takes 1 +- sqrt(2) off its chi2 even where there is nothing to fit
    evidence = pooled + parameters * (POOLED + CAUTION * np.sqrt(2 * POOLED))
    weight = np.exp(-0.5 * np.minimum(evidence - evidence.min(axis=1, keepdims=True), 60.0))
    weight[~np.isfinite(sigma)] = 0.0
    weight /= np.maximum(weight.sum(axis=1, keepdims=True), 1e-30)
    safe = np.where(np.isfinite(sigma), sigma, 0.0)
    mean = np.sum(weight * offset, axis=1)
    total = np.sum(weight * (safe**2 + (offset - mean[:, None]) ** 2), axis=1)
    sides = np.array([m.side * m.limb for m in models])
    best = np.argmax(weight, axis=1)
    freedom = samples - parameters[best]
    rows = np.arange(len(best))
    along, own = pooled[rows, best] / (POOLED * freedom), lowest[rows, best] / freedom
    misfit = np.maximum(along, own / (1 + 2.5 * np.sqrt(2 / freedom)))
    found = weight.sum(axis=1) > 0.5
    sigma_total = np.where(found, np.sqrt(total), np.inf)
    return _WindowFit(np.stack([mean, sigma_total, weight @ sides], axis=1), misfit)


def _chi2(y: Values, variance: float, blur: float, half_width: int, models: tuple[Model, ...]) -> Values:
    """chi2 (n, M, E) of profiles (n, K) within half_width, by the models and offsets on the grid."""
    grid, bank = _bank(blur, half_width, models)
    used = np.abs(offsets()) <= half_width
    y = y - y[:, used].mean(axis=1, keepdims=True)
    energy = np.sum(y[:, used] ** 2, axis=1)
    projected = (y @ bank).reshape(len(y), len(models), len(grid), COLUMNS)
    return (energy[:, None, None] - np.einsum("nmec,nmec->nme", projected, projected)) / variance


def _posterior(chi2: Array, grid: Array) -> tuple[Array, Array, Array]:
    """Mean, standard deviation and lowest chi2 of e for chi2 (n, M, E); sigma infinite where e leaves the grid."""
    best = np.argmin(chi2, axis=2)
    middle = np.clip(best, 1, len(grid) - 2)[..., None] + np.arange(-1, 2)
    left, centre, right = np.moveaxis(np.take_along_axis(chi2, middle, axis=2), 2, 0)
    bend = np.maximum(left - 2 * centre + right, 1e-12)
    step = grid[1] - grid[0]
    shift = np.clip(0.5 * (left - right) / bend, -1, 1)
    offset = grid[middle[..., 1]] + shift * step
    sigma = np.sqrt(2 / bend) * step
    lowest = centre - 0.25 * (left - right) * shift
    wide = sigma > WIDE
    if wide.any():
        weight = np.exp(-0.5 * np.clip(chi2[wide] - lowest[wide][:, None], 0.0, 80.0))
        weight /= weight.sum(axis=1, keepdims=True)
        mean = weight @ grid
        offset[wide] = mean
        sigma[wide] = np.sqrt(np.maximum(weight @ grid**2 - mean**2, step**2 / 12))
    sigma[(best == 0) | (best == len(grid) - 1)] = np.inf
    return offset, sigma, lowest
