"""Scores of episodes and their uncertainty."""

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import binomtest

from extremal.estimator.errors import InvalidInput
from extremal.scenes.curves import Array
from extremal.scenes.surface import Surface

SPACING = 5e-4  # [m] between the points of a travelled path at which its clearance is measured


def travelled_length(points: ArrayLike) -> float:
    """Length [m] of a polyline (n, 3)."""
    return float(np.sum(np.linalg.norm(np.diff(np.asarray(points, float), axis=0), axis=1)))


def spl(success: ArrayLike, length: ArrayLike, shortest: ArrayLike) -> Array:
    """Success weighted by path length, an episode each: S L* / max(L, L*) (Anderson et al. 2018, eq. 1).

    Its mean over episodes is their SPL (arXiv:1807.06757).

    Args:
        success: (...) bool.
        length: (...) [m] travelled, L.
        shortest: (...) [m] positive, L*.
    """
    s, travelled, best = np.asarray(success, float), np.asarray(length, float), np.asarray(shortest, float)
    _positive("shortest", best)
    return s * best / np.maximum(travelled, best)


def path_ratio(length: ArrayLike, shortest: ArrayLike) -> Array:
    """L / L* (...). Below 1 the clearance was violated (or the goal not reached): report both."""
    best = np.asarray(shortest, float)
    _positive("shortest", best)
    return np.asarray(length, float) / best


def regret(length: ArrayLike, shortest: ArrayLike, straight: ArrayLike) -> Array:
    """(L - L*) / (L* - |AB|) (...): excess length over the detour that is needed; NaN where none is needed."""
    travelled, best, free = (np.asarray(v, float) for v in (length, shortest, straight))
    detour = best - free
    needed = detour > 1e-9
    return np.where(needed, (travelled - best) / np.where(needed, detour, 1.0), np.nan)


def smallest_clearance(surface: Surface, points: ArrayLike, radius: float) -> float:
    """Smallest distance [m] from a sphere that travels along a polyline (n, 3) to a surface; < 0 is contact.

    Measured every 0.5 mm and at the vertices, so no more than 0.25 mm too large, and next to nothing where
    the sphere passes by.

    Args:
        surface: the obstacle.
        points: (n, 3) [m] of the sphere's centre, n >= 1.
        radius: [m] of the sphere.
    """
    p = np.asarray(points, float)
    if p.ndim != 2 or p.shape[1] != 3 or len(p) < 1 or not np.all(np.isfinite(p)):
        raise InvalidInput(f"points are {p.shape}; accepted: (n, 3) finite numbers, n >= 1")
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(p, axis=0), axis=1))])
    at = np.union1d(s, np.linspace(0, s[-1], int(np.ceil(s[-1] / SPACING)) + 1))
    dense = np.stack([np.interp(at, s, x) for x in p.T], axis=1)
    return float(np.min(surface.signed_distance(dense))) - radius


def violation_mm(smallest: ArrayLike, wanted: float) -> Array:
    """By how much (...) [mm] a smallest clearance [m] falls short of the wanted one [m]; 0 where it doesn't."""
    return 1e3 * np.maximum(wanted - np.asarray(smallest, float), 0.0)


def normalised_score(score: ArrayLike, random: float, oracle: float) -> Array:
    """(score - random) / (oracle - random) (...): 0 for the random policy, 1 for the one that knows the truth.

    Raises:
        InvalidInput: the two references are equal, so that there is nothing to discriminate.
    """
    if not abs(oracle - random) > 1e-12:
        raise InvalidInput(f"random scores {random!r} and oracle {oracle!r}; accepted: different scores")
    return (np.asarray(score, float) - random) / (oracle - random)


def bootstrap_interval(
    values: ArrayLike, rng: np.random.Generator, confidence: float = 0.95, resamples: int = 2000
) -> tuple[float, float]:
    """Percentile bootstrap interval of the mean of values (n,) (Efron and Tibshirani 1993, sec. 13.3).

    Args:
        values: one an episode, finite, n >= 1.
        rng: source of the resamples.
        confidence: between 0 and 1.
        resamples: number of them.
    """
    v = np.asarray(values, float)
    if v.ndim != 1 or len(v) < 1 or not np.all(np.isfinite(v)):
        raise InvalidInput(f"values are {v.shape}; accepted: (n,) finite numbers, n >= 1")
    _confidence(confidence)
    means = v[rng.integers(len(v), size=(resamples, len(v)))].mean(axis=1)
    low, high = np.quantile(means, [(1 - confidence) / 2, (1 + confidence) / 2])
    return float(low), float(high)


def wilson_interval(successes: int, episodes: int, confidence: float = 0.95) -> tuple[float, float]:
    """Wilson's score interval of a rate (Wilson 1927): sensible at 0 and 1 too.

    Args:
        successes: from 0 to `episodes`.
        episodes: at least 1.
        confidence: between 0 and 1.
    """
    if not 0 <= successes <= episodes or episodes < 1:
        raise InvalidInput(
            f"{successes!r} successes of {episodes!r}; accepted: 0 to all of 1 or more episodes"
        )
    _confidence(confidence)
    interval = binomtest(int(successes), int(episodes)).proportion_ci(confidence, method="wilson")
    return float(interval.low), float(interval.high)


def _confidence(value: float) -> None:
    if not 0 < value < 1:
        raise InvalidInput(f"confidence is {value!r}; accepted: between 0 and 1")


def _positive(name: str, values: Array) -> None:
    if not np.all((values > 0) & np.isfinite(values)):
        raise InvalidInput(f"{name} is {values.tolist()}; accepted: positive lengths [m]")
