"""How wrong corners and robot poses are: blunders, and factors on the standard deviations of the rest.

The factors maximise the likelihood restricted to what the fit leaves over (REML: H. D. Patterson and R. Thompson, "Recovery of
inter-block information when block sizes are unequal", Biometrika 58, 1971).
"""

import numpy as np
from numpy.linalg import norm
from scipy.optimize import minimize
from scipy.stats import chi2
from scipy.stats import norm as normal_distribution

from extremal.estimator.calibration_equations import Linearised, Sightings
from extremal.estimator.camera import Array
from extremal.estimator.errors import DegenerateGeometry, NotConverged

FAR = 5.0  # standard deviations, beyond which a corner or a view's pose is a blunder
STEADY = 0.01  # relative change of factors that does not matter
LARGEST_FACTOR = 1e3
GUESS = np.log(10)  # prior sd of the logarithm of a view's factor: what is stated of a robot is about right
HOPELESS = 1e12  # misfit of factors with which the views determine nothing
WIDEST = 2.0  # a factor that few views leave open is raised by no more than this


def find_blunders(here: Linearised, sightings: Sightings, seen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corners (V, N) that are blunders, and views (V,) whose robot pose is one or that lost most of the corners `seen` (V,).

    A wrong corner pulls at its view's pose and at its neighbours, a wrong pose at the view's corners and at other views: in
    every view only the worst of both is blamed, of corners or views only those half as far as the worst; others may follow.
    """
    corners = norm(np.einsum("vnij,vnj->vni", sightings.whitening, here.residuals), axis=2)
    corners /= max(1.0, _sigma(corners[sightings.used], 2))
    poses = np.where(sightings.views, norm(here.state.z, axis=1), 0.0)
    own = here.root.shape[2]
    if own:
        poses /= max(1.0, _sigma(poses[sightings.views], own)) * _limit(own) / FAR
    worst = corners.max(axis=1)
    wrong = (poses > FAR) & (poses > worst) & (poses > 0.5 * poses.max())
    far = (corners > FAR) & (corners > poses[:, None]) & (corners > 0.5 * worst[:, None])
    wrong |= 2 * np.sum(sightings.used & ~far, axis=1) < seen
    return far | (wrong[:, None] & sightings.used), wrong


def _sigma(distances: Array, freedom: int) -> float:
    """What the median of distances of `freedom` dimensions says of their standard deviation."""
    return float(np.median(distances) / np.sqrt(chi2.median(freedom)))


def _limit(freedom: int) -> float:
    """Distance in `freedom` dimensions that is as rare as `FAR` in one."""
    return float(np.sqrt(chi2.isf(2 * normal_distribution.sf(FAR), freedom)))


def likely_scales(here: Linearised, sightings: Sightings, scales: Array, smaller: bool) -> Array:
    """Factors (3,) on the standard deviations of corners, and of translations and rotations of single views.

    Few views leave these factors open themselves: their variances enter by the mean that they have in the posterior.
    """
    base, numbers = here.with_own_at_zero(scales), 2 * sightings.used.sum()

    def misfit(logarithms: Array) -> float:
        factors = np.exp(logarithms)
        normal = base.normal(factors)
        try:
            spread = normal.log_determinant + 2 * numbers * logarithms[0]
        except DegenerateGeometry:  # a robot this bad would tell nothing: the search turns back
            return HOPELESS
        prior = np.sum((logarithms[1:] / GUESS) ** 2)
        return base.cost(factors[0]) - normal.decrease + spread + prior

    most = np.log(LARGEST_FACTOR)
    own = (-most if smaller else 0.0, most) if here.root.shape[2] else (0.0, 0.0)
    found = minimize(
        misfit, np.log(scales), method="L-BFGS-B", bounds=[(0.0, most), own, own], options={"eps": 1e-4}
    ).x
    if not np.all(np.isfinite(found)):
        raise NotConverged("no standard deviations of corners and robot explain what the images show")
    steps = 0.1 * np.eye(3)
    curvature = np.array([misfit(found + h) + misfit(found - h) - 2 * misfit(found) for h in steps]) / 0.1**2
    curvature = np.maximum(curvature, 2 / np.log(WIDEST))
    free = (found > own[0] + STEADY) & (np.arange(3) > 0)  # corners are many
    return np.exp(found + np.where(free, 2 / curvature, 0.0))
