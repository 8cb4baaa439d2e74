"""Bootstrapped references: which features are fixed, when none is known to be (Cipolla ch. 3, sec. 3.5.1).

Where poses are uncertain, radii of curvature have large errors, but nearly the same ones: R_j = true + shared_j . x + own
error, x ~ N(0, I) common to all. If one feature is fixed, that its R is zero tells of x, and so of all others: pairs of
fixed features have zero relative R. Each feature in turn is tried as the first reference; the trial that makes the
radii as a whole most probable is the one to believe, unless a rival that contradicts it is nearly as probable. Then all
that are found fixed serve as references together, with the expected share of false ones among them held below a bound
(the local false discovery rate; Efron, *Large-Scale Inference*, 2010, ch. 5).

Points of one contour have like labels, and edges of theirs that were localised together have like errors: likelihoods
are pooled along contours and count as much as the number of independent ones among them.
"""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.linalg.lapack import dpotrf, dtrtrs  # pyright: ignore[reportAttributeAccessIssue]

from extremal.estimator.camera import Array
from extremal.estimator.errors import InvalidInput
from extremal.estimator.pooling import sum_between, windows

BROAD = 0.08  # [m] scale of the radii of extremal boundaries, a Cauchy density: any size may come
FALSE = 0.05  # share of false references that is accepted
CERTAIN = 5.0  # log odds between the best explanation and the next that contradicts it
TRIALS = 96  # features that are tried as the first reference
ROUNDS = 12


@dataclass(frozen=True, eq=False)
class References:
    """Which of n features are fixed, by their radii relative to each other.

    Attributes:
        fixed: (n,) the references; none where no explanation stands out.
        probability: (n,) that a feature is fixed.
        radius, sigma_radius: (n,) [m] given the references; of a reference itself, given the others.
    """

    fixed: np.ndarray
    probability: Array
    radius: Array
    sigma_radius: Array


def bootstrap(
    radius: Array,
    own_variance: Array,
    shared: Array,
    contour: np.ndarray,
    prior: Array | float = 0.5,
    overlap: float = 1.0,
    most: float = np.inf,
) -> References:
    """Find the fixed features among n, given radii of curvature with their joint covariance.

    Args:
        radius: (n,) [m]. own_variance: (n,) [m^2] of each alone, shared: (n, U): features i and j have the covariance
            shared_i . shared_j (`adjustment.Shapes`). Rows of infinite variance are left out.
        contour: (n,) the contour of each feature, in order along it (a contour of its own for a point).
        prior: (n,) probability of being fixed, from what else is known.
        overlap: number of neighbours along a contour that repeat each other's errors.
        most: independent features as which a contour counts, at most, where features are tried. All radii of a limb of one
            curvature may be zero as well, in other poses, so that its features tell little of each other.

    Raises InvalidInput for shapes that do not fit, known rows of numbers that are not finite or of no variance, and overlap or
    most below 1.
    """
    n = len(radius)
    if own_variance.shape != (n,) or shared.shape[:1] != (n,) or shared.ndim != 2 or contour.shape != (n,):
        raise InvalidInput(
            f"radius {radius.shape}, own_variance {own_variance.shape}, shared {shared.shape} and contour {contour.shape} "
            "do not fit; accepted: (n,), (n,), (n, any), (n,)"
        )
    known, prior = np.isfinite(own_variance), np.broadcast_to(np.asarray(prior, float), (n,))
    _check(radius[known], own_variance[known], shared[known], prior[known], overlap, most)
    problem = _Problem(
        radius[known],
        own_variance[known],
        shared[known],
        contour[known],
        np.clip(prior[known], 0.01, 0.99),
        overlap,
        most,
    )
    fixed, probability = np.zeros(n, bool), np.zeros(n)
    best, spread = radius.copy(), np.full(n, np.inf)
    if known.any():
        fixed[known], probability[known], best[known], spread[known] = problem.solve()
    return References(fixed, probability, best, spread)


def _check(radius: Array, own: Array, shared: Array, prior: Array, overlap: float, most: float) -> None:
    if not np.all(own > 0):
        raise InvalidInput(
            f"own_variance holds {own.min()}; accepted: positive numbers [m^2], infinite ones to leave out"
        )
    with np.errstate(over="ignore"):
        squares = radius**2 / own + np.sum(shared**2, axis=1) + prior
    if not np.all(np.isfinite(squares)):
        raise InvalidInput("radius, shared or prior hold a number that is not finite, or whose square is not")
    if not 1 <= overlap < np.inf:
        raise InvalidInput(f"overlap is {overlap!r}; accepted: a number from 1")
    if not most >= 1:
        raise InvalidInput(f"most is {most!r}; accepted: a number from 1")


@dataclass(frozen=True, eq=False)
class _Problem:
    radius: Array
    own: Array
    shared: Array
    contour: np.ndarray
    prior: Array
    overlap: float
    most: float
    known: dict[bytes, tuple[Array, Array, Array]] = field(default_factory=dict)  # what was judged

    def solve(self) -> tuple[np.ndarray, Array, Array, Array]:
        trials = self.trials()
        scores = self.scores(trials)
        fixed = np.zeros(len(self.radius), bool)
        fixed[trials[np.argmax(scores)]] = True
        for _ in range(ROUNDS):
            chosen = _discoveries(self.judged(fixed)[2])
            if fixed.sum() == 1:  # which can't be judged by itself: it stays while others join it, or do not
                chosen |= fixed
            if np.array_equal(chosen, fixed) or not chosen.any():
                fixed = chosen
                break
            fixed = chosen
        if fixed.sum() == 1:  # no pair
            fixed = np.zeros(len(fixed), bool)
        mean, variance, _ = self.judged(fixed)
        # a rival: a feature that can't be fixed if these are, and explains the radii nearly as well
        against = ~fixed[trials] & (mean[trials] ** 2 > 16 * variance[trials])
        if fixed.any() and np.max(scores[against], initial=-np.inf) > scores.max() - CERTAIN:
            fixed = np.zeros(len(fixed), bool)
        mean, variance, probability = self.judged(fixed)
        return fixed, probability, mean, np.sqrt(variance)

    def judged(self, fixed: np.ndarray) -> tuple[Array, Array, Array]:
        """Mean, variance and probability of being fixed (n,) of every radius, given that those of `fixed` are zero."""
        key = fixed.tobytes()  # rounds come back to the same ones
        if key not in self.known:
            mean, variance = self.given(fixed)
            self.known[key] = mean, variance, self.probability(mean, variance)
        return self.known[key]

    def trials(self) -> np.ndarray:
        """The best known features, spread over the contours."""
        order = np.lexsort((self.own, self.contour))
        first = np.searchsorted(self.contour[order], self.contour[order])
        rank = np.arange(len(order)) - first  # within its contour, the best known first
        return order[np.argsort(rank, kind="stable")][:TRIALS]

    @cached_property
    def total(self) -> Array:
        """Variance (n,) of every radius."""
        return self.own + np.sum(self.shared**2, axis=1)

    @cached_property
    def log_prior(self) -> tuple[Array, Array]:
        """Log of the prior of being fixed, and of not being so, (n,) each, less log(2 pi) / 2 and log(pi)."""
        return np.log(self.prior) - 0.5 * np.log(2 * np.pi), np.log1p(-self.prior) - np.log(np.pi)

    @cached_property
    def neighbours(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows (n,) that are pooled with each: the first, and that after the last."""
        return windows(self.contour, round(2 * self.overlap))

    def scores(self, trials: np.ndarray) -> Array:
        """Log likelihood (T,) of all radii if the feature of each of the trials (T,) is fixed."""
        radius, total = self.radius[trials], self.total
        common = self.shared[trials] @ self.shared.T
        gain = common / total[trials, None]
        others = np.logaddexp(*self.densities(self.radius - gain * radius[:, None], total - gain * common))
        others[np.arange(len(trials)), trials] = 0.0
        own = np.log(self.prior[trials]) - 0.5 * radius**2 / total[trials] - 0.5 * np.log(total[trials])
        return others @ self.weight + own

    @cached_property
    def weight(self) -> Array:
        """Independent features (n,) as which each counts."""
        _, which, count = np.unique(self.contour, return_inverse=True, return_counts=True)
        return 1 / np.maximum(self.overlap, count / self.most)[which]

    def densities(self, mean: Array, variance: Array) -> tuple[Array, Array]:
        """Log of prior times density (..., n) of the radius of a fixed feature and of any other."""
        square, (fixed, free) = mean**2, self.log_prior
        wide2 = BROAD**2 + variance
        zero = fixed - 0.5 * (square / variance + np.log(variance))
        return zero, free - 0.5 * np.log(wide2) - np.log1p(square / wide2)

    def probability(self, mean: Array, variance: Array) -> Array:
        """Probability (n,) that a feature is fixed: both its own radius and its neighbours' along the contour must say so."""
        zero, free = self.densities(mean, variance)
        odds = np.clip(zero - free, -30.0, 30.0)
        first, last = self.neighbours
        pooled = sum_between(odds, first, last) / np.minimum(self.overlap, last - first)
        return 1 / (1 + np.exp(-np.minimum(odds, pooled)))

    def given(self, fixed: np.ndarray) -> tuple[Array, Array]:
        """Mean and variance (n,) of every radius given that those of `fixed` are zero; of each of these given the others."""
        if not fixed.any() or not self.shared.size:
            return self.radius, self.total
        F, own = self.shared[fixed], self.own[fixed] * self.overlap
        information = np.eye(F.shape[1]) + (F / own[:, None]).T @ F
        # with L L' the information on x, of covariance inv(L)' inv(L)
        told = dtrtrs(dpotrf(information, lower=1)[0], self.shared.T, lower=1)[0]
        mean = self.radius - told.T @ (told[:, fixed] @ (self.radius[fixed] / own))
        spread = np.vecdot(told.T, told.T)
        # leave one out: with leverage a = spread / own, residual and variance grow by 1 / (1 - a)
        leverage = np.where(fixed, 1 - spread / (self.own * self.overlap), 1.0)
        return mean / leverage, self.own + np.where(fixed, spread / leverage, spread)


def _discoveries(probability: Array) -> np.ndarray:
    """The most probable features, each fixed rather than not, whose mean probability of being no fixed ones is below FALSE."""
    order = np.argsort(-probability, kind="stable")
    share = np.cumsum(1 - probability[order]) / np.arange(1, len(order) + 1)
    count = int(np.searchsorted(share, FALSE, side="right"))  # non-decreasing
    chosen = np.zeros(len(probability), bool)
    chosen[order[:count]] = True
    return chosen & (probability > 0.5)
