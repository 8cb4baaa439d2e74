"""Normal equations of a few unknowns that are common to all views, and a few more of each view.

    [A    B_1  B_2 ..]        A: (P, P) common
    [B_1' D_1        ]        B_v: (P, K) border
    [B_2'      D_2   ]        D_v: (K, K) own

Views meet only through what is common: their own unknowns are eliminated one by one, which leaves the Schur complement
A - sum B_v D_v^-1 B_v'. Its inverse is the covariance of what is common.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import cho_solve

from extremal.estimator.camera import Array
from extremal.estimator.errors import DegenerateGeometry


@dataclass(frozen=True, eq=False)
class Bordered:
    """Normal equations [[common, border], [border', own]] of P common unknowns and K of each of V views.

    common (P, P), border (V, P, K), own (V, K, K), gradient (P,), own_gradient (V, K).
    """

    common: Array
    border: Array
    own: Array
    gradient: Array
    own_gradient: Array

    @cached_property
    def _own_inverse(self) -> Array:
        return np.linalg.inv(self.own)

    @cached_property
    def _gain(self) -> Array:
        return self.border @ self._own_inverse

    @cached_property
    def _factor(self) -> tuple[Array, Array]:
        """Scales (P,) and lower Cholesky factor (P, P) of the scaled Schur complement."""
        schur = self.common - np.einsum("vpk,vqk->pq", self._gain, self.border)
        scale = 1 / np.sqrt(np.diagonal(self.common))
        try:
            factor = np.linalg.cholesky(schur * np.outer(scale, scale))
        except np.linalg.LinAlgError:
            factor = np.full_like(schur, np.nan)
        if not np.all(np.isfinite(factor)):
            raise DegenerateGeometry(
                "the views don't determine the calibration; accepted: boards slanted by 20 degrees or more, from several sides"
            )
        return scale, factor

    def _solve(self, right: Array) -> Array:
        scale, factor = self._factor
        return scale[:, None] * cho_solve((factor, True), scale[:, None] * right)

    @cached_property
    def step(self) -> tuple[Array, Array]:
        """Newton step (P,) and (V, K)."""
        right = self.gradient - np.einsum("vpk,vk->p", self._gain, self.own_gradient)
        common = -self._solve(right[:, None])[:, 0]
        left = self.own_gradient + np.einsum("vpk,p->vk", self.border, common)
        return common, -np.einsum("vkl,vl->vk", self._own_inverse, left)

    @property
    def decrease(self) -> float:
        """By how much the step lowers chi2: the square of its length in standard deviations of the posterior."""
        common, own = self.step
        return float(-(self.gradient @ common + np.sum(self.own_gradient * own)))

    def damped(self, factor: float) -> "Bordered":
        """With Levenberg's damping, Marquardt's scaling."""
        common = self.common + factor * np.diag(np.diagonal(self.common))
        return replace(self, common=common, own=self.own * (1 + factor * np.eye(self.own.shape[1])))

    @property
    def log_determinant(self) -> float:
        scale, factor = self._factor
        schur = 2 * np.sum(np.log(np.diagonal(factor))) - 2 * np.sum(np.log(scale))
        return float(schur + np.sum(np.linalg.slogdet(self.own)[1]))

    @cached_property
    def covariance(self) -> Array:
        """(P, P) of what is common."""
        covariance = self._solve(np.eye(len(self.common)))
        return (covariance + covariance.T) / 2

    def view_covariance(self, by_common: Array, by_own: Array) -> Array:
        """(V, n, n) of quantities of each view with derivatives (V, n, P) and (V, n, K)."""
        turned = by_common - by_own @ np.swapaxes(self._gain, 1, 2)
        return turned @ self.covariance @ np.swapaxes(
            turned, 1, 2
        ) + by_own @ self._own_inverse @ np.swapaxes(by_own, 1, 2)
