"""Contour bundle adjustment: camera poses with their prior and the local shape of all features, jointly (DESIGN, equation 9).

The most probable cameras u ~ N(0, I) and shapes theta for the tangent planes that V views show of fixed points and curves
and of extremal boundaries. Shapes are eliminated exactly (`elimination`), which leaves the equations of the cameras

    (I + sum_j J_j' (I - Q_j Q_j') J_j) du = -(u + sum_j J_j' r_j)

solved by Gauss-Newton steps with Levenberg's damping; far tangent planes lose weight (Huber). The inverse of the matrix
on the left is the cameras' covariance and, in the small-noise limit, the Cramer-Rao bound.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular
from scipy.spatial.transform import RigidTransform
from threadpoolctl import threadpool_limits

from extremal.estimator.camera import Array
from extremal.estimator.elimination import Cameras, Linearised, linearise_all
from extremal.estimator.errors import InvalidInput
from extremal.estimator.poses import PosePrior
from extremal.estimator.support import CIRCLE, FIXED, Features, Sections

STEPS = 40
SETTLED = 1e-2  # standard deviations of the posterior, over all unknowns together: a shorter step ends the iteration
HUBER = 3.0  # standard deviations beyond which a tangent plane loses weight
LOOSE = 0.2  # of its distance: a depth known less well than this is beyond linear error propagation


@dataclass(frozen=True, eq=False)
class Shapes:
    """What an adjustment makes of n features of one kind.

    Attributes:
        theta: (n, k) parameters (`support`); covariance: (n, k, k), the cameras' uncertainty included.
        radius, sigma_radius: (n,) [m] signed radius of curvature of a section. For one that was held fixed it is what its
            own planes say when all others are held as they are: the estimate that tests whether it is fixed.
        own_variance: (n,) [m^2] of the radius for known cameras; shared: (n, U) what unit errors of the cameras add:
            the radii of free sections i and j have the covariance shared_i . shared_j.
        residuals: (n, L, V) in standard deviations; 0 where not seen.
        valid: (n,) whether the planes determine the feature, in front of all cameras; else sigma and covariance are infinite.
    """

    theta: Array
    covariance: Array
    radius: Array
    sigma_radius: Array
    own_variance: Array
    shared: Array
    residuals: Array
    valid: np.ndarray


@dataclass(frozen=True, eq=False)
class Adjustment:
    """Cameras and features after a bundle adjustment of V views.

    Attributes:
        T_world_camera: poses (V); pose_covariance: (V, 6, 6) in the camera frames. u: the whitened camera unknowns.
        focal, focal_sigma: factor on the focal length, and its standard deviation.
        shapes: one entry for each set of features, in the order given.
        converged: False where the steps did not settle: all sigma are infinite then.
        steps: accepted steps.
    """

    T_world_camera: RigidTransform
    pose_covariance: Array
    u: Array
    focal: float
    focal_sigma: float
    shapes: tuple[Shapes, ...]
    converged: bool
    steps: int


@dataclass(frozen=True, eq=False)
class _State:
    cameras: Cameras
    blocks: list[list[Linearised]]  # of each set of features
    robust: list[Array]  # (n, L, V) factors of each set on its weights
    matrix: Array  # (U, U) left-hand side
    gradient: Array  # (U,)

    @cached_property
    def decrement(self) -> float:
        """Length of the Newton step that is left, in standard deviations of the posterior; NaN for cameras beyond reach."""
        return float(np.sqrt(self.gradient @ cho_solve(cho_factor(self.matrix), self.gradient)))

    def theta(self, k: int, width: int) -> Array:
        count = sum(len(b.rows) for b in self.blocks[k])
        theta = np.zeros((count, width))
        for b in self.blocks[k]:
            theta[b.rows, : b.theta.shape[1]] = b.theta
        return theta

    def residuals(self, k: int) -> Array:
        """(n, L, V) in standard deviations, before robust weights."""
        out = np.zeros(self.robust[k].shape)
        for b in self.blocks[k]:
            out[b.rows] = b.residuals
        return out / self.robust[k]


def adjust(
    prior: PosePrior, features: Sequence[Features], overlap: float = 1.0, start: Array | None = None
) -> Adjustment:
    """Adjust cameras and features together.

    Args:
        prior: believed poses and what is known of their errors.
        features: sets of features, each (`Sections`, `Points`) of at least one.
        overlap: number of neighbouring features that repeat each other's errors, as edgels do that a spline ties
            together: what the features say of the cameras counts 1 / overlap.
        start: (U,) whitened camera unknowns to start from; by default the believed poses.

    Raises:
        InvalidInput: no features, features of another number of views, or overlap below 1.
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
    features = [f for f in features]
    with threadpool_limits(1, "blas"), ThreadPoolExecutor(2) as pool:
        solver = _Solver(prior, features, overlap, pool)
        state, converged, steps = solver.solve(np.zeros(prior.unknowns) if start is None else start)
        return solver.adjustment(state, converged, steps)


class _Solver:
    """Levenberg-Marquardt on the cameras; the features follow."""

    def __init__(
        self, prior: PosePrior, features: list[Features], overlap: float, pool: ThreadPoolExecutor
    ) -> None:
        self.prior, self.features, self.overlap, self.pool = prior, features, overlap, pool

    def solve(self, u: Array) -> tuple[_State, bool, int]:
        # twice at the start: the first pass finds where the planes touch, from which distances and lever arms follow
        plain: list[Array] = [np.ones(f.sigma.shape) for f in self.features]
        state = self.evaluate(u, [np.zeros((len(f), f.width)) for f in self.features], plain)
        state = self.evaluate(u, self.thetas(state), plain)
        if len(u) == 0:
            return state, True, 0
        damping, steps = 0.0, 0
        for _ in range(STEPS):
            damped = state.matrix + damping * np.diag(np.diagonal(state.matrix))
            step = cho_solve(cho_factor(damped), -state.gradient)
            # residuals of the start are those of wrong poses: only afterwards is a far plane an outlier
            robust = [huber(state.residuals(k)) for k in range(len(self.features))] if steps else state.robust
            there = self.evaluate(state.cameras.u + step, self.thetas(state), robust)
            # weights change from step to step, so that costs can't be compared: the decrement must fall, until it is
            # within the posterior's standard deviation, where all is linear
            if steps and not there.decrement < max(state.decrement, 1.0):
                damping = max(10 * damping, 1e-3)
                continue
            state, steps, damping = there, steps + 1, damping / 10 if damping > 1e-6 else 0.0
            if steps >= 2 and state.decrement < SETTLED:
                return state, True, steps
        return state, False, steps

    def thetas(self, state: _State) -> list[Array]:
        return [state.theta(k, f.width) for k, f in enumerate(self.features)]

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
        root = solve_triangular(
            np.linalg.cholesky(state.matrix), np.eye(len(u)), lower=True
        )  # covariance root' root
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
            state.cameras.focal,
            (prior.focal_sigma * float(np.linalg.norm(root[:, -1])) if converged else np.inf)
            if prior.focal_sigma
            else 0.0,
            shapes,
            converged,
            steps,
        )

    def shapes(self, k: int, state: _State, root: Array, converged: bool) -> Shapes:
        features, theta = self.features[k], state.theta(k, self.features[k].width)
        n, width = theta.shape
        promoted = features
        if isinstance(
            features, Sections
        ):  # a fixed section is fitted with a radius, too, to see whether it is zero
            promoted = replace(features, order=np.maximum(features.order, CIRCLE))
            theta = np.pad(theta, ((0, 0), (0, max(0, CIRCLE - width))))
        blocks, _ = linearise_all(promoted, state.cameras, theta, state.robust[k], self.pool)
        out = Shapes(
            np.zeros((n, width)),
            np.full((n, width, width), np.inf),
            np.zeros(n),
            np.full(n, np.inf),
            np.full(n, np.inf),
            np.zeros((n, len(root))),
            state.residuals(k),
            np.zeros(n, bool),
        )
        for block in blocks:
            self._fill(out, features, block, root)
        out.theta[:] = state.theta(k, width)
        distance = np.linalg.norm(features.origin[:, None] - state.cameras.centres, axis=2).min(axis=1)
        loose = ~(np.sqrt(np.trace(out.covariance[:, :2, :2], axis1=1, axis2=2)) < LOOSE * distance)
        out.valid[loose] = False
        out.valid[:] &= converged
        for values in (out.covariance, out.sigma_radius, out.own_variance):
            values[~out.valid] = np.inf
        return out

    def _fill(self, out: Shapes, features: Features, block: Linearised, root: Array) -> None:
        """Marginals of one block. For a section held fixed, S below is the cameras' information with its radius held at
        zero; freeing that takes b b' / overlap from it (b: the row of B of the radius), which the last lines account for."""
        rows, width = block.rows, min(out.theta.shape[1], block.theta.shape[1])
        B = block.B @ root.T  # (n, k, U): B S^-1 B' is its square
        spread = np.einsum("nij,nju->niu", block.gram_root, B)
        own = block.gram_root @ np.swapaxes(block.gram_root, 1, 2)
        covariance = own + spread @ np.swapaxes(spread, 1, 2)
        fixed = features.order[rows] == FIXED
        if isinstance(features, Sections):
            out.radius[rows] = block.theta[:, 2]
            out.own_variance[rows] = own[:, 2, 2]
            freed = np.where(fixed, 1 - np.sum(B[:, 2] ** 2, axis=1) / self.overlap, 1.0)
            out.radius[rows] /= np.maximum(freed, 1e-12)
            variance = own[:, 2, 2] * (1 + np.sum(B[:, 2] ** 2, axis=1) / np.maximum(freed, 1e-12))
            out.sigma_radius[rows] = np.sqrt(np.where(block.resolved, variance, np.inf))
            out.shared[rows] = spread[:, 2]
            if (
                fixed.any()
            ):  # without the column of the radius, the factors of the first two are nested in these
                part = block.gram_root[:, :FIXED, :FIXED]
                two = part @ np.swapaxes(part, 1, 2)
                moved = np.einsum("nij,nju->niu", part, B[:, :FIXED])
                covariance[fixed] = 0.0
                covariance[fixed, :FIXED, :FIXED] = (two + moved @ np.swapaxes(moved, 1, 2))[fixed]
        out.covariance[rows, :width, :width] = covariance[:, :width, :width]
        out.covariance[rows, width:] = out.covariance[rows, :, width:] = 0.0
        out.valid[rows] = block.resolved & block.ahead


def huber(residuals: Array) -> Array:
    """Square roots of Huber's weights."""
    return np.sqrt(np.minimum(1.0, HUBER / np.maximum(np.abs(residuals), 1e-9)))
