"""What the corners of a board say of camera, hand-eye transform, board and arm together: residuals and normal equations.

    pixel = projection(intrinsics, T_camera_board p),   T_camera_board = (T_base_flange,v(c) exp(S root_v z_v) T_flange_camera)^-1 T_base_board

Whatever moves the camera before the board does so by one twist a view. So a view's corners are summed up in the 15 numbers of
intrinsics and twist first, and these are chained with the derivatives of the twist: by hand-eye transform and board pose
(twists, right-multiplied), by the arm's errors c ~ N(0, I) common to all views, and by z_v ~ N(0, I) of each view. The z_v are
eliminated view by view (Schur complement). S scales what is independent in every view.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial.transform import RigidTransform

from extremal.estimator.board import Board
from extremal.estimator.bordered import Bordered
from extremal.estimator.camera import Array, Camera
from extremal.estimator.corners import Corners
from extremal.estimator.errors import DegenerateGeometry
from extremal.estimator.poses import PosePrior, pose_exp
from extremal.estimator.projection import (
    INTRINSICS,
    adjoint,
    cross_matrix,
    intrinsics,
    point_by_twist,
    projection,
    with_intrinsics,
)

FlangeModel = Callable[[Array], PosePrior]
"""Whitened common errors c (C,) ~ N(0, I) of the arm -> T_base_flange (V) there, in the place of `T_world_camera`; its
derivatives `common` (V, 6, C) and the `root` (V, 6, K) of what is independent in every view, twists in the flange frame."""

LENSES = slice(0, len(INTRINSICS))  # rows of what is common
BENDING = slice(4, 9)  # the distortion among them
HAND_EYE = slice(9, 15)  # a twist in the camera frame
BOARD = slice(15, 21)  # a twist in the board's frame
ARM = slice(21, None)
TWIST = slice(9, 15)  # rows of a view, after the intrinsics: the twist of T_board_camera
BENT = 0.2  # prior sd of what each distortion term does to a point in the image's corner, of its distance from the centre


@dataclass(frozen=True, eq=False)
class Sightings:
    """The board's N corners in V views.

    points: (N, 3) [m]; pixels: (V, N, 2); whitening: (V, N, 2, 2) inverse roots of their covariances, zero where not used.
    """

    points: Array
    pixels: Array
    whitening: Array

    @staticmethod
    def of(board: Board, corners: Sequence[Corners]) -> "Sightings":
        shape = (len(corners), len(board.corners))
        pixels, whitening = np.zeros((*shape, 2)), np.zeros((*shape, 2, 2))
        for v, seen in enumerate(corners):
            pixels[v, seen.ids] = seen.pixels
            whitening[v, seen.ids] = np.linalg.inv(np.linalg.cholesky(seen.covariance))
        return Sightings(board.corners, pixels, whitening)

    @property
    def used(self) -> np.ndarray:
        """(V, N)"""
        return np.any(self.whitening, axis=(2, 3))

    @property
    def views(self) -> np.ndarray:
        """(V,) those with corners that are used."""
        return np.any(self.used, axis=1)

    def without(self, far: np.ndarray) -> "Sightings":
        """Corners (V, N) that are no longer used."""
        return replace(self, whitening=np.where(far[..., None, None], 0.0, self.whitening))


@dataclass(frozen=True, eq=False)
class State:
    """Values of all unknowns: c (C,) common errors of the arm, z (V, K) of each view, both whitened."""

    camera: Camera
    T_flange_camera: RigidTransform
    T_base_board: RigidTransform
    c: Array
    z: Array

    @property
    def intrinsics(self) -> Array:
        return intrinsics(self.camera)

    def moved(self, common: Array, own: Array) -> "State":
        """With steps common (21 + C,) of intrinsics, hand-eye twist, board twist and c, and own (V, K)."""
        values = self.intrinsics + common[LENSES]
        if not (np.all(np.isfinite(common)) and values[:2].min() > 0):
            raise DegenerateGeometry(
                f"the calibration diverges (focal lengths {values[0]:.4g} and {values[1]:.4g} px)"
            )
        return State(
            with_intrinsics(self.camera, values),
            self.T_flange_camera * pose_exp(common[HAND_EYE]),
            self.T_base_board * pose_exp(common[BOARD]),
            self.c + common[ARM],
            self.z + own,
        )


@dataclass(frozen=True, eq=False)
class Linearised:
    """Corners of V views near a state.

    Attributes:
        state: where. residuals: (V, N, 2) [px], predicted minus seen.
        information, gradient, chi2: (V, 15, 15), (V, 15) and scalar, of intrinsics and the twist of T_board_camera.
        by_common: (V, 15, 21 + C) derivatives by what is common to all views.
        by_flange: (V, 6, 6) camera twist per change of the flange's own twist S root z; root: (V, 6, K).
        T_board_camera: (V).
    """

    state: State
    residuals: Array
    information: Array
    gradient: Array
    chi2: float
    by_common: Array
    by_flange: Array
    root: Array
    T_board_camera: RigidTransform

    def by_own(self, scales: Array) -> Array:
        """(V, 15, K) derivatives by z."""
        twist = self.by_flange @ (np.repeat(scales, 3)[:, None] * self.root)
        return np.concatenate([np.zeros((len(twist), TWIST.start, twist.shape[2])), twist], axis=1)

    @cached_property
    def precision(self) -> Array:
        """(21 + C,) of the priors on what is common."""
        precision = np.zeros(self.by_common.shape[2])
        precision[BENDING] = distortion_sigma(self.state.camera) ** -2.0
        precision[ARM] = 1.0
        return precision

    @cached_property
    def prior_gradient(self) -> Array:
        gradient = np.zeros(len(self.precision))
        gradient[BENDING] = self.precision[BENDING] * self.state.intrinsics[BENDING]
        gradient[ARM] = self.state.c
        return gradient

    def cost(self, corner_scale: float) -> float:
        """chi2 of corners and priors; infinite where a corner is behind a camera."""
        prior = self.precision[BENDING] @ self.state.intrinsics[BENDING] ** 2 + self.state.c @ self.state.c
        return float(self.chi2 / corner_scale**2 + prior + np.sum(self.state.z**2))

    def normal(self, scales: Array) -> Bordered:
        """Normal equations for scales (3,) of the standard deviations of corners, own translations and own rotations."""
        own, information = self.by_own(scales[1:]), self.information / scales[0] ** 2
        left, gradient = np.swapaxes(self.by_common, 1, 2) @ information, self.gradient / scales[0] ** 2
        own_left = np.swapaxes(own, 1, 2)
        return Bordered(
            np.sum(left @ self.by_common, axis=0) + np.diag(self.precision),
            left @ own,
            own_left @ information @ own + np.eye(own.shape[2]),
            np.einsum("vip,vi->p", self.by_common, gradient) + self.prior_gradient,
            np.einsum("vik,vi->vk", own, gradient) + self.state.z,
        )

    def with_own_at_zero(self, scales: Array) -> "Linearised":
        """As if no view had errors of its own, to first order."""
        back = -np.einsum("vik,vk->vi", self.by_own(scales[1:]), self.state.z)
        moved = np.einsum("vij,vj->vi", self.information, back)
        chi2 = self.chi2 + float(np.sum(back * (2 * self.gradient + moved)))
        state = replace(self.state, z=np.zeros_like(self.state.z))
        return replace(self, state=state, gradient=self.gradient + moved, chi2=chi2)


def linearise(state: State, sightings: Sightings, flange: FlangeModel, scales: Array) -> Linearised:
    """Residuals and exact derivatives at a state; scales (2,) of each view's own translations and rotations."""
    prior = flange(state.c)
    own = np.einsum("vik,vk->vi", np.repeat(scales, 3)[:, None] * prior.root, state.z)
    T_flange_flange = pose_exp(own)
    T_base_camera = prior.T_world_camera * T_flange_flange * state.T_flange_camera
    T_camera_board = T_base_camera.inv() * state.T_base_board
    p = np.einsum("vij,nj->vni", T_camera_board.rotation.as_matrix(), sightings.points)
    p = p + T_camera_board.translation[:, None]
    used = sightings.used
    behind = bool(np.any(used & (p[..., 2] <= 0)))
    p = np.where((p[..., 2] > 0)[..., None], p, (0.0, 0.0, 1.0))
    pixels, by_point, by_intrinsics = projection(state.camera, p)
    residuals = np.where(used[..., None], pixels - sightings.pixels, 0.0)
    J = np.concatenate([by_intrinsics, by_point @ point_by_twist(p)], axis=-1)
    J = (sightings.whitening @ J).reshape(len(p), -1, TWIST.stop)
    whitened = np.einsum("vnij,vnj->vni", sightings.whitening, residuals).reshape(len(p), -1)
    T_camera_flange = adjoint(state.T_flange_camera.inv())
    by_arm = T_camera_flange @ adjoint(T_flange_flange.inv()) @ prior.common
    twists = np.broadcast_to(np.eye(6), (len(p), 6, 6))
    by_common = np.zeros((len(p), TWIST.stop, ARM.start + prior.common.shape[2]))
    by_common[:, LENSES, LENSES] = np.eye(LENSES.stop)
    by_common[:, TWIST, TWIST.start :] = np.concatenate([twists, -adjoint(T_camera_board), by_arm], axis=2)
    return Linearised(
        state,
        residuals,
        np.swapaxes(J, 1, 2) @ J,
        np.einsum("vni,vn->vi", J, whitened),
        np.inf if behind else float(np.sum(whitened**2)),
        by_common,
        T_camera_flange @ _right_jacobian(own),
        prior.root,
        T_camera_board.inv(),
    )


def distortion_sigma(camera: Camera) -> Array:
    """Prior standard deviations (5,) of (k1, k2, p1, p2, k3): `BENT`."""
    r2 = ((camera.width / camera.fx) ** 2 + (camera.height / camera.fy) ** 2) / 4
    return BENT / np.array([r2, r2**2, 3 * np.sqrt(r2), 3 * np.sqrt(r2), r2**3])


def _right_jacobian(twists: Array) -> Array:
    """(V, 6, 6): exp(xi + d) = exp(xi) exp(J d); to second order, as xi is small."""
    turn = np.zeros((len(twists), 6, 6))
    turn[:, :3, :3] = turn[:, 3:, 3:] = cross_matrix(twists[:, 3:])
    turn[:, :3, 3:] = cross_matrix(twists[:, :3])
    return np.eye(6) - turn / 2 + turn @ turn / 6
