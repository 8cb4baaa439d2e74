"""Which sections are fixed: `estimator.references.bootstrap` for the few dozen tracks of a step.

It is the same search, with each feature as likely fixed as not and errors that do not repeat along contours. What poses have in
common is kept as a covariance of radii: radii R with covariance C + diag(own), of which those at f are held at zero, are

    R - C_f Q R_f,   own + diag(C - C_f Q C_f'),   Q = inv(C_ff + diag(own_f)),

and one of those at f, given the others, is (Q R_f)_i / Q_ii with the variance 1 / Q_ii.

All radii of a limb of one curvature may be zero as well, in other poses: what sections of one contour say of each other tells
little, so that a contour counts as MOST independent sections where features are tried.
"""

import math

import numpy as np
from numpy.typing import NDArray

from extremal.estimator.camera import Array
from extremal.estimator.references import BROAD, CERTAIN, FALSE, ROUNDS, TRIALS
from extremal.tasks.compiled import compiled

NEIGHBOURS = 2  # on either side along a contour, whose odds are pooled
MOST_ODDS = 30.0
MOST = 3.0  # independent sections as which a contour counts, at most
FIXED, FREE = -0.5 * math.log(2 * math.pi), -math.log(math.pi)  # of the logarithms of the densities, constant

Flags = NDArray[np.bool_]
Numbers = NDArray[np.integer]


@compiled
def references(radius: Array, own: Array, shared: Array, contour: Numbers) -> Flags:
    """Which (n,) sections are fixed, of radii (n,) [m] with variances own (n,) [m^2] of their own, infinite of those left out, and
    the covariances shared shared' (n, U); contour: (n,) of each, in order along it."""
    fixed = np.zeros(len(radius), np.bool_)
    rows = np.flatnonzero(np.isfinite(own))
    if len(rows):
        part = shared[rows]
        fixed[rows] = _found(radius[rows], own[rows], part @ part.T, contour[rows])
    return fixed


@compiled
def _found(radius: Array, own: Array, common: Array, contour: Numbers) -> Flags:
    trials = _trials(own, contour)
    scores = _scores(trials, radius, own, common, _weights(contour))
    fixed = np.zeros(len(radius), np.bool_)
    fixed[trials[np.argmax(scores)]] = True
    for _ in range(ROUNDS):
        mean, variance = _given(fixed, radius, own, common)
        chosen = _discoveries(_probability(mean, variance, contour))
        if np.sum(fixed) == 1:  # which can't be judged by itself: it stays while others join it, or do not
            chosen |= fixed
        settled = np.all(chosen == fixed)
        fixed = chosen
        if settled or not np.any(fixed):
            break
    if np.sum(fixed) <= 1:  # no pair
        return np.zeros(len(fixed), np.bool_)
    mean, variance = _given(fixed, radius, own, common)
    # a rival: a feature that can't be fixed if these are, and explains the radii nearly as well
    enough = np.max(scores) - CERTAIN
    for t in range(len(trials)):
        i = trials[t]
        if not fixed[i] and mean[i] ** 2 > 16 * variance[i] and scores[t] > enough:
            return np.zeros(len(fixed), np.bool_)
    return fixed


@compiled
def _trials(own: Array, contour: Numbers) -> Numbers:
    """The best known features, spread over the contours: the best of each contour first."""
    n, keys = len(own), np.zeros(len(own), np.int64)
    most = np.max(contour) + 1
    for i in range(n):
        for j in range(n):
            if contour[j] == contour[i] and (own[j] < own[i] or (own[j] == own[i] and j < i)):
                keys[i] += most
        keys[i] += contour[i]
    return np.argsort(keys)[:TRIALS]


@compiled
def _weights(contour: Numbers) -> Array:
    """Independent sections (n,) as which each counts."""
    out = np.empty(len(contour))
    for i in range(len(contour)):
        out[i] = min(1.0, MOST / np.sum(contour == contour[i]))
    return out


@compiled
def _scores(trials: Numbers, radius: Array, own: Array, common: Array, weights: Array) -> Array:
    """Log likelihood (T,) of all radii if the feature of each of the trials (T,) is fixed."""
    out = np.zeros(len(trials))
    for t in range(len(trials)):
        i = trials[t]
        total = own[i] + common[i, i]
        out[t] = math.log(0.5) - 0.5 * (radius[i] * radius[i] / total + math.log(total))
        for j in range(len(radius)):
            if j != i:
                gain = common[i, j] / total
                zero, free = _densities(
                    radius[j] - gain * radius[i], own[j] + common[j, j] - gain * common[i, j]
                )
                both = max(zero, free) + math.log1p(math.exp(-abs(zero - free)))
                out[t] += weights[j] * (math.log(0.5) + both)
    return out


@compiled
def _densities(mean: float, variance: float) -> tuple[float, float]:
    """Log of the density of the radius of a fixed feature and of any other."""
    square, wide2 = mean * mean, BROAD * BROAD + variance
    zero = FIXED - 0.5 * (square / variance + math.log(variance))
    return zero, FREE - 0.5 * math.log(wide2) - math.log1p(square / wide2)


@compiled
def _given(fixed: Flags, radius: Array, own: Array, common: Array) -> tuple[Array, Array]:
    """Mean and variance (n,) of every radius given that those of `fixed` are zero; of each of these given the others."""
    mean, variance, at = radius.copy(), own + np.diag(common), np.flatnonzero(fixed)
    if len(at) == 0:
        return mean, variance
    across = np.ascontiguousarray(common[:, at])
    Q = np.linalg.inv(across[at] + np.diag(own[at]))
    gain, m = across @ Q, 0
    for i in range(len(radius)):
        if fixed[i]:
            mean[i] = 0.0
            for k in range(len(at)):
                mean[i] += Q[m, k] * radius[at[k]] / Q[m, m]
            variance[i] = 1 / Q[m, m]
            m += 1
        else:
            told = 0.0
            for k in range(len(at)):
                mean[i] -= gain[i, k] * radius[at[k]]
                told += gain[i, k] * across[i, k]
            variance[i] = own[i] + max(common[i, i] - told, 0.0)
    return mean, variance


@compiled
def _probability(mean: Array, variance: Array, contour: Numbers) -> Array:
    """Probability (n,) that a feature is fixed: both its own radius and its neighbours' along the contour must say so."""
    n = len(mean)
    odds, out = np.empty(n), np.empty(n)
    for i in range(n):
        zero, free = _densities(mean[i], variance[i])
        odds[i] = min(max(zero - free, -MOST_ODDS), MOST_ODDS)
    for i in range(n):
        pooled = odds[i]
        for step in (-1, 1):
            for away in range(1, NEIGHBOURS + 1):
                j = i + step * away
                if not (0 <= j < n) or contour[j] != contour[i]:
                    break
                pooled += odds[j]
        out[i] = 1 / (1 + math.exp(-min(odds[i], pooled)))
    return out


@compiled
def _discoveries(probability: Array) -> Flags:
    """The most probable features, each fixed rather than not, whose mean probability of being no fixed ones is below FALSE."""
    chosen, false, count = np.zeros(len(probability), np.bool_), 0.0, 0
    for i in np.argsort(-probability, kind="mergesort"):
        false, count = false + 1 - probability[i], count + 1
        if false > FALSE * count:
            break
        chosen[i] = probability[i] > 0.5
    return chosen
