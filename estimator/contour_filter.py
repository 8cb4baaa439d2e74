"""Contour bundle adjustment frame by frame: what all views so far tell of sections, in constant time and memory.

Unknown are theta_j = (s, q, R) of n sections (`support`) and the pose errors of every view, as in `adjustment`. A view
adds one tangent plane a section and is linearised; an information filter keeps the sum (`arrowhead`). The last few
views wait in a window, where they are linearised anew with every view that arrives.

A view that is linearised for good must not be overtaken by large corrections, yet one thing stays uncertain to the end:
where the whole scene lies, and how large it is, in the robot's world. So sections are described in a map (`scene_map`),
and where the robot's world lies in it is an unknown that all views share. Errors common to all views (`PosePrior.common`,
the focal length) are not supported.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from extremal.estimator.adjustment import LOOSE
from extremal.estimator.arrowhead import Arrowhead, Rows
from extremal.estimator.camera import Array
from extremal.estimator.elimination import UNRESOLVED
from extremal.estimator.errors import DegenerateGeometry, InvalidInput
from extremal.estimator.scene_map import FORCE, SCALE, SceneMap, Views

START, WINDOW = 14, 2  # views that are linearised anew: at the start, until depths are known, and later
RANK = 30  # combinations of past camera errors that are kept
OWN_SAY = 0.75  # of what a view itself says of where it is linearised for good, the part that is taken out
ACROSS_PRIOR, RADIUS_PRIOR = 0.1, 0.06  # [m] sigma of s and R at first; only predictions feel it
FINEST = 1e-8  # [rad] below it rounding, squares of what poses leave open against this, is the largest error
UNIT, NEARLY = 1e-6, 1e-2  # what frames may be off by; and lengths of normals, which edge errors change
COLLAPSED = 10.0  # logarithm of the map's scale against the robot's, which no arm is wrong by
OPEN = 1e-3  # of the information of the prior, for sections that the planes don't determine


@dataclass(frozen=True, eq=False)
class SectionEstimates:
    """Sections (n) after the views so far, as `adjustment.Shapes` describes them.

    theta: (n, 3), s and q [m] of the contact point where phi = 0, and R; covariance: (n, 3, 3), the cameras' uncertainty
    included. radius, sigma_radius: (n,) [m]; for a fixed section they are what its own planes say while all others are held
    as they are. own_variance: (n,) [m^2] and shared: (n, m): radii of free i and j have covariance shared_i . shared_j.
    valid: (n,) whether the planes determine the section; sigma and covariance are infinite elsewhere.
    """

    theta: Array
    covariance: Array
    radius: Array
    sigma_radius: Array
    own_variance: Array
    shared: Array
    valid: np.ndarray


class ContourFilter:
    """Information filter on sections and cameras.

    Attributes:
        fixed: (n,) sections that are believed to be fixed: where views are linearised, and how cameras move. Nothing is
            committed to it; it may change with every view.
        count: views taken in.
        pose_covariance: (6, 6) of the latest view's pose, in its frame.
    """

    def __init__(self, origin: Array, frame: Array, sigma_depth: Array, overlap: float = 1.0) -> None:
        """
        Args:
            origin: (n, 3) [m] near the contact points. frame: (n, 3, 3) rows N_0, T_0, N_0 x T_0 in the world.
            sigma_depth: (n,) [m] standard deviation of the origin along T_0, to start from; the estimates don't contain it.
            overlap: number of neighbouring sections that repeat each other's errors, as in `adjustment.adjust`.

        Raises InvalidInput for other shapes, numbers that are not finite, frames that are not orthonormal, a
        sigma_depth that is not positive, or overlap < 1.
        """
        n = len(origin)
        shapes = np.shape(origin), np.shape(frame), np.shape(sigma_depth)
        if shapes != ((n, 3), (n, 3, 3), (n,)) or not np.all(np.isfinite(origin)):
            raise InvalidInput(
                f"origin, frame, sigma_depth are {shapes}; accepted: finite numbers of shapes (n, 3), (n, 3, 3), (n,)"
            )
        off = np.abs(frame @ np.swapaxes(frame, 1, 2) - np.eye(3)).max(initial=0.0)
        if not off < UNIT:
            raise InvalidInput(
                f"rows of a frame are {off:.2g} from orthonormal ones; accepted: below {UNIT:g}"
            )
        if not np.all((sigma_depth > 0) & np.isfinite(sigma_depth)):
            raise InvalidInput(f"sigma_depth is {sigma_depth!r:.200}; accepted: positive numbers [m]")
        if not 1 <= overlap < np.inf:
            raise InvalidInput(f"overlap is {overlap!r}; accepted: a finite number from 1")
        self._overlap = overlap
        self.fixed, self.count = np.zeros(n, bool), 0
        self._origin, self._frame, self._theta = origin, frame, np.zeros((n, 3))
        self._prior = np.zeros((n, 3, 3))
        self._prior[:, 0, 0], self._prior[:, 1, 1] = ACROSS_PRIOR**-2, sigma_depth**-2.0
        self._prior[:, 2, 2] = RADIUS_PRIOR**-2
        self._scale_is_free: bool | None = None  # not decided before a view is linearised for good

    def update(self, T_world_camera: RigidTransform, root: Array, normals: Array, sigma: Array) -> None:
        """Take in one view.

        Args:
            T_world_camera: believed pose. root: (6, K) square root of its covariance in the camera frame [m], [rad], with
                the same K in all views; 0 where poses are exact.
            normals: (n, 3) unit normals of the tangent planes in the camera frame, on the side of N_0.
            sigma: (n,) [rad] of the planes' angle about the camera centre; infinite where a section is not seen.

        Raises:
            InvalidInput: wrong shapes, a number that is not finite, sigma that is not positive.
            DegenerateGeometry: the views so far don't determine what they share. Nothing is changed by either.
        """
        believed = T_world_camera.as_matrix()
        self._check(believed, root, normals, sigma)
        before = vars(self).copy()  # whose values are replaced, never changed
        try:
            self._take(believed, root, normals, sigma)
        except (DegenerateGeometry, np.linalg.LinAlgError) as error:
            vars(self).clear()
            vars(self).update(before)
            if isinstance(error, DegenerateGeometry):
                raise
            raise DegenerateGeometry(
                "a view's planes are beyond double precision; accepted: sigma that could be"
            ) from error

    def _take(self, believed: Array, root: Array, normals: Array, sigma: Array) -> None:
        view = Views(
            believed[None],
            root[None],
            normals[None],
            np.asarray(sigma)[None],
            np.zeros((1, root.shape[1])),
            np.array([self.count == 0]),
        )
        if self.count == 0:
            self._start(view)
        else:
            self._window = self._window.then(self._resected(view))
        self.count += 1
        self._solve()
        if len(self._window) > (START if self._scale_is_free is None else WINDOW):
            self._absorb()

    def _check(self, believed: Array, root: Array, normals: Array, sigma: Array) -> None:
        n = len(self._origin)
        self._check_fixed(self.fixed)
        K = self._map.first.root.shape[2] if self.count else (*np.shape(root), 0, 0)[1]
        shapes = believed.shape, root.shape, normals.shape, np.shape(sigma)
        if shapes != ((4, 4), (6, K), (n, 3), (n,)):
            raise InvalidInput(
                f"pose, root, normals, sigma are {shapes}; accepted: (4, 4), (6, {K}), ({n}, 3), ({n},)"
            )
        for name, value in (("T_world_camera", believed), ("root", root), ("normals", normals)):
            if not np.all(np.isfinite(value)):
                raise InvalidInput(f"{name} of a view holds a number that is not finite")
        if not np.all(sigma >= FINEST):
            raise InvalidInput(
                f"sigma of a tangent plane is {np.min(sigma):.3g}; accepted: positive from {FINEST:g} rad; infinite: left out"
            )
        off = np.abs(np.linalg.norm(normals[np.isfinite(sigma)], axis=1) - 1).max(initial=0.0)
        if not off < NEARLY:
            raise InvalidInput(
                f"the length of a tangent plane's normal is {off:.2g} from 1; accepted: unit normals"
            )

    def _check_fixed(self, fixed: np.ndarray) -> None:
        if fixed.shape != (n := len(self._origin),) or fixed.dtype != bool:
            raise InvalidInput(f"fixed is {fixed.dtype} {fixed.shape}; accepted: bool ({n},)")

    def _start(self, first: Views) -> None:
        """The first view: its pose error is shared by all others, and in the map it has none itself."""
        n, K = len(self.fixed), first.z.shape[1]
        self._map = SceneMap(self._origin, self._frame, self._overlap, first, np.zeros(K + 2))
        core = np.diag(np.r_[np.ones(K), 0.0, 0.0])
        blank = np.zeros((n, 3))
        self._known = Arrowhead(
            np.zeros((n, 3, 3)), np.zeros((n, 3, K + 2)), core, blank, blank, np.zeros(K + 2)
        )
        self._window = replace(first, root=np.zeros((1, 6, K)))

    def _resected(self, view: Views) -> Views:
        """A new view with the pose error that the sections, as they are known, make most probable."""
        rows = self._map.rows(view, self._theta, robust=False)  # residuals are those of a wrong pose
        own, misses = rows.own[0], self._map.residuals(rows, view, self._theta)[0]
        return replace(view, z=-np.linalg.solve(np.eye(own.shape[1]) + own.T @ own, own.T @ misses)[None])

    def _solve(self) -> None:
        """Sections and cameras of the window, from all views."""
        self._latest = self._map.rows(self._window, self._theta)
        system = self._system(self._latest)
        found = replace(system, blocks=system.blocks + self._prior).solve(self.fixed)
        W, K = self._window.z.shape
        self._theta, self._inverse = found.theta, found.inverse
        self._map = self._with(found.common)
        self._window = replace(self._window, z=found.common[len(found.common) - W * K :].reshape(W, K))
        root = self._map.first.root[0] if self.count == 1 else self._window.root[-1]
        at = np.arange(K) - (0 if self.count == 1 else K)
        self.pose_covariance = root @ found.covariance[np.ix_(at, at)] @ root.T
        if not np.all(np.isfinite(self.pose_covariance)):
            raise DegenerateGeometry("poses are beyond double precision; accepted: roots that could be")

    def _with(self, common: Array) -> SceneMap:
        """The map with what views share as it was found."""
        C = len(self._map.shared)
        if self._scale_is_free and not abs(common[C + SCALE]) < COLLAPSED:
            raise DegenerateGeometry(
                "the views don't determine how large the scene is; accepted: views with a baseline"
            )
        return replace(
            self._map, shared=common[:C] if self._scale_is_free else np.pad(common[: C - 2], (0, 2))
        )

    def _system(self, rows: Rows) -> Arrowhead:
        system = self._known.plus(rows)
        if self._scale_is_free:
            return system
        return system.holding(len(self._map.shared) + np.array([SCALE, FORCE]), np.zeros(2))

    def _absorb(self) -> None:
        """Linearise all but the latest views for good, each where the others would have it rather than itself.

        Derivatives that share the noise of the residuals they meet pull at whatever is known least. Some of a view's own say
        is left in, as the final residuals share noise with it, too.
        """
        if self._scale_is_free is None:
            self._free_scale()
        old, rows = self._window[:-WINDOW], self._latest[:-WINDOW]
        gain = np.einsum("nij,wnj->wni", self._inverse, rows.X)
        left = 1 - np.einsum("wni,wni->wn", gain, rows.X)
        theta = self._theta - (OWN_SAY * self._map.residuals(rows, old, self._theta) / left)[..., None] * gain
        known = self._known.plus(self._map.rows(old, theta))
        shared = self._map.shared
        self._known = known.compressed(len(shared), RANK, self._prior, self._theta, shared)
        self._window = self._window[-WINDOW:]

    def _free_scale(self) -> None:
        """From now on the map keeps its mean depth instead of the robot's scale, unless that is exact."""
        self._scale_is_free = bool(np.any(self._window.root[:, :3]))
        told = np.maximum(1 / self._inverse[:, 1, 1] - self._prior[:, 1, 1], OPEN * self._prior[:, 1, 1])
        weight = told * self._map.distance  # of a relative change of depth
        weight /= np.linalg.norm(weight)
        border, load = self._known.border.copy(), self._known.load.copy()
        border[:, 1, FORCE], load[FORCE] = weight, weight @ self._theta[:, 1]
        self._known = replace(self._known, border=border, load=load)

    def _require_views(self) -> None:
        if self.count == 0:
            raise DegenerateGeometry("no view was taken in yet; accepted: estimates after one or more")

    @property
    def T_world_camera(self) -> RigidTransform:
        """Pose of the latest view; DegenerateGeometry before there is one."""
        self._require_views()
        return RigidTransform.from_matrix(self._map.first_pose if self.count == 1 else self._window.poses[-1])

    def sections(self, fixed: np.ndarray) -> SectionEstimates:
        """Estimates if the sections `fixed` (n,) are: the same information as in `adjustment.adjust`, of order 2 for these.

        Raises DegenerateGeometry before the first view.
        """
        self._require_views()
        self._check_fixed(fixed)
        system = self._system(self._map.rows(self._window, self._theta))
        resolved = _resolved(system.blocks)
        open_ = np.where(resolved, 0.0, OPEN)[:, None, None] * self._prior
        system = replace(system, blocks=system.blocks + open_)
        found = solved = system.solve(fixed)
        there = self._with(found.common)
        if self._scale_is_free:
            found = found.eliminated(len(there.shared) + FORCE)
        scale, slope = there.scale, np.einsum("nij,nj->ni", found.inverse, system.aside)
        theta, moves = there.in_world(found.theta, slope)
        # in the map theta = own error - spread x, x ~ N(0, covariance)
        shared, known = -scale * found.spread, moves.shape[2] - (not self._scale_is_free)
        shared[:, :, :known] += moves[:, :, :known]
        shared = shared @ _root(found.covariance)
        own = scale**2 * found.inverse / self._overlap
        covariance = own + shared @ np.swapaxes(shared, 1, 2)
        radius, variance = theta[:, 2].copy(), covariance[:, 2, 2].copy()
        freed, freed_variance = system.freed(solved)
        freed_variance -= (1 - 1 / self._overlap) * np.linalg.inv(system.blocks)[:, 2, 2]
        radius[fixed], variance[fixed] = scale * freed[fixed], scale**2 * freed_variance[fixed]
        depth = np.sqrt(covariance[:, 0, 0] + covariance[:, 1, 1])
        valid = resolved & (depth < LOOSE * self._map.distance)
        own_variance = np.where(valid, own[:, 2, 2], np.inf)
        covariance[~valid], variance[~valid] = np.inf, np.inf
        return SectionEstimates(
            theta, covariance, radius, np.sqrt(variance), own_variance, shared[:, 2], valid
        )


def _root(covariance: Array) -> Array:
    """Square root of a covariance, of which rounding may have left small negative variances."""
    values, vectors = np.linalg.eigh(covariance)
    return vectors * np.sqrt(np.maximum(values, 0.0))


def _resolved(blocks: Array) -> np.ndarray:
    """Whether information (n, 3, 3) determines all three unknowns: none depends on those before it."""
    a, b, c = blocks[:, 0, 0], blocks[:, 1, 1], blocks[:, 2, 2]
    minor = a * b - blocks[:, 0, 1] ** 2
    return (a > 0) & (minor > UNRESOLVED * a * b) & (np.linalg.det(blocks) > UNRESOLVED * minor * c)
