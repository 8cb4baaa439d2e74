"""The queries that every object answers about its exact geometry, in world coordinates."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from extremal.estimator.errors import InvalidInput, SceneError
from extremal.scenes.curves import Appearance, Array, Piece, SurfaceCurve
from extremal.scenes.grids import MEASURED, Facets
from extremal.scenes.mjcf import Spec, add_pieces

FARTHEST = 1e6  # [m] of a point that is asked about
UNSETTLED = 1e-9  # [m] step of Newton's method after which a point is not found


@dataclass(frozen=True, kw_only=True, eq=False)
class Surface(ABC):
    """The closed surface of a solid object, with exact ground truth.

    All public methods take and return world coordinates, batched (..., 3), in metres. A subclass answers in
    the object frame through the underscored methods. Points given to the differential queries are taken to
    lie on the surface.

    With n the outward unit normal, S = dn/dp is the Weingarten map as a symmetric (3, 3) matrix with S n = 0:
    the normal curvature along a unit tangent d is d' S d, positive where the surface is convex seen from
    outside; the principal curvatures are its eigenvalues in the tangent plane.

    Attributes:
        name: unique in its scene.
        T_world_object: pose; maps object coordinates to world coordinates.
        appearance: colour and reflectance.
    """

    name: str = ""
    T_world_object: RigidTransform = field(default_factory=RigidTransform.identity)
    appearance: Appearance = field(default_factory=Appearance)

    def __post_init__(self) -> None:
        if not self.name:
            object.__setattr__(self, "name", type(self).__name__.lower())
        if not isinstance(self.name, str) or "/" in self.name or len(self.name) > 60:
            raise SceneError(f"object name is {self.name!r}; accepted: up to 60 characters without '/'")
        if not self.T_world_object.single:
            raise SceneError(f"{self.name}: T_world_object must be a single transform")
        if not np.all(np.abs(self.T_world_object.as_matrix()) <= 100):
            raise SceneError(f"{self.name}: position must be finite and within 100 m of the origin")
        self._check()

    @property
    def _grazing_margin(self) -> float:
        """Distance [m] before a contour point within which the ray's grazing of the surface is no occlusion."""
        return 2e-4

    # What a subclass answers, in the object frame.

    @abstractmethod
    def _check(self) -> None:
        """Raise SceneError where the shape's own values are unacceptable."""

    @property
    @abstractmethod
    def _bounds(self) -> tuple[Array, float]:
        """Centre (3,) and radius [m] of a sphere around the object."""

    @abstractmethod
    def _frame(self, p: Array) -> tuple[Array, Array]:
        """Outward unit normals (..., 3) and Weingarten maps (..., 3, 3) at points (..., 3) of the surface."""

    @abstractmethod
    def _level(self, p: Array) -> Array:
        """Signed distance (...) to the smooth surface, exact to first order near it."""

    @abstractmethod
    def _signed_distance(self, p: Array) -> Array:
        """Exact signed distance (N,) of points (N, 3), negative inside."""

    @abstractmethod
    def _intersect(self, origins: Array, directions: Array) -> Array:
        """First t > 0 (N,) at which origins + t directions (N, 3) meet the surface; inf where none."""

    @abstractmethod
    def _contour(self, centre: Array) -> list[Array]:
        """Ordered points (N, 3) of the contour generators seen from `centre` (3,)."""

    @abstractmethod
    def _fixed(self) -> list[SurfaceCurve]:
        """Creases and outlines of markings, in the object frame, `visible` all true."""

    @abstractmethod
    def _pieces(self, facets: Facets = MEASURED) -> list[Piece]:
        """The meshes that stand for the object in MuJoCo, curved sides cut into facets."""

    # Frames.

    @cached_property
    def _rotation(self) -> Array:
        return self.T_world_object.rotation.as_matrix()

    def _local(self, p_world: ArrayLike) -> Array:
        return (np.asarray(p_world, float) - self.T_world_object.translation) @ self._rotation

    def _world(self, p_object: Array) -> Array:
        return p_object @ self._rotation.T + self.T_world_object.translation

    def _world_frame(self, points: ArrayLike) -> tuple[Array, Array]:
        n, S = self._frame(self._local(points))
        return n @ self._rotation.T, self._rotation @ S @ self._rotation.T

    @property
    def bounding_sphere(self) -> tuple[Array, float]:
        """Centre (3,) and radius [m] of a sphere that holds the object."""
        centre, radius = self._bounds
        return self._world(centre), radius

    # Differential geometry.

    def normals(self, points: ArrayLike) -> Array:
        """Outward unit normals (..., 3) at points (..., 3) of the surface."""
        return self._frame(self._local(points))[0] @ self._rotation.T

    def normal_curvature(self, points: ArrayLike, directions: ArrayLike) -> Array:
        """Normal curvature (...) [1/m] along the tangential part of `directions` (..., 3); > 0 if convex."""
        n, S = self._world_frame(points)
        d = np.asarray(directions, float)
        d = d - np.sum(d * n, axis=-1, keepdims=True) * n
        return np.einsum("...i,...ij,...j->...", d, S, d) / np.sum(d * d, axis=-1)

    def section_radius(self, points: ArrayLike, plane_normals: ArrayLike) -> Array:
        """Signed radius of curvature (...) [m] of the curve in which planes cut the surface.

        Meusnier: R_section = R_normal cos(phi), phi the angle between the surface normal and the plane.
        Positive where the section is convex seen from outside; infinite where it is straight.

        Args:
            points: (..., 3) on the surface.
            plane_normals: (..., 3), of any length.
        """
        e = np.asarray(plane_normals, float)
        e = e / np.linalg.norm(e, axis=-1, keepdims=True)
        tangent = np.cross(self.normals(points), e)
        cos_phi = np.linalg.norm(tangent, axis=-1)
        with np.errstate(divide="ignore"):
            return cos_phi / self.normal_curvature(points, tangent)

    def principal_curvatures(self, points: ArrayLike) -> Array:
        """Principal curvatures (..., 2) [1/m], the smaller first."""
        n, S = self._frame(self._local(points))
        u, v = tangent_basis(n)
        a, b, c = (np.einsum("...i,...ij,...j->...", p, S, q) for p, q in ((u, u), (u, v), (v, v)))
        mean, spread = (a + c) / 2, np.hypot((a - c) / 2, b)
        return np.stack([mean - spread, mean + spread], axis=-1)

    def gaussian_curvature(self, points: ArrayLike) -> Array:
        """Gaussian curvature (...) [1/m^2]."""
        return np.prod(self.principal_curvatures(points), axis=-1)

    # Distances and rays.

    def signed_distance(self, points: ArrayLike) -> Array:
        """Exact signed distance (...) [m] of points (..., 3), negative inside.

        Raises InvalidInput for points that are not finite or absurdly far away.
        """
        p = self._local(_checked(points))
        return self._signed_distance(p.reshape(-1, 3)).reshape(p.shape[:-1])

    def intersect(self, origins: ArrayLike, directions: ArrayLike) -> Array:
        """Distance (N,) [m] along rays to the first point of the surface ahead of them; inf where none.

        Args:
            origins: (N, 3) or (3,).
            directions: (N, 3), of any non-zero length (the result is in their units).
        """
        d = np.asarray(directions, float) @ self._rotation
        o = np.broadcast_to(self._local(origins), d.shape)
        centre, radius = self._bounds
        along = np.sum((centre - o) * d, axis=-1) / np.sum(d * d, axis=-1)
        near = np.linalg.norm(o + np.maximum(along, 0)[:, None] * d - centre, axis=-1) <= radius
        t = np.full(len(d), np.inf)
        if near.any():
            t[near] = self._intersect(o[near], d[near])
        return t

    # Curves.

    def contour_generator(self, centre: ArrayLike) -> list[SurfaceCurve]:
        """Curves on which the surface turns away from `centre` (3,): normal . (r - centre) = 0.

        `visible` says where the surface is convex along the ray and the object does not hide itself. Raises InvalidInput
        for a centre that is not finite or absurdly far away.
        """
        centre = _checked(centre)
        curves = []
        for i, points in enumerate(self._contour(self._local(centre))):
            p = self._world(points)
            n, S = self._world_frame(p)
            ray = p - centre
            distance = np.linalg.norm(ray, axis=-1)
            visible = np.einsum("ni,nij,nj->n", ray, S, ray) > -1e-9  # 0 where a superquadric is flat
            hit = self.intersect(centre, ray[visible] / distance[visible, None])
            visible[visible] = hit >= distance[visible] - self._grazing_margin
            curves.append(SurfaceCurve(f"{self.name}/limb{i}", self.name, "extremal", p, n, visible))
        return curves

    def fixed_curves(self) -> list[SurfaceCurve]:
        """Creases and outlines of markings as polylines sampled every 0.5 mm or finer."""
        return [
            replace(
                curve,
                points=self._world(curve.points),
                normals=curve.normals @ self._rotation.T,
                other_normals=None if curve.other_normals is None else curve.other_normals @ self._rotation.T,
            )
            for curve in self._fixed()
        ]

    def contour_points_in_planes(
        self, start: ArrayLike, centre: ArrayLike, plane_normals: ArrayLike
    ) -> Array:
        """Points (N, 3) of the contour generator that lie in planes through `centre`, by Newton from `start`.

        Solves level(r) = 0, n.(r - centre) = 0 and e.(r - centre) = 0; as grad level = n and
        grad n.(r - centre) = n + S (r - centre) on the surface, convergence is quadratic.

        Args:
            start: (N, 3) near the points.
            centre: (3,) camera centre.
            plane_normals: (N, 3) normals e of the planes.

        Returns:
            NaN where there is no such point near: a plane along the contour generator, or none at all.
        """
        step = np.zeros(np.shape(start))
        c, p = self._local(centre), self._local(start)
        e = np.asarray(plane_normals, float) @ self._rotation
        for _ in range(30):
            n, S = self._frame(p)
            ray = p - c
            residual = np.stack([self._level(p), np.sum(n * ray, -1), np.sum(e * ray, -1)], axis=-1)
            rows = np.stack([n, n + np.einsum("nij,nj->ni", S, ray), e], axis=-2)
            rows[np.linalg.det(rows) == 0] = np.nan  # one point without a step is no error of the others
            step = np.linalg.solve(rows, residual[..., None])[..., 0]
            # Steps longer than 5 mm leave the region where the linear model means anything.
            step *= np.minimum(1, 5e-3 / np.maximum(np.linalg.norm(step, axis=-1, keepdims=True), 1e-300))
            p = p - step
            if not np.any(np.abs(step) > 1e-13):
                break
        settled = np.all(np.abs(step) < UNSETTLED, axis=-1, keepdims=True)
        return np.where(settled, self._world(p), np.nan)

    def add_to(self, spec: Spec, facets: Facets = MEASURED) -> None:
        """Add the object to a MuJoCo model: one fixed body, one visual mesh geom a colour."""
        add_pieces(spec, self.name, self.T_world_object, self.appearance, self._pieces(facets))


def _checked(points: ArrayLike) -> Array:
    p = np.asarray(points, float)
    if not np.all(np.abs(p) <= FARTHEST):
        raise InvalidInput(
            f"a point is {p[~(np.abs(p) <= FARTHEST)][0]} m away; accepted: up to {FARTHEST:g}"
        )
    return p


def tangent_basis(normals: Array) -> tuple[Array, Array]:
    """Two unit vectors (..., 3) that complete unit normals (..., 3) to a right-handed frame."""
    axis = np.eye(3)[np.argmin(np.abs(normals), axis=-1)]
    u = np.cross(normals, axis)
    u /= np.linalg.norm(u, axis=-1, keepdims=True)
    return u, np.cross(normals, u)
