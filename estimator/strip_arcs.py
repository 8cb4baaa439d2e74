"""The t-curves of a strip: the arcs on which epipolar planes cut a surface, from all views (Cipolla ch. 3, figure 3.14).

In its plane a section has a support function h(phi), phi the angle of its normal N from that of the reference view, and a
contact point c = h N + h' N'. It is expanded in the kernels K_i of `parallel_sections` (cos, sin, 1 - cos, phi - sin, ...):
shift, depth, radius of curvature R, and the terms R_i phi^i / i! by which the radius varies along the arc. A tangent plane
with unit normal n through the camera centre v, whose trace in the section has the normal rho N, says

    n . v = rho h(phi) + noise,

linear in the terms. Nobody knows beforehand how fast a section varies: the terms beyond the osculating circle have normal
priors of standard deviation A i! / L^(i - 2) (radii that vary by A over an angle L), and all A and L of a grid are tried. Evidence,
pooled over neighbours on the contour, weighs them (MacKay, "Bayesian interpolation", 1992); what they disagree about is
part of the covariance. Hence arcs may be continued beyond the views, with a sigma that says how far.
"""

from dataclasses import dataclass, fields
from itertools import product
from math import factorial

import numpy as np

from extremal.estimator.camera import Array
from extremal.estimator.errors import DegenerateGeometry, InvalidInput
from extremal.estimator.estimates import OVERLAP
from extremal.estimator.parallel_sections import kernels
from extremal.estimator.pooling import window_sum

ORDER = 7  # highest i of a term: enough for what 15 to 60 views tell
AMPLITUDES = 1e-4 * 4.0 ** np.arange(6)  # [m] A
LENGTHS = (0.5, 1.0, 2.0)  # [rad] L
BROAD = (1.0, 1.0, 10.0)  # [m] prior of shift, depth and radius
NEIGHBOURS = 10  # arcs on each side along the contour that judge A together
HUBER = 2.5  # standard deviations beyond which a tangent plane loses weight
ROBUST_STEPS = 3
SHARED = 3  # arcs on each side that share their misfit
# [rad] turn of the view within which what causes misfit stays alike: a marking within the limb's profile takes about half a
# radian of a surface of 40 mm, seen from 0.6 m, to turn away
LASTING = 0.3
EXCESS = 3.0  # standard deviations of chi2 beyond which misfit is more than chance
JITTER = 1e-14  # of a unit diagonal, against rounding
FARTHEST = 1.5  # [rad] from the reference view, beyond which the kernels' series end


@dataclass(frozen=True, eq=False)
class Arcs:
    """n sections in planes of their own.

    Attributes:
        origin: (n, 3) [m]; frame: (n, 3, 3) rows N_0, T_0 (along the reference view's ray) and the plane's normal.
        terms: (n, P) of the kernels [m]: shift along N_0, along T_0, radius of curvature, ...
        covariance: (n, P, P) [m^2].
        first, last: (n,) [rad] ends of what was seen.
        misfit: (n,) chi2 per degree of freedom, pooled along the contour; where it exceeds 1 by more than chance, the
            covariance has grown by it.
    """

    origin: Array
    frame: Array
    terms: Array
    covariance: Array
    first: Array
    last: Array
    misfit: Array

    def __len__(self) -> int:
        return len(self.terms)

    def take(self, rows: np.ndarray) -> "Arcs":
        """The arcs [rows]."""
        return Arcs(**{f.name: getattr(self, f.name)[rows] for f in fields(Arcs)})

    def radius(self, phi: Array) -> tuple[Array, Array]:
        """Radius of curvature h + h'' (n, T) [m], of the sign of Shape's, at phi (n, T), and its standard deviation."""
        size = self.terms.shape[1]
        K = kernels(phi, size - 1)
        rows = K[..., 2:] + K[..., :-2]
        return np.einsum("ntp,np->nt", rows, self.terms), np.sqrt(self._variance(rows))

    def points(self, phi: Array) -> tuple[Array, Array]:
        """Contact points (n, T, 3) [m] and their covariance (n, T, 3, 3) [m^2], none across the plane, at phi (n, T)."""
        K = kernels(phi, self.terms.shape[1] - 1)
        rows = np.stack([K[..., 2:], K[..., 1:-1]], axis=-2)  # of h and h'
        axes = self.axes(phi)[..., :2, :]
        points = self.origin[:, None] + np.einsum("ntip,np,ntik->ntk", rows, self.terms, axes)
        inner = rows @ self.covariance[:, None] @ np.swapaxes(rows, -1, -2)
        return points, np.swapaxes(axes, -1, -2) @ inner @ axes

    def axes(self, phi: Array) -> Array:
        """(n, T, 3, 3) rows: N, N' (along the ray) and the plane's normal at phi (n, T)."""
        c, s = np.cos(phi)[..., None], np.sin(phi)[..., None]
        first, ray, across = (self.frame[:, None, i] for i in range(3))
        return np.stack(
            [c * first + s * ray, c * ray - s * first, np.broadcast_to(across, (*phi.shape, 3))], axis=-2
        )

    def _variance(self, rows: Array) -> Array:
        return np.maximum(np.einsum("ntp,npq,ntq->nt", rows, self.covariance, rows), 0.0)


def fit_arcs(
    origin: Array,
    frame: Array,
    normals: Array,
    centres: Array,
    sigma: Array,
    shared: Array,
    contour: np.ndarray,
) -> tuple[Arcs, Array]:
    """Arcs through tangent planes, and phi (n, V) of every view.

    Args:
        origin: (n, 3) [m] near the contact points of the reference view; frame: (n, 3, 3) as in `Arcs`.
        normals: (n, V, 3) unit normals of the tangent planes in the world, on the side of N_0.
        centres: (V, 3) camera centres [m].
        sigma: (n, V) [rad] standard deviation of each plane's angle about its camera centre; infinite where not seen.
        shared: (n, V, K) [rad] what errors of unit variance, common to all views, do to these angles.
        contour: (n,) runs of equal numbers: neighbours on one contour, in order.

    Raises:
        InvalidInput: shapes that do not fit, numbers that are not finite, sigma that is not positive.
        DegenerateGeometry: a camera at a contact point, or numbers that overflow.
    """
    _check(origin, frame, normals, centres, sigma, shared, contour)
    local = np.einsum("nij,nvj->nvi", frame, normals)
    length, phi = np.hypot(local[..., 0], local[..., 1]), np.arctan2(local[..., 1], local[..., 0])
    seen = np.isfinite(sigma) & (length > 1e-6)
    first, last = np.where(seen, phi, np.inf).min(axis=1), np.where(seen, phi, -np.inf).max(axis=1)
    away = centres - origin[:, None]
    distance = np.linalg.norm(away, axis=-1)
    weight = np.where(seen, 1 / (np.where(seen, sigma, 1.0) * distance), 0.0)
    rows = kernels(phi, ORDER)[..., 2:] * (length * weight)[..., None]
    support, moves = np.sum(normals * away, axis=-1) * weight, shared * (distance * weight)[..., None]
    data = np.concatenate([support[..., None], moves], axis=-1)
    alike = np.maximum(seen.sum(axis=1) * LASTING / np.maximum(last - first, LASTING), 1.0)
    moved, covariance, misfit = _robust(rows, data, alike, contour)
    common = moved[..., 1:]
    covariance = covariance + common @ np.swapaxes(common, 1, 2)
    if not (np.all(np.isfinite(moved)) and np.all(np.isfinite(covariance))):
        raise DegenerateGeometry(
            f"arcs of sigma from {sigma.min():.2g} rad, {distance.min():.2g} to {distance.max():.2g} m from the cameras, are "
            "beyond double precision; accepted: centres apart from the contact points"
        )
    return Arcs(origin, frame, moved[..., 0], covariance, first, last, misfit), phi


def _robust(rows: Array, data: Array, alike: Array, contour: np.ndarray) -> tuple[Array, Array, Array]:
    """Terms (n, P, K) of K sets of data (n, V, K), covariance (n, P, P) and misfit (n,) of the first; by its residuals views
    lose weight, and all views of an arc that does not fit.

    rows: (n, V, P) and data are whitened, zero where not seen. alike: (n,) views in a row that misfit alike.
    """
    seen = np.any(rows != 0, axis=-1)
    robust, inflation = np.ones(seen.shape), np.ones(len(seen))

    def solve() -> tuple[Array, Array, Array, Array, Array]:
        part = (robust / np.sqrt(inflation)[:, None])[..., None]
        few, some = rows * part, data * part
        moved, covariance = _averaged(np.swapaxes(few, 1, 2) @ few, np.swapaxes(few, 1, 2) @ some, contour)
        off = np.abs(data[..., 0] - np.einsum("nvp,np->nv", rows, moved[..., 0]))
        freedom = seen.sum(axis=1) - np.einsum("npq,nvq,nvp->n", covariance, few, few)
        return moved, covariance, off, *_misfit(np.sum((robust * off) ** 2, axis=1), freedom, contour)

    moved, covariance, off, misfit, excess = solve()
    for _ in range(ROBUST_STEPS):
        inflation = 1 + excess * alike
        robust = np.minimum(1.0, HUBER * np.sqrt(inflation)[:, None] / np.maximum(off, 1e-9))
        moved, covariance, off, misfit, excess = solve()
    return moved, covariance, misfit


def _check(
    origin: Array,
    frame: Array,
    normals: Array,
    centres: Array,
    sigma: Array,
    shared: Array,
    contour: np.ndarray,
) -> None:
    n, views = sigma.shape if sigma.ndim == 2 else (-1, -1)
    shapes = (origin.shape, frame.shape, normals.shape, centres.shape, shared.shape[:2], contour.shape)
    if shapes != ((n, 3), (n, 3, 3), (n, views, 3), (views, 3), (n, views), (n,)):
        raise InvalidInput(
            f"origin, frame, normals, centres, shared, contour are {shapes}; accepted: what fits sigma (n, V), {sigma.shape}"
        )
    for name, values in (
        ("origin", origin),
        ("frame", frame),
        ("normals", normals),
        ("centres", centres),
        ("shared", shared),
    ):
        if not np.all(np.isfinite(values)):
            raise InvalidInput(f"{name} holds a number that is not finite")
    if not np.all(sigma > 0):
        raise InvalidInput("sigma of tangent planes must be positive [rad]; infinite leaves one out")


def _averaged(normal: Array, right: Array, contour: np.ndarray) -> tuple[Array, Array]:
    """Means (n, P, K) and covariance (n, P, P) of the terms over the priors of the grid, weighed by their evidence.

    right: (n, P, K) normal equations' right sides of K sets of data; evidence and covariance are those of the first.
    """
    evidence, means, covariances = [], [], []
    for amplitude, length in product(AMPLITUDES, LENGTHS):
        higher = [amplitude * factorial(i) / length ** (i - 2) for i in range(3, ORDER + 1)]
        deviation = np.array([*BROAD, *higher])
        information = normal * np.outer(deviation, deviation) + np.eye(ORDER + 1)
        scaled = right * deviation[:, None]
        inverse, determinant = _inverse(information)
        mean = inverse @ scaled
        means.append(mean * deviation[:, None])
        covariances.append(inverse * np.outer(deviation, deviation))
        fit = 0.5 * np.sum(mean[..., 0] * scaled[..., 0], axis=1)
        evidence.append(fit - 0.5 * determinant)
    pooled, count = window_sum(np.stack(evidence, axis=1), contour, NEIGHBOURS)
    pooled = pooled / np.minimum(count, OVERLAP)[:, None]  # a spline ties neighbours together
    weight = np.exp(pooled - pooled.max(axis=1, keepdims=True))
    weight /= weight.sum(axis=1, keepdims=True)
    stack = np.stack(means, axis=1)
    mean = np.einsum("nk,nkpi->npi", weight, stack)
    off = stack[..., 0] - mean[:, None, :, 0]
    spread = np.einsum("nk,nkp,nkq->npq", weight, off, off)
    return mean, spread + np.einsum("nk,knpq->npq", weight, np.stack(covariances))


def _inverse(information: Array) -> tuple[Array, Array]:
    """Inverses of (n, P, P) and logarithms of their determinants (n,), by way of a unit diagonal: a short arc is no harm."""
    scale = 1 / np.sqrt(np.einsum("npp->np", information))
    scaled = information * scale[:, :, None] * scale[:, None, :] + JITTER * np.eye(information.shape[-1])
    inverse = np.linalg.inv(scaled) * scale[:, :, None] * scale[:, None, :]
    return inverse, np.linalg.slogdet(scaled)[1] - 2 * np.sum(np.log(scale), axis=1)


def _misfit(chi2: Array, freedom: Array, contour: np.ndarray) -> tuple[Array, Array]:
    """chi2 per degree of freedom (n,), pooled, and by how much it exceeds 1 (n,) where that is more than chance."""
    total, count = window_sum(chi2, contour, SHARED)
    left = np.maximum(window_sum(freedom, contour, SHARED)[0], 1.0)
    chance = EXCESS * np.sqrt(2 * np.minimum(count, OVERLAP) / left)
    pooled = total / left
    return pooled, np.where(pooled > 1 + chance, pooled - 1, 0.0)
