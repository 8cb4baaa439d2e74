"""A map of sections that holds still while cameras are found: as the first camera really saw them, at a scale of its own.

Where T_i = T_believed,i exp(root_i z_i) is the pose of view i in the robot's world,

    M_i = T_believed,0 scaled(T_0^-1 T_i, 1 / scale)

is that in the map. What tangent planes tell of the sections does not depend on z_0, and the scale of the map can be held by
their depths; z_0 and log(scale) only tell where the robot's world lies.
"""

from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np

from extremal.estimator.adjustment import robust_factor
from extremal.estimator.arrowhead import Rows
from extremal.estimator.camera import Array

SCALE, FORCE = -2, -1  # among what views share: log(scale), and the multiplier that holds the mean depth
TERMS = 7  # of the exponential series


@dataclass(frozen=True, eq=False)
class Views:
    """W views: believed poses (W, 4, 4), roots (W, 6, K), tangent planes (W, n, 3), sigma (W, n), pose errors z (W, K);
    anchor (W,) marks the first of all."""

    believed: Array
    root: Array
    normals: Array
    sigma: Array
    z: Array
    anchor: np.ndarray

    def __len__(self) -> int:
        return len(self.z)

    def __getitem__(self, at: slice) -> "Views":
        return Views(*(getattr(self, f.name)[at] for f in fields(self)))

    def then(self, other: "Views") -> "Views":
        """These views and others."""
        both = [(getattr(self, f.name), getattr(other, f.name)) for f in fields(self)]
        return Views(*(np.concatenate(pair) for pair in both))

    @property
    def poses(self) -> Array:
        return self.believed @ _exp(np.einsum("wik,wk->wi", self.root, self.z))


@dataclass(frozen=True, eq=False)
class SceneMap:
    """Where n sections lie.

    Attributes:
        origin: (n, 3) [m], frame: (n, 3, 3) as in `support`: in the map, and where the robot believes them in the world.
        overlap: number of neighbouring sections that repeat each other's errors (`adjustment.adjust`): rows count less.
        first: the first view. shared: (C,) what all views share: z_0, SCALE and FORCE.
    """

    origin: Array
    frame: Array
    overlap: float
    first: Views
    shared: Array

    @property
    def scale(self) -> float:
        """Size of the world in units of the map."""
        return float(np.exp(self.shared[SCALE]))

    @cached_property
    def first_pose(self) -> Array:
        """(4, 4) pose of the first view in the world."""
        return replace(self.first, z=self.shared[None, :SCALE]).poses[0]

    @property
    def distance(self) -> Array:
        """(n,) [m] of the origins from the first camera."""
        return np.linalg.norm(self.origin - self.first.believed[0, :3, 3], axis=1)

    def residuals(self, rows: Rows, views: Views, theta: Array) -> Array:
        """Residuals (W, n) in standard deviations."""
        linear = rows.common @ self.shared + np.einsum("wnk,wk->wn", rows.own, views.z)
        return rows.y - np.einsum("wni,ni->wn", rows.X, theta) + linear

    def rows(self, views: Views, theta: Array, robust: bool = True) -> Rows:
        """Views linearised at theta (n, 3) or (W, n, 3), with derivatives of the *predicted* planes (see `elimination`)."""
        rotation, centre, own, common = self._in_map(views)
        frame, (s, q, R) = self.frame, np.moveaxis(theta, -1, 0)
        normals = views.normals @ np.swapaxes(rotation, 1, 2)
        lever = centre[:, None] - self.origin
        a, b, _ = np.moveaxis(np.einsum("wnk,njk->wnj", normals, frame), -1, 0)
        rho = np.maximum(np.hypot(a, b), 1e-12)
        contact = np.stack([s - R + R * a / rho, q + R * b / rho], axis=-1)
        arm = lever - np.einsum("wnj,njk->wnk", contact, frame[:, :2])
        square = np.einsum("wnk,wnk->wn", arm, arm)
        misses = np.einsum("wnk,wnk->wn", normals, lever) - (a * s + b * q + (rho - a) * R)
        ahead = np.einsum("wnk,wk->wn", arm, rotation[:, :, 2]) < 0
        weight = np.where(ahead, 1 / (views.sigma * np.sqrt(square)), 0.0)
        if robust:
            weight = weight * robust_factor(weight * misses)
        weight = weight / np.sqrt(self.overlap)
        normals = (normals - (misses / square)[..., None] * arm) * weight[..., None]
        a, b, off = np.moveaxis(np.einsum("wnk,njk->wnj", normals, frame), -1, 0)
        X = np.stack([a, b, np.hypot(a, b) - a], axis=-1)
        moved = np.concatenate([normals, np.cross(normals, arm)], axis=-1)
        common, own = moved @ common, moved @ own
        linear = common @ self.shared + np.einsum("wnk,wk->wn", own, views.z)
        y = weight * misses + np.sum(X * theta, axis=-1) - linear
        return Rows(X, y, off, common, own)

    def _in_map(self, views: Views) -> tuple[Array, Array, Array, Array]:
        """Rotations (W, 3, 3) and centres (W, 3) of the cameras in the map, and their motion there (translation, rotation
        vector) per unit of the views' own unknowns (W, 6, K) and of the shared ones (W, 6, C)."""
        first, believed, root = self.first_pose, self.first.believed[0, :3, :3], self.first.root[0]
        poses, shrink = np.where(views.anchor[:, None, None], first, views.poses), 1 / self.scale
        turn = believed @ first[:3, :3].T  # from the world to the map
        rotation = turn @ poses[:, :3, :3]
        shift = (poses[:, :3, 3] - first[:3, 3]) @ first[:3, :3]  # in the first camera
        own = np.concatenate([shrink * rotation @ views.root[:, :3], rotation @ views.root[:, 3:]], axis=1)
        common = np.zeros((len(views), 6, len(self.shared)))
        common[:, :3, :SCALE] = -shrink * believed @ (root[:3] - _cross_columns(shift, root[3:]))
        common[:, 3:, :SCALE] = -believed @ root[3:]
        common[:, :3, SCALE] = -shrink * shift @ believed.T
        common[views.anchor] = 0.0
        centre = self.first.believed[0, :3, 3] + shrink * shift @ believed.T
        return rotation, centre, own, common

    def in_world(self, theta: Array, slope: Array) -> tuple[Array, Array]:
        """theta (n, 3) in the planes of the sections as they lie in the world, and its change (n, 3, C - 1) per unit of what
        is shared but the FORCE. slope: (n, 3) change of theta as its plane moves along its normal."""
        first, believed, root = self.first_pose, self.first.believed[0], self.first.root[0]
        scale = self.scale
        mapped = self.origin + np.einsum("ni,nij->nj", theta[:, :2], self.frame[:, :2])
        seen = scale * (mapped - believed[:3, 3]) @ believed[:3, :3]  # in the first camera
        at = np.einsum("nij,nj->ni", self.frame, seen @ first[:3, :3].T + first[:3, 3] - self.origin)
        moved = np.concatenate([root[:3] - _cross_columns(seen, root[3:]), seen[:, :, None]], axis=2)
        moved = self.frame @ (first[:3, :3] @ moved)
        offset, shift = at[:, 2].copy(), moved[:, 2].copy()
        at[:, 2], moved[:, 2], moved[:, 2, -1] = scale * theta[:, 2], 0.0, scale * theta[:, 2]
        moved = moved + slope[:, :, None] * shift[:, None]
        return at + slope * offset[:, None], moved


def _exp(errors: Array) -> Array:
    """Matrices (W, 4, 4) of exp of twists (W, 6), as `poses.pose_exp` but fast for few and small ones."""
    t, (x, y, z) = errors[:, :3], errors[:, 3:].T
    twist = np.zeros((len(errors), 4, 4))
    twist[:, :3, 3] = t
    twist[:, 0, 1], twist[:, 0, 2], twist[:, 1, 2] = -z, y, -x
    twist[:, 1, 0], twist[:, 2, 0], twist[:, 2, 1] = z, -y, x
    out = np.eye(4) + twist / TERMS
    for k in range(TERMS - 1, 0, -1):
        out = np.eye(4) + twist @ out / k
    return out


def _cross_columns(vectors: Array, columns: Array) -> Array:
    """vectors (..., 3) x columns (3, K): (..., 3, K)."""
    return np.swapaxes(np.cross(vectors[..., None, :], columns.T), -1, -2)
