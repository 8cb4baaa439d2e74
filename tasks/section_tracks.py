"""What is told of tracked sections: one rule for every sensor.

A circle that is fitted to an arc is the osculating circle near the middle of that arc, where a linear change of the radius
of curvature cancels; at the arc's end, where tracks start, it is off by that change. So the contact point that is told of is
the one half-way between the first and the last direction in which the section was seen.
"""

import numpy as np
from numpy.typing import NDArray

from extremal.estimator.camera import Array
from extremal.estimator.estimates import DRIFT
from extremal.estimator.references import bootstrap
from extremal.tasks.edge_model import EdgeModel
from extremal.tasks.features import Features, Radii, labelled
from extremal.tasks.section_smoother import Sections, SectionSmoother

LEAST_TILT = (
    0.5  # sine of the angle between contour and epipolar line: what pose errors do to less is not linear
)
STEEPER = 1.2  # than that, where tracks start
FIRST_BOOTSTRAP, BOOTSTRAP_GROWTH = 8, 1.2  # looks, and factor on their number
LEAST_REFERENCES = 5  # from which they tell how well sigma describes their errors
MEDIAN_CHI2 = 0.4549  # of one degree of freedom


class SectionTracks:
    """n sections that are followed, whose references are bootstrapped as looks come in."""

    def __init__(
        self,
        origin: Array,
        frame: Array,
        contour: NDArray[np.integer],
        distance: Array,
        focal: float,
        edges: EdgeModel,
        noisy_slant: bool,
    ) -> None:
        """
        Args:
            origin, frame: (n, 3) [m], (n, 3, 3) as of `SectionSmoother`.
            contour: (n,) image contour of each, in order along it. distance: (n,) [m] of the origins. focal: [px].
            edges: whose biases are taken into account. noisy_slant: as of `SectionSmoother`.
        """
        self._smoother = SectionSmoother(
            origin, frame, distance, edges.bias_px / focal, edges.bias_turn, noisy_slant
        )
        self._origin, self._frame, self._contour = origin, frame, contour
        self._drift = DRIFT * distance / focal
        self._looks, self._due = 0, float(FIRST_BOOTSTRAP)
        n = len(origin)
        self._normals: list[Array] = []  # (n, 3) of every look, in the world; zero where unseen
        self._first, self._last = np.full(n, np.inf), np.full(n, -np.inf)
        self._views, self.visible = np.zeros(n, int), np.zeros(n, bool)

    def take_in(self, believed: Array, root: Array, normals: Array, sigma: Array) -> NDArray[np.bool_]:
        """Take in a look, as `SectionSmoother.update` does, and say which sections (n,) were seen.

        Planes that hardly cross those of their sections are left out.
        """
        there = normals @ believed[:3, :3].T
        tilt = np.sqrt(np.maximum(1 - np.einsum("ni,ni->n", there, self._frame[:, 2]) ** 2, 0.0))
        seen = np.isfinite(sigma) & (tilt > LEAST_TILT)
        self._smoother.update(believed, root, normals, np.where(seen, sigma, np.inf))
        N, T = self._frame[:, 0], self._frame[:, 1]
        phi = np.arctan2(np.einsum("ni,ni->n", there, T), np.einsum("ni,ni->n", there, N))
        self._first = np.where(seen, np.minimum(self._first, phi), self._first)
        self._last = np.where(seen, np.maximum(self._last, phi), self._last)
        self._normals.append(np.where(seen[:, None], there, 0.0))
        self._views += seen
        self.visible = seen
        self._looks += 1
        return seen

    def features(self, pixels: Array) -> Features:
        """What is known now; pixels (n, 2) where tracks were last seen."""
        n = len(self._origin)
        if n == 0:
            return Features.empty()
        with np.errstate(invalid="ignore"):  # inf - inf where nothing was seen
            phi = np.where(self._views > 0, (self._first + self._last) / 2, 0.0)
        solution = self._smoother.solve()
        free = solution.free()
        if self._looks >= self._due:
            self._due = self._looks * BOOTSTRAP_GROWTH
            own, shared = solution.shared()
            own = np.where(free.valid, own, np.inf)
            self._smoother.fixed = bootstrap(free.radius, own, shared, self._contour).fixed
        fixed = self._smoother.fixed
        held = None
        if fixed.any():
            found = solution.held(fixed)
            held = self._radii(found, phi, _birge_ratio(found, fixed))
        return labelled(
            self._radii(free, phi),
            held,
            self._normal(phi),
            self._frame[:, 2],
            fixed.copy(),
            self._contour,
            pixels,
            self.visible,
            self._views.copy(),
        )

    def _normal(self, phi: Array) -> Array:
        """Surface normals (n, 3) where those in the sections point at phi (n,): slanted as in the look that comes nearest."""
        seen = np.array(self._normals)
        at = self._in_plane(phi)
        nearest = np.argmax(np.einsum("vni,ni->vn", seen, at), axis=0)
        normal = seen[nearest, np.arange(len(phi))]
        up = self._frame[:, 2]
        a, b = np.einsum("ni,ni->n", normal, at), np.einsum("ni,ni->n", normal, up)
        scale = np.maximum(np.hypot(a, b), 1e-12)
        return (np.where(a == 0, 1.0, a / scale))[:, None] * at + (b / scale)[:, None] * up

    def _in_plane(self, phi: Array) -> Array:
        return np.cos(phi)[:, None] * self._frame[:, 0] + np.sin(phi)[:, None] * self._frame[:, 1]

    def _radii(self, found: Sections, phi: Array, ratio: float = 1.0) -> Radii:
        """Radii and the contact points (n, 3) at phi (n,): o + s N_0 + q T_0 + R (N(phi) - N_0)."""
        plane = self._frame[:, :2]
        at = found.theta[:, :2] + found.theta[:, 2:] * np.stack([np.cos(phi) - 1, np.sin(phi)], axis=1)
        J = np.zeros((len(phi), 2, 3))
        J[:, 0, 0], J[:, 1, 1], J[:, 0, 2], J[:, 1, 2] = 1, 1, np.cos(phi) - 1, np.sin(phi)
        spread = np.where(found.valid[:, None, None], found.covariance, 0.0)
        covariance = ratio**2 * np.swapaxes(plane, 1, 2) @ J @ spread @ np.swapaxes(J, 1, 2) @ plane
        covariance[~found.valid] = np.inf
        position = self._origin + np.einsum("ni,nij->nj", at, plane)
        return Radii(found.radius, np.hypot(ratio * found.sigma, self._drift), position, covariance)


def _birge_ratio(found: Sections, fixed: NDArray[np.bool_]) -> float:
    """How much larger than sigma the radii of references are, which should be 0; at least 1 (Birge, Phys. Rev. 40, 207, 1932).

    What a circle leaves of a section, and errors of edges that views share, are not all in sigma.
    """
    z = (found.radius / found.sigma)[fixed & found.valid]
    if len(z) < LEAST_REFERENCES:
        return 1.0
    return float(np.sqrt(max(1.0, np.median(z**2) / MEDIAN_CHI2)))
