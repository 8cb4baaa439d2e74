"""What is believed of a vase beyond its contour generator: a lathe of uncertain radius, and how a cup's rim would meet it."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.stats import norm, qmc, truncnorm

from extremal.estimator.camera import Array
from extremal.estimator.errors import InvalidInput
from extremal.scenes import Lathe
from extremal.tasks.grasp_motion import cup_facing
from extremal.tasks.planning.belief import ArcBelief
from extremal.tasks.suction import Seal, SuctionCup

SMALLEST, LARGEST = (
    0.01,
    0.12,
)  # radii that what is grasped may have [m]: all that is known where sigma is infinite
SURE, UNSURE = 1e-6, 1.0  # sigmas of the radius are taken within [m]
SPACING = 0.008  # between knots of the profile [m]: contact points within are averaged
BEYOND = 0.02  # by which the profile goes on straight at its ends [m]: a lip's radius and a little more
LIKE_PLANE = (
    0.05  # sine of the angle between a line of sight and the normal above which the hidden side is not known
)
ROUNDS = 5  # of the fixed point for a ray's travel; each leaves about the square of the profile's slope


@dataclass(frozen=True, eq=False)
class BelievedLathe:
    """Circular sections about one axis; through the contour generator, which is known well; of a radius that is known less well.

    The estimate of R comes from the contour's acceleration, that of the tangent plane from the contour itself: where R is
    wrong by dR the circle still touches the plane at the contact point, and its centre is off by dR along the normal
    (Cipolla ch. 3, eq. 3.21: p0.N + R is what is seen). At azimuth a beyond the contour generator the surface is then off by
    dR (1 - cos a) along its normal, and the normal of a point, if kept, by dR sin a sideways.

    The frame: z along the axis, 0 where the world's origin is; x from the axis to the contour generator.

    Attributes:
        T_world_lathe: of that frame.
        heights: (K,) increasing [m], along z.
        radii: (K,) there [m]; a natural cubic spline passes through them.
        side: 1 or -1, the sign of y where the surface turns away from the camera.
        sigma_radius: of all radii in common, from 1e-6 to 1 [m].
        sigma_point: of the contour generator, along x [m].
    """

    T_world_lathe: RigidTransform
    heights: Array
    radii: Array
    side: float
    sigma_radius: float
    sigma_point: float
    _spline: CubicSpline = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if not (np.all(np.isfinite(self.radii)) and np.all(self.radii > 0)):
            radii = np.round(self.radii, 4).tolist()
            raise InvalidInput(
                f"radii of the believed lathe are {radii} m; accepted: positive ones. Do its contact points belong to one "
                "contour generator, and its axis to one body of revolution?"
            )
        if not SURE <= self.sigma_radius <= UNSURE or not 0 <= self.sigma_point < np.inf:
            raise InvalidInput(
                f"sigmas are {self.sigma_radius!r}, {self.sigma_point!r}; accepted: {SURE:g} to {UNSURE:g}, and from 0 [m]"
            )
        object.__setattr__(self, "_spline", CubicSpline(self.heights, self.radii, bc_type="natural"))

    @classmethod
    def of(cls, beliefs: Sequence[ArcBelief], centre: ArrayLike) -> "BelievedLathe":
        """The lathe through the contact points of one contour generator.

        Errors of R are taken as fully correlated: the heights share the poses that cause most of them.

        Args:
            beliefs: one or more, at any heights; axes along the vase's.
            centre: (3,) camera centre from which the contour generator is seen, about.

        Raises:
            InvalidInput: no belief, a camera centre that does not tell the hidden side, or points of no lathe.
        """
        if not beliefs:
            raise InvalidInput("there are no beliefs; accepted: one or more contact points")
        axis = _common_axis(beliefs)
        p, n = (np.array([getattr(b, name) for b in beliefs]) for name in ("point", "normal"))
        sigma = np.clip([b.sigma_radius for b in beliefs], SURE, UNSURE)
        weight = sigma**-2 / np.sum(sigma**-2)
        across = n - np.outer(n @ axis, axis)
        lean = np.linalg.norm(across, axis=1)
        across = across / lean[:, None]
        R = np.clip([b.radius for b in beliefs], SMALLEST, LARGEST)
        origin = weight @ (p - R[:, None] * across)
        origin = origin - (origin @ axis) * axis
        radii = np.sum((p - origin) * across, axis=1)
        heights, radii = _profile(p @ axis, radii, -(n @ axis) / lean)
        x = weight @ across
        x = x / np.linalg.norm(x)
        y = np.cross(axis, x)
        side = _hidden_side(p.mean(axis=0), centre, y)
        T = RigidTransform.from_components(origin, Rotation.from_matrix(np.stack([x, y, axis], axis=1)))
        common = float(np.clip(weight @ sigma, SURE, UNSURE))
        return cls(T, heights, radii, side, common, max(b.sigma_point for b in beliefs))

    @property
    def span(self) -> tuple[float, float]:
        """Heights of the lowest and the highest contact point [m]."""
        return float(self.heights[0] + BEYOND), float(self.heights[-1] - BEYOND)

    def radius(self, heights: ArrayLike) -> Array:
        """The likeliest radii (...) at heights (...) [m]; those of the ends beyond."""
        return self._spline(np.clip(heights, self.heights[0], self.heights[-1]))

    @cached_property
    def _least(self) -> float:
        """dR [m] at which the smallest radius is as small as may be."""
        return min(SMALLEST - float(np.min(self.radii)), -SURE)

    @property
    def _most(self) -> float:
        return max(LARGEST - float(np.mean(self.radii)), SURE)

    def radius_error(self, probability: ArrayLike) -> Array:
        """dR (...) [m]: quantiles of the belief, which knows that radii are 10 to 120 mm."""
        s = self.sigma_radius
        return truncnorm.ppf(probability, self._least / s, self._most / s, scale=s)

    def draw(self, count: int, place: float) -> Array:
        """Errors (count, 3) [m] that the belief allows: dR, and of the axis along x and y; evenly spread, the same each time.

        Args:
            place: standard deviation of whatever else moves cup and lathe against each other, each axis [m].
        """
        even = qmc.Halton(3, scramble=False)
        even.fast_forward(1)
        u = even.random(count)
        shift = norm.ppf(u[:, 1:]) * (np.hypot(self.sigma_point, place), place)
        return np.column_stack([self.radius_error(u[:, 0]), shift])

    def contacts(
        self, azimuths: ArrayLike, heights: ArrayLike, errors: ArrayLike, lip: float
    ) -> RigidTransform:
        """T_world_cup (N): the lip's middle on the lathe that is off by dR, square to the chord of the meridian under the lip.

        Args:
            azimuths: (N,) beyond the contour generator, positive on the hidden side [rad].
            heights: (N,) [m].
            errors: (N,) dR [m].
            lip: radius of the lip [m].
        """
        a, z, dR = np.asarray(azimuths, float), np.asarray(heights, float), np.asarray(errors, float)
        u = np.stack([np.cos(a), self.side * np.sin(a), np.zeros_like(a)], axis=-1)
        p = (self.radius(z) + dR)[:, None] * u + np.stack([-dR, np.zeros_like(a), z], axis=-1)
        slope = (self.radius(z + lip) - self.radius(z - lip)) / (2 * lip)
        n = u - slope[:, None] * (0.0, 0.0, 1.0)
        n = n / np.linalg.norm(n, axis=1, keepdims=True)
        return cup_facing(self.T_world_lathe.apply(p), self.T_world_lathe.rotation.apply(n))

    def rims(self, cup: SuctionCup, T_world_cup: RigidTransform, errors: Array) -> Seal:
        """How the rims of cups (N) would meet the lathes of errors (M, 3) as drawn; travel (N, M, 64).

        A ray o + t d meets the circle of radius r(z) + dR at its height: a quadratic for t, solved again at the height
        that it leads to.
        """
        matrices = (self.T_world_lathe.inv() * T_world_cup).as_matrix()
        o = np.einsum("nij,kj->nki", matrices[:, :3, :3], cup.rim) + matrices[:, None, :3, 3]
        d = matrices[:, :3, 2][:, None, None, :]
        dR, shift_x, shift_y = (errors[:, i][None, :, None] for i in range(3))
        x, y, z = (o[:, None, :, i] for i in range(3))
        x, y = x + dR - shift_x, y - shift_y
        a = d[..., 0] ** 2 + d[..., 1] ** 2
        b = (x * d[..., 0] + y * d[..., 1]) / a
        c = (x * x + y * y) / a
        t = np.zeros(np.broadcast_shapes(b.shape, dR.shape))
        with np.errstate(invalid="ignore"):
            for _ in range(ROUNDS):
                radius = np.where(np.isnan(t), np.nan, self.radius(np.nan_to_num(z + t * d[..., 2])) + dR)
                t = -b - np.sqrt(b * b - c + radius**2 / a)
        return Seal(cup, np.where(np.isnan(t), np.inf, t))

    def surface(self, error: float, name: str) -> Lathe:
        """The lathe that is off by dR = `error` [m], down to the world's origin, in world coordinates."""
        low = min(0.0, float(self.heights[0]))
        count = int(np.ceil((self.heights[-1] - low) / SPACING)) + 1
        z = np.linspace(low, self.heights[-1], max(count, 2))
        pose = self.T_world_lathe * RigidTransform.from_translation([-error, 0.0, low])
        return Lathe(z - low, self.radius(z) + error, name=name, T_world_object=pose)


def _common_axis(beliefs: Sequence[ArcBelief]) -> Array:
    """Mean of the beliefs' axes (3,), which have either sign; upwards."""
    axes = np.array([b.axis for b in beliefs])
    axis = np.sum(axes * np.sign(axes @ axes[0])[:, None], axis=0)
    return axis * (np.sign(axis[2]) or 1.0) / np.linalg.norm(axis)


def _hidden_side(point: Array, centre: ArrayLike, y: Array) -> float:
    """Sign of the direction along y (3,) in which a surface turns away from a camera that sees its contour at `point`."""
    ray = point - np.asarray(centre, float)
    turned = float(ray @ y)
    if not abs(turned) > LIKE_PLANE * np.linalg.norm(ray):
        raise InvalidInput(
            f"the camera at {np.asarray(centre).tolist()} looks along the normal or the axis; accepted: a centre (3,) from which "
            f"{np.round(point, 3).tolist()} is on the contour generator"
        )
    return float(np.sign(turned))


def _profile(heights: Array, radii: Array, slopes: Array) -> tuple[Array, Array]:
    """Knots (K,) of the profile through means of neighbouring points, going on straight by `BEYOND` at both ends."""
    bins = np.unique(np.floor((heights - heights.min()) / SPACING), return_inverse=True)[1]
    z, r, slope = (np.bincount(bins, v) / np.bincount(bins) for v in (heights, radii, slopes))
    low, high = z[0] - BEYOND, z[-1] + BEYOND
    ends = r[0] - BEYOND * slope[0], r[-1] + BEYOND * slope[-1]
    return np.concatenate([[low], z, [high]]), np.concatenate([[ends[0]], r, [ends[1]]])
