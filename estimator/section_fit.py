"""Fits of parallel sections to edgels, with higher terms as large as the edgels themselves give evidence for.

A surface is no more than smooth: how fast its sections vary is not known beforehand. The terms K_i x^j / j! of order 3
and more have independent normal priors of standard deviation A i! j! / L^j, as for a surface whose shape changes over
the length L. All (A, L) of a grid are tried; the estimate is their mean weighed by evidence, and what they disagree about
is part of the covariance (MacKay, "Bayesian interpolation", 1992). A long arc hence needs no choice of an order.
"""

from dataclasses import dataclass, replace
from math import factorial

import numpy as np

from extremal.estimator.camera import Array
from extremal.estimator.parallel_sections import (
    HIGHEST,
    TERMS,
    Edgels,
    columns,
    feet,
    image_distance,
    in_section,
    jet,
    terms_up_to,
)

AMPLITUDES = 0.002 * 2.0 ** np.arange(5)  # [m] A
LENGTHS = 0.01 * 2.0 ** np.arange(5)  # [m] L
START = (0.016, 0.04)  # [m] A and L until the first fit is there
BROAD = np.array([1.0, 1.0, 10.0, 10.0, 100.0, 1e4])  # prior of height, depth, tilt, radius, skew, curvature
UNKNOWN = 0.1  # part of its broad prior above which a standard deviation means: not determined
OUTLIER = 6.0  # times the usual misfit beyond which an edgel is left out: its contour is another one
NARROW = 20.0  # noises of the edgels' positions [m]: spread along the contour below which it is but noise
LOW = 4  # order of the first fits
START_STEPS, STEPS, MORE_STEPS = 3, 5, 15  # of Gauss-Newton; the last only for rows that need them
SMALL_STEP = 0.05  # standard deviations of the fit: smaller steps end the iteration
EVIDENCE_AT = (0, 2, 4)  # steps at which A and L are chosen anew


@dataclass(frozen=True, eq=False)
class SectionFit:
    """Terms of order 0 to 2 (n, 6) as in `TERMS`, their covariance (n, 6, 6), and how well they were found.

    Attributes:
        terms, covariance: of height, depth, tilt, radius, skew and minus the contour's curvature.
        chi2, used: (n,) misfit of the edgels that were used, and their number.
        step: (n,) the last step, in standard deviations of the edgels' fit.
    """

    terms: Array
    covariance: Array
    chi2: Array
    used: np.ndarray
    step: Array


def fit_sections(edgels: Edgels, normals: Array) -> SectionFit:
    """Gauss-Newton on the signed image distance of edgels (n, M), from what the measured normals (n, M, 3) say."""
    edgels = replace(edgels, inverse_sigma=edgels.inverse_sigma.copy())
    phi, x, terms, open_terms = _by_normals(edgels, normals)
    start = _deviations(LOW, *START)
    for _ in range(START_STEPS):
        normal, right, _, _ = _linearised(terms, LOW, edgels, phi, x, open_terms)
        terms = _solve(normal, right, start)[0]
    terms = np.pad(terms, ((0, 0), (0, terms_up_to(HIGHEST) - terms.shape[1])))
    grid = np.array([_deviations(HIGHEST, a, length) for a in AMPLITUDES for length in LENGTHS])
    evidence = np.zeros((len(terms), len(grid)))
    for i in range(STEPS):
        linear = _linearised(terms, HIGHEST, edgels, phi, x, open_terms)
        if i in EVIDENCE_AT:
            evidence = np.stack([_log_evidence(linear[0], linear[1], d) for d in grid], axis=1)
        terms = _solve(linear[0], linear[1], grid[np.argmax(evidence, axis=1)])[0]
    step = np.full(len(terms), np.inf)
    for _ in range(MORE_STEPS):
        rows = np.flatnonzero(step > SMALL_STEP)
        some = Edgels(edgels.centres[rows], edgels.rays[rows], edgels.inverse_sigma[rows])
        normal, right, _, keep = _linearised(terms[rows], HIGHEST, some, phi[rows], x[rows], open_terms[rows])
        edgels.inverse_sigma[rows] *= (
            keep  # what is left out stays out, so that the iteration comes to an end
        )
        new = _solve(normal, right, grid[np.argmax(evidence[rows], axis=1)])[0]
        step[rows] = np.sqrt(np.einsum("ni,nij,nj->n", new - terms[rows], normal, new - terms[rows]))
        terms[rows] = new
        if np.all(step <= SMALL_STEP):
            break
    normal, right, chi2, keep = _linearised(terms, HIGHEST, edgels, phi, x, open_terms)
    weight = np.exp(evidence - evidence.max(axis=1, keepdims=True))
    mean, covariance = _averaged(normal, right, grid, weight / weight.sum(axis=1, keepdims=True))
    return SectionFit(mean, covariance, chi2, np.count_nonzero(keep, axis=1), step)


def _by_normals(edgels: Edgels, normals: Array) -> tuple[Array, Array, Array, Array]:
    """Where the iteration starts: (phi, x) (n, M) of edgels, terms up to LOW, and which terms (n, P) are open at all.

    Linear in the measured tangent planes. Terms in x are open where edgels lie farther apart along the contour than their
    noise makes them.
    """
    phi = np.arctan2(normals[..., 1], normals[..., 0])
    one, zero = np.ones_like(phi), np.zeros_like(phi)
    along, across = in_section(zero, one, zero, phi), in_section(one, zero, zero, phi)
    slope = np.sum(edgels.rays * along, axis=-1)
    slope = np.where(np.abs(slope) > 1e-3, slope, np.inf)
    prior, section = _deviations(LOW, *START), np.array([j == 0 for _, j in TERMS], float)
    depth, x, terms, spread = zero, zero, np.zeros((len(phi), terms_up_to(LOW))), np.zeros(len(phi))
    for _ in range(
        4
    ):  # depth along the rays, hence x, follows from the terms: at first from the section's alone
        distance = (depth - np.sum(edgels.centres * along, axis=-1)) / slope
        y = edgels.centres + distance[..., None] * edgels.rays
        x = y[..., 2]
        weight = edgels.inverse_sigma / np.maximum(np.abs(distance), 1e-3)
        open_terms = np.maximum(section, (spread > NARROW)[:, None])
        design = columns(phi, x, LOW) * weight[..., None] * open_terms[:, None, : terms.shape[1]]
        support = np.sum(y * across, axis=-1) * weight
        normal, right = np.swapaxes(design, 1, 2) @ design, np.einsum("nmp,nm->np", design, support)
        terms = _solve(normal, right, prior)[0]
        depth = jet(terms, phi, x, LOW).p
        spread = np.sqrt(np.sum((x * weight) ** 2, axis=1) / np.maximum(np.count_nonzero(weight, axis=1), 1))
    return phi, x, terms, np.maximum(section, (spread > NARROW)[:, None])


def _linearised(
    terms: Array, order: int, edgels: Edgels, phi: Array, x: Array, open_terms: Array
) -> tuple[Array, Array, Array, np.ndarray]:
    """Normal matrix (n, P, P) and right side (n, P) for the terms themselves; chi2 (n,); edgels kept (n, M)."""
    error, J = image_distance(terms, order, edgels, *feet(terms, order, edgels, phi, x))
    z = np.abs(error * edgels.inverse_sigma)
    present = edgels.inverse_sigma > 0
    half = np.count_nonzero(present, axis=1) // 2
    median = np.take_along_axis(np.sort(np.where(present, z, np.inf), axis=1), half[:, None], axis=1)
    keep = present & (z < OUTLIER * np.maximum(1.0, 1.48 * median)) & np.all(np.isfinite(J), axis=-1)
    weight = np.where(keep, edgels.inverse_sigma, 0.0)
    error, J = np.where(keep, error, 0.0), np.where(keep[..., None], J, 0.0)
    J = J * weight[..., None] * open_terms[:, None, : J.shape[-1]]
    normal = np.swapaxes(J, 1, 2) @ J
    right = np.einsum("nij,nj->ni", normal, terms) - np.einsum("nmp,nm->np", J, error * weight)
    return normal, right, np.sum((error * weight) ** 2, axis=1), keep


def _deviations(order: int, amplitude: float, length: float) -> Array:
    """Prior standard deviations (P,) of the terms up to `order`."""
    higher = [factorial(i) * factorial(j) / length**j for i, j in TERMS[6 : terms_up_to(order)]]
    return np.concatenate([BROAD, amplitude * np.array(higher)])


def _scaled(normal: Array, deviation: Array) -> tuple[Array, Array]:
    """Posterior information (n, P, P) with a unit diagonal, and the scale (n, P) of its rows."""
    information = normal + (1 / deviation**2)[..., None] * np.eye(normal.shape[-1])
    scale = 1 / np.sqrt(np.einsum("nii->ni", information))
    return information * scale[:, :, None] * scale[:, None, :], scale


def _solve(normal: Array, right: Array, deviation: Array) -> tuple[Array, Array]:
    """Posterior mean (n, P) and covariance (n, P, P) under a prior (P,) or (n, P)."""
    information, scale = _scaled(normal, deviation)
    inverse = np.linalg.inv(information + 1e-15 * np.eye(normal.shape[-1]))
    covariance = inverse * scale[:, :, None] * scale[:, None, :]
    return np.einsum("nij,nj->ni", covariance, right), covariance


def _log_evidence(normal: Array, right: Array, deviation: Array) -> Array:
    """Logarithm (n,) of the evidence for a prior (P,), up to what all priors share."""
    information, scale = _scaled(normal, deviation)
    factor = np.linalg.cholesky(information + 1e-12 * np.eye(normal.shape[-1]))
    y = np.linalg.solve(factor, (right * scale)[..., None])[..., 0]
    determinant = np.sum(np.log(np.einsum("nii->ni", factor)), axis=1) - np.sum(np.log(scale), axis=1)
    return 0.5 * np.sum(y**2, axis=1) - determinant - np.sum(np.log(deviation))


def _averaged(normal: Array, right: Array, grid: Array, weight: Array) -> tuple[Array, Array]:
    """Mean (n, 6) and covariance (n, 6, 6) of the terms up to order 2, over the priors of the grid."""
    means, second = [], np.zeros((len(right), 6, 6))
    for deviation, w in zip(grid, weight.T, strict=True):
        mean, covariance = _solve(normal, right, deviation)
        means.append(mean[:, :6])
        second += w[:, None, None] * covariance[:, :6, :6]
    stack = np.stack(means, axis=1)
    mean = np.einsum("nk,nki->ni", weight, stack)
    off = stack - mean[:, None]
    return mean, second + np.einsum("nk,nki,nkj->nij", weight, off, off)
