"""Contour bundle adjustment: camera poses with their prior and the local shape of all features, jointly (DESIGN, equation 9).

The most probable cameras u ~ N(0, I) and shapes theta for the tangent planes that V views show of fixed points and curves
and of extremal boundaries. Shapes are eliminated exactly (`elimination`), which leaves the equations of the cameras

    (I + sum_j J_j' (I - Q_j Q_j') J_j) du = -(u + sum_j J_j' r_j)

solved by Gauss-Newton steps with Levenberg's damping; far tangent planes lose weight. The inverse of the matrix
on the left is the cameras' covariance and, in the small-noise limit, the Cramer-Rao bound.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.linalg import norm
from scipy.linalg import cho_solve, solve_triangular
from scipy.spatial.transform import RigidTransform

from extremal.estimator.camera import Array
from extremal.estimator.elimination import Cameras, Linearised, linearise_all
from extremal.estimator.errors import DegenerateGeometry, InvalidInput
from extremal.estimator.marginals import Shapes, marginals
from extremal.estimator.poses import PosePrior
from extremal.estimator.support import CIRCLE, FIXED, Features, Sections
from extremal.estimator.threads import one_blas_thread

STEPS = 40
SETTLED = 1e-2  # standard deviations of the posterior, over all unknowns together: a shorter step ends the iteration
FAR = 3.0  # standard deviations beyond which a tangent plane loses weight
REWEIGHTED = (
    8  # steps after which weights are held, lest planes that are nearly far swing between two solutions
)
STEADY = 0.1  # of their distance: features known less well than this don't help to find the cameras
UNHEARD_OF = 1e6  # standard deviations by which no pose is wrong to start with
LOOSE = 0.2  # of its distance: a depth known less well than this is beyond linear error propagation


@dataclass(frozen=True, eq=False)
class Adjustment:
    """Cameras and features after a bundle adjustment of V views.

    Attributes:
        T_world_camera: poses (V); pose_covariance: (V, 6, 6) in the camera frames.
        u: the whitened camera unknowns; root: (U, U), their covariance is root' root.
        focal, focal_sigma: factor on the focal length, and its standard deviation.
        shapes: one entry for each set of features, in the order given.
        converged: False where the steps did not settle: all sigma are infinite then.
        steps: accepted steps.
    """

    T_world_camera: RigidTransform
    pose_covariance: Array
    u: Array
    root: Array
    focal: float
    focal_sigma: float
    shapes: tuple[Shapes, ...]
    converged: bool
    steps: int


@dataclass(frozen=True, eq=False)
class _State:
    cameras: Cameras
    blocks: list[list[Linearised]]  # of each set of features
    robust: list[Array]  # (n, L, V) factors of each set on its residuals
    matrix: Array  # (U, U) left-hand side
    gradient: Array  # (U,)

    @cached_property
    def decrement(self) -> float:
        """Length of the Newton step that is left, in standard deviations of the posterior; NaN for cameras beyond reach."""
        try:
            return float(np.sqrt(-self.gradient @ self.step(0.0)))
        except DegenerateGeometry:
            return float("nan")

    def step(self, damping: float) -> Array:
        """Newton's step (U,), damped."""
        damped = self.matrix + damping * np.diag(np.diagonal(self.matrix))
        return -cho_solve((_factor(damped), True), self.gradient)

    def theta(self, k: int) -> Array:
        """(n, k) of one set of features."""
        blocks = self.blocks[k]
        theta = np.zeros((len(self.robust[k]), max((b.theta.shape[1] for b in blocks), default=FIXED)))
        for b in blocks:
            theta[b.rows, : b.theta.shape[1]] = b.theta
        return theta

    def residuals(self, k: int) -> Array:
        """(n, L, V) in standard deviations, before robust factors."""
        out = np.zeros(self.robust[k].shape)
        for b in self.blocks[k]:
            out[b.rows] = b.residuals
        return out / np.maximum(self.robust[k], 1e-12)

    def own_sigma(self, k: int) -> Array:
        """Largest (n,) of the standard deviations [m] of the first three parameters, for known cameras."""
        sigma = np.full(len(self.robust[k]), np.inf)
        for b in self.blocks[k]:
            sigma[b.rows] = np.where(b.resolved, norm(b.gram_root, axis=2)[:, :CIRCLE].max(axis=1), np.inf)
        return sigma


def adjust(
    prior: PosePrior,
    features: Sequence[Features],
    overlap: float = 1.0,
    start: Array | None = None,
) -> Adjustment:
    """Adjust cameras and features together.

    Args:
        prior: believed poses and what is known of their errors.
        features: sets of features, each (`Sections`, `Points`) of at least one.
        overlap: number of neighbouring features that repeat each other's errors, as edgels do that a spline ties
            together: what the features say of the cameras counts 1 / overlap.
        start: (U,) whitened camera unknowns to start from; by default the believed poses.

    Raises:
        InvalidInput: no features, features of another number of views, overlap below 1, or a start that does not fit.
        DegenerateGeometry: standard deviations of poses or planes that are too far apart for double precision.
    """
    views = len(prior.T_world_camera)
    if not any(len(f) for f in features):
        raise InvalidInput("no features are given; accepted: at least one that is seen in three views")
    for f in features:
        if f.sigma.shape[2] != views:
            raise InvalidInput(
                f"features are seen in {f.sigma.shape[2]} views; accepted: {views}, as there are poses"
            )
    if not overlap >= 1:
        raise InvalidInput(f"overlap is {overlap!r}; accepted: a number from 1")
    start = np.zeros(prior.unknowns) if start is None else start
    if start.shape != (prior.unknowns,) or not np.all(np.abs(start) < UNHEARD_OF):
        raise InvalidInput(
            f"start is {start.shape}, up to {np.max(np.abs(start), initial=0.0):.3g}; accepted: ({prior.unknowns},), of "
            f"numbers below {UNHEARD_OF:g}"
        )
    with one_blas_thread(), ThreadPoolExecutor(2) as pool:
        solver = _Solver(prior, list(features), overlap, pool)
        state, converged, steps = solver.solve(start)
        return solver.adjustment(state, converged, steps)


def survey(prior: PosePrior, features: Features, adjustment: Adjustment) -> Shapes:
    """The shapes of features for the cameras of an adjustment, as if they had had no part in it.

    That is right for other features, and for the same ones where these had had more parameters: what has told of the
    cameras then is no part of what tells of their shape.
    """
    with one_blas_thread(), ThreadPoolExecutor(2) as pool:
        solver = _Solver(prior, [features], 1.0, pool)
        theta, robust = np.zeros((len(features), features.width)), np.ones(features.sigma.shape)
        state = solver.evaluate(adjustment.u, [theta], [robust])
        state = solver.evaluate(adjustment.u, [state.theta(0)], [robust])
        state = replace(state, robust=[np.zeros_like(robust)])  # none of them helped
        return solver.shapes(0, state, adjustment.root, adjustment.converged)


@dataclass(frozen=True, eq=False)
class _Solver:
    """Levenberg-Marquardt on the cameras; the features follow."""

    prior: PosePrior
    features: list[Features]
    overlap: float
    pool: ThreadPoolExecutor

    def solve(self, u: Array) -> tuple[_State, bool, int]:
        robust: list[Array] = [np.ones(f.sigma.shape) for f in self.features]
        # twice at the start: the first pass finds where the planes touch, from which distances and lever arms follow
        state = self.evaluate(u, [np.zeros((len(f), f.width)) for f in self.features], robust)
        state = self.evaluate(u, self.thetas(state), robust)
        if len(u) == 0:
            return state, True, 0
        steady = [self.steady(k, state) for k in range(len(self.features))]
        scale = self.scale(state)
        robust = [s * robust_factor(state.residuals(k) / scale) for k, s in enumerate(steady)]
        state = self.evaluate(u, self.thetas(state), robust)
        damping, steps = 0.0, 0
        for _ in range(STEPS):
            step = state.step(damping)
            if 0 < steps <= REWEIGHTED:  # not at the start, where residuals are those of wrong poses
                robust = [s * robust_factor(state.residuals(k)) for k, s in enumerate(steady)]
            there = self.evaluate(state.cameras.u + step, self.thetas(state), robust)
            # as weights change, most when they first do, costs can't be compared: the decrement must not grow, until it is
            # within the posterior's standard deviation, where all is linear
            if not there.decrement < (max(2 * state.decrement, 1.0) if steps > 1 else np.inf):
                damping = max(10 * damping, 1e-3)
                # the next step is compared with what the new weights and contacts make of the cameras as they are
                state = self.evaluate(state.cameras.u, self.thetas(state), robust)
                continue
            state, steps, damping = there, steps + 1, damping / 10 if damping > 1e-6 else 0.0
            if steps >= 2 and state.decrement < SETTLED:
                return state, True, steps
        return state, False, steps

    def scale(self, state: _State) -> float:
        """Residuals of the start are those of wrong poses: what is far among them is measured by their own spread."""
        every = np.concatenate(
            [state.residuals(k)[np.isfinite(f.sigma)] for k, f in enumerate(self.features)]
        )
        return max(1.0, 1.5 * float(np.median(np.abs(every)))) if len(every) else 1.0

    def thetas(self, state: _State) -> list[Array]:
        return [state.theta(k) for k in range(len(self.features))]

    def steady(self, k: int, state: _State) -> Array:
        """(n, L, V) 1 for features that are known well enough to speak of the cameras, 0 for those that would swing."""
        known = state.own_sigma(k) < STEADY * self.distance(k, state)
        return np.broadcast_to(known[:, None, None], self.features[k].sigma.shape).astype(float)

    def distance(self, k: int, state: _State) -> Array:
        """Distance (n,) [m] of the features' origins from the nearest camera."""
        return np.min([norm(self.features[k].origin - v, axis=1) for v in state.cameras.centres], axis=0)

    def evaluate(self, u: Array, theta: list[Array], robust: list[Array]) -> _State:
        cameras = Cameras.at(self.prior, u)
        matrix, gradient = np.eye(len(u)), u.copy()
        blocks = []
        for k, f in enumerate(self.features):
            found, reduced = linearise_all(f, cameras, theta[k], robust[k], self.pool)
            matrix += reduced.information / self.overlap
            gradient += reduced.gradient / self.overlap
            blocks.append(found)
        return _State(cameras, blocks, robust, matrix, gradient)

    def adjustment(self, state: _State, converged: bool, steps: int) -> Adjustment:
        """Marginal covariances at the solution."""
        prior, u = self.prior, state.cameras.u
        root = solve_triangular(_factor(state.matrix), np.eye(len(u)), lower=True)  # covariance root' root
        views, _, own = prior.root.shape
        moves = np.zeros((views, 6, len(u)))
        for i in range(views):
            moves[i, :, i * own : (i + 1) * own] = prior.root[i]
        moves[:, :, views * own : views * own + prior.common.shape[2]] = prior.common
        moved = moves @ root.T
        shapes = tuple(self.shapes(k, state, root, converged) for k in range(len(self.features)))
        return Adjustment(
            prior.moved(prior.errors(u)),
            moved @ np.swapaxes(moved, 1, 2) if converged else np.full((views, 6, 6), np.inf),
            u,
            root,
            state.cameras.focal,
            (prior.focal_sigma * float(norm(root[:, -1])) if converged else np.inf)
            if prior.focal_sigma
            else 0.0,
            shapes,
            converged,
            steps,
        )

    def shapes(self, k: int, state: _State, root: Array, converged: bool) -> Shapes:
        """Marginals of one set. Features that did not help to find the cameras are estimated now, too; fixed sections are
        fitted with a radius, to see whether it is zero."""
        features = self.features[k]
        helped = state.robust[k].max(axis=(1, 2), initial=0.0) > 0
        robust = np.where(helped[:, None, None], state.robust[k], 1.0)
        blocks, _ = linearise_all(features, state.cameras, state.theta(k), robust, self.pool)
        state = replace(state, blocks=[blocks], robust=[robust])
        theta = state.theta(0)
        if isinstance(features, Sections):
            freed = replace(features, order=np.maximum(features.order, CIRCLE))
            wide = np.pad(theta, ((0, 0), (0, max(0, CIRCLE - features.width))))
            blocks, _ = linearise_all(freed, state.cameras, wide, robust, self.pool)
        out = marginals(features, blocks, theta, state.residuals(0), root, helped / self.overlap)
        depth = np.sqrt(np.trace(out.covariance[:, :2, :2], axis1=1, axis2=2))
        out.valid[:] &= converged & (depth < LOOSE * self.distance(k, state))
        for values in (out.covariance, out.sigma_radius, out.own_variance):
            values[~out.valid] = np.inf
        return out


def _factor(matrix: Array) -> Array:
    """Lower Cholesky factor (U, U) of what is the unit matrix and more."""
    try:
        factor = np.linalg.cholesky(matrix)
    except np.linalg.LinAlgError:
        factor = np.full_like(matrix, np.nan)
    if not np.all(np.isfinite(factor)):
        raise DegenerateGeometry(
            "what the features tell of the cameras is beyond double precision; accepted: standard deviations of planes and "
            "poses that could be"
        )
    return factor


def robust_factor(residuals: Array) -> Array:
    """Factors on residuals in standard deviations: 1 for near ones; the pull of a far one falls as it goes farther."""
    return np.minimum(1.0, FAR / np.maximum(np.abs(residuals), 1e-9))
