"""Epipolar sections that are no circles: how many terms of the radius of curvature the data call for.

Over the arc that the contact point sweeps, the radius of curvature may vary: rho(phi) = R + a phi + b phi^2 / 2, with
phi the angle of the normal from that of the reference view. As rho = h + h'' (DESIGN, equation 1), this adds
a (phi - sin phi) + b (phi^2 / 2 - 1 + cos phi) to the support h(phi) of the osculating circle. The term in a hardly
costs anything, for a motion to both sides of the reference; that in b makes R several times less certain. Each is taken
in where the points around, on the same contour, show together that it is there.
"""

import itertools
from dataclasses import replace

import numpy as np

from extremal.estimator.camera import Array
from extremal.estimator.circle import OsculatingCircle
from extremal.estimator.pooling import window_sum

NEIGHBOURS = 10  # points on each side along the contour that decide together
EVIDENCE = 6.0  # mean fall of chi2 of these points: chance brings 1, the shading of painted patches near a limb up to 4


def varying_sections(circles: OsculatingCircle, weight: Array, contour: np.ndarray) -> OsculatingCircle:
    """The circles (n, the reference view first), refined where their sections' curvature varies.

    Args:
        weight: (n, V) inverse standard deviation [1/m] of each ray's displacement at its contact point; 0 where unseen.
        contour: (n,) contour of each point; points are in order along it.
    """
    columns = _columns(circles)
    least = (np.count_nonzero(weight, axis=1) >= 7) & circles.valid
    chi2: list[Array] = [np.sum((weight * circles.residuals) ** 2, axis=1)]
    solutions = []
    for order in (1, 2):
        solved = _solve(columns[..., : 3 + order], weight, circles.residuals, least)
        solutions.append(solved)
        chi2.append(solved[3])
    falls = (a - b for a, b in itertools.pairwise(chi2))
    first, second = (pooled_evidence(fall, least, contour) for fall in falls)
    refined = circles
    for (shift, gain, covariance, _), chosen in zip(solutions, (first & ~second, second), strict=True):
        refined = _refined(refined, chosen & least, shift, gain, covariance)
    return refined


def _columns(circles: OsculatingCircle) -> Array:
    """Derivatives (n, V, 5) of the support by s, q, c, a, b."""
    normals = circles.normals
    ray = np.cross(circles.plane_normals, normals[:, 0])
    sine, cosine = -np.einsum("nvk,nk->nv", normals, ray), np.einsum("nvk,nk->nv", normals, normals[:, 0])
    phi = np.arctan2(sine, cosine)
    return np.stack([np.ones_like(phi), sine, cosine - 1, phi - sine, 0.5 * phi**2 + cosine - 1], axis=-1)


def _solve(
    columns: Array, weight: Array, residuals: Array, rows: np.ndarray
) -> tuple[Array, Array, Array, Array]:
    """Weighted least squares of the residuals: shift (n, 3) of s, q, c; gain (n, 3, V); covariance (n, 3, 3); chi2."""
    n, views = columns.shape[:2]
    shift, gain, covariance = np.zeros((n, 3)), np.zeros((n, 3, views)), np.zeros((n, 3, 3))
    chi2 = np.zeros(n)
    design = columns[rows] * weight[rows][..., None]
    scale = 1 / np.maximum(np.linalg.norm(design, axis=1), 1e-300)
    design = design * scale[:, None]
    inverse = np.linalg.pinv(design, rcond=1e-9) * scale[..., None]
    data = weight[rows] * residuals[rows]
    solution = np.einsum("nkv,nv->nk", inverse, data)
    left = data - np.einsum("nvk,nk->nv", design, solution / scale)
    shift[rows], gain[rows] = solution[:, :3], inverse[:, :3] * weight[rows][:, None]
    covariance[rows] = inverse[:, :3] @ np.swapaxes(inverse[:, :3], 1, 2)
    chi2[rows] = np.sum(left**2, axis=1)
    return shift, gain, covariance, chi2


def pooled_evidence(fall: Array, counted: np.ndarray, contour: np.ndarray) -> np.ndarray:
    """Whether the mean fall of chi2 around each point (n,) exceeds EVIDENCE."""
    total, _ = window_sum(np.where(counted, fall, 0.0), contour, NEIGHBOURS)
    count, _ = window_sum(counted.astype(float), contour, NEIGHBOURS)
    return total > EVIDENCE * np.maximum(count, 1.0)


def _refined(
    circles: OsculatingCircle, rows: np.ndarray, shift: Array, gain: Array, covariance: Array
) -> OsculatingCircle:
    s, q, c = shift.T
    points = circles.points.copy()
    ray = np.cross(circles.plane_normals, circles.normals[:, 0])
    points[:, 0] += np.where(rows[:, None], s[:, None] * circles.normals[:, 0] - q[:, None] * ray, 0.0)
    variance = covariance[:, 0, 0] + covariance[:, 2, 2] - 2 * covariance[:, 0, 2]
    return replace(
        circles,
        radius=circles.radius + np.where(rows, s - c, 0.0),
        sigma_radius=np.where(rows, np.sqrt(variance), circles.sigma_radius),
        sigma_across=np.where(rows, np.sqrt(covariance[:, 0, 0]), circles.sigma_across),
        sigma_depth=np.where(rows, np.sqrt(covariance[:, 1, 1]), circles.sigma_depth),
        gain=np.where(rows[:, None, None], gain, circles.gain),
        points=points,
    )
