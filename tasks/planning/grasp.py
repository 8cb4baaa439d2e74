"""Where to grasp a vase of which only the contour generator has been seen, and the grasp from its head to its end."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from extremal.estimator.camera import Array
from extremal.estimator.errors import ExtremalError, InvalidInput
from extremal.scenes import Surface
from extremal.sim import UnreachablePose
from extremal.tasks.grasp_motion import CupKinematics, timed
from extremal.tasks.grasp_outcome import HOLD, LIFT, GraspOutcome
from extremal.tasks.grasp_world import GUARD, GraspWorld
from extremal.tasks.grasp_world import MARGIN as LIFT_MARGIN
from extremal.tasks.planning.belief import ArcBelief
from extremal.tasks.planning.believed_lathe import BelievedLathe
from extremal.tasks.planning.clear_path import ClearPaths
from extremal.tasks.suction import SuctionCup

AZIMUTHS = (np.pi / 4, np.pi / 2)  # beyond the contour generator [rad]
HEIGHTS = (0.06, 0.15)  # [m]
PLACE = 0.001  # by which a typical arm misses a place, each axis [m]
ERRORS = 48  # that the belief allows, evenly spread
AIMS = (0.35, 0.5, 0.65)  # quantiles of the radius for which a pose is made
AZIMUTH_STEP, HEIGHT_STEP = np.radians(15.0), 0.01  # between candidates, at most [rad], [m]
CLEAR = 0.015  # from the pregrasp to where the lip may first touch [m]
FARTHEST = (
    0.95  # quantile of the errors for which that holds, and for which what is believed is kept clear of
)
AT_START = 0.01  # from the start of a plan, at most [rad]
SETTLING = 0.05  # beyond the time for which it has to be held [s]


class NoGrasp(ExtremalError):
    """No pose of the cup has both a chance to seal and a clear way that leads the arm there."""


@dataclass(frozen=True, eq=False)
class GraspPlan:
    """Where the cup goes, and what is expected there.

    Attributes:
        T_world_cup: the lip's middle on the likeliest surface, z along the approach.
        T_world_pregrasp: from where the cup is moved along z until it seals.
        guard: how far beyond `T_world_cup` the approach goes at most [m].
        probability: of a seal, over the belief.
        azimuth: of the contact beyond the contour generator [rad].
        height: of the contact along the vase's axis, from the world's origin [m].
        way: (V, 6) joint positions from the start to the pregrasp, clear of what is believed [rad].
        approach: (V, 6) from there straight to `T_world_end` [rad].
    """

    T_world_cup: RigidTransform
    T_world_pregrasp: RigidTransform
    guard: float
    probability: float
    azimuth: float
    height: float
    way: Array = field(repr=False)
    approach: Array = field(repr=False)

    def __post_init__(self) -> None:
        for name in ("T_world_cup", "T_world_pregrasp"):
            pose = getattr(self, name)
            if not (pose.single and np.all(np.isfinite(pose.as_matrix()))):
                raise InvalidInput(f"{name} must be one finite transform")
        if not 0 < self.probability <= 1:
            raise InvalidInput(f"probability of a seal is {self.probability!r}; accepted: above 0, up to 1")
        if not 0 <= self.guard < 1:
            raise InvalidInput(f"guard is {self.guard!r}; accepted: from 0 to below 1 m")
        for name in ("way", "approach"):
            q = getattr(self, name)
            if q.ndim != 2 or q.shape[1] != 6 or len(q) < 2 or not np.all(np.isfinite(q)):
                raise InvalidInput(
                    f"{name} is {q.shape}; accepted: finite joint positions (V, 6), two or more"
                )

    @property
    def T_world_end(self) -> RigidTransform:
        """Where the guarded approach gives up."""
        return self.T_world_cup * RigidTransform.from_translation([0.0, 0.0, self.guard])


def plan_grasp(
    beliefs: Sequence[ArcBelief],
    centre: ArrayLike,
    arm: CupKinematics,
    start: ArrayLike,
    azimuths: tuple[float, float] = AZIMUTHS,
    heights: tuple[float, float] = HEIGHTS,
    cup: SuctionCup | None = None,
    place: float = PLACE,
    obstacles: Sequence[Surface] = (),
) -> GraspPlan:
    """The pose where the probability of a seal, over the belief, is greatest, and which the arm reaches.

    The approach is guarded: errors along it hardly matter, those sideways and of the tilt do. So what counts is that the rim's
    travels to the surface differ by less than the stroke, and that the rim bears the strain.

    Args:
        beliefs: contact points of one contour generator at one or more heights, their axes along the vase's.
        centre: (3,) camera centre from which it is seen, about: the grasp is on the side hidden from it.
        arm: that has to reach the pregrasp, the end of the guarded approach, and the lift.
        start: (6,) joint positions from which a clear way has to lead to the pregrasp [rad].
        azimuths: lowest and highest, from the contour generator to the hidden side [rad]; negative: on the visible side.
        heights: lowest and highest, along the axis from the world's origin [m].
        cup: the suction cup.
        place: standard deviation of the arm's place, each axis [m].
        obstacles: of which to keep clear, as far as they are known.

    Raises:
        InvalidInput: an empty or impossible range, or beliefs of no lathe.
        NoGrasp: no pose has a chance to seal within reach.
    """
    if not 0 <= place < 1:
        raise InvalidInput(f"place is {place!r}; accepted: a standard deviation from 0 to below 1 m")
    q = np.asarray(start, float)
    if q.shape != (6,) or not np.all(np.isfinite(q)):
        raise InvalidInput(
            f"joint positions to start from are {q.tolist()}; accepted: six finite numbers [rad]"
        )
    lathe = BelievedLathe.of(beliefs, centre)
    believed = lathe.surface(float(lathe.radius_error(FARTHEST)), "believed vase")
    ways = _Ways(ClearPaths(arm, believed, obstacles), q, lathe.T_world_lathe.translation)
    out_of_reach: set[tuple[float, float]] = set()
    best = 0.0
    for candidate in _best_first(lathe, azimuths, heights, cup or SuctionCup(), place):
        best = max(best, candidate.probability)
        spot = (candidate.azimuth, candidate.height)
        if spot not in out_of_reach:
            plan = ways.to(candidate)
            if plan is not None:
                return plan
            out_of_reach.add(spot)
    raise NoGrasp(
        f"no pose at azimuths of {np.round(np.degrees(azimuths), 1).tolist()} degrees and heights of {list(heights)} m has both a "
        f"chance to seal (the best: {best:.2f}) and a clear way for the arm; accepted: a wider range, a better belief, or an arm "
        "that stands elsewhere"
    )


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A pose that has a chance: as in `GraspPlan`, and how far before it the pregrasp is [m]."""

    T_world_cup: RigidTransform
    back: float
    guard: float
    probability: float
    azimuth: float
    height: float


def _best_first(
    lathe: BelievedLathe,
    azimuths: tuple[float, float],
    heights: tuple[float, float],
    cup: SuctionCup,
    place: float,
) -> Iterator[_Candidate]:
    """Poses that have a chance, in falling order of it; between equals the rim that lies flatter is first."""
    azimuth, height, dR = _candidates(lathe, azimuths, heights)
    poses = lathe.contacts(azimuth, height, dR, cup.lip_radius)
    rims = lathe.rims(cup, poses, lathe.draw(ERRORS, place))
    last = rims.gap
    first = np.where(
        np.isfinite(last), np.min(rims.travel, axis=-1), 0.0
    )  # nothing is met too early by a miss
    spread = last - first
    # Between two looks at the gauge the cup advances.
    sealed = (spread <= cup.stroke - GUARD) & (rims.strain <= cup.strain)
    probability = sealed.mean(axis=1)
    room = np.mean(np.minimum(spread, 2 * cup.stroke), axis=1)
    for i in np.lexsort([room, -probability]):
        if not probability[i] > 0:
            return
        back = CLEAR - min(float(np.quantile(first[i], 1 - FARTHEST)), 0.0)
        guard = max(float(np.max(last[i, sealed[i]])), 0.0) + GUARD
        yield _Candidate(poses[i], back, guard, float(probability[i]), float(azimuth[i]), float(height[i]))


def _candidates(
    lathe: BelievedLathe, azimuths: tuple[float, float], heights: tuple[float, float]
) -> tuple[Array, Array, Array]:
    """Azimuths, heights and dR (N) of the poses that are tried."""
    if not -np.pi / 2 <= azimuths[0] <= azimuths[1] <= np.pi:
        raise InvalidInput(f"azimuths are {azimuths}; accepted: increasing, -pi/2 to pi rad")
    low, high = (float(np.clip(h, *lathe.span)) for h in heights)
    if not heights[0] <= heights[1] or not heights[0] <= high or not low <= heights[1]:
        raise InvalidInput(
            f"heights are {heights} m; accepted: increasing, and some within those of the contact points, "
            f"{np.round(lathe.span, 3).tolist()} m"
        )
    a, z = _steps(*azimuths, AZIMUTH_STEP), _steps(low, high, HEIGHT_STEP)
    grids = np.meshgrid(a, z, lathe.radius_error(AIMS), indexing="ij")
    return grids[0].ravel(), grids[1].ravel(), grids[2].ravel()


def _steps(low: float, high: float, step: float) -> Array:
    return np.linspace(low, high, int(np.ceil((high - low) / step - 1e-9)) + 1)


@dataclass(frozen=True, eq=False)
class _Ways:
    """How the arm gets to a grasp, clear of the table and all that is believed."""

    paths: ClearPaths
    start: Array
    axis_point: Array

    def to(self, c: _Candidate) -> GraspPlan | None:
        """The plan for a candidate; None where the arm can't carry out the approach or the lift, or no clear way is found."""
        arm, pose = self.paths.arm, c.T_world_cup
        before, end = (pose * RigidTransform.from_translation([0, 0, d]) for d in (-c.back, c.guard))
        try:
            # Quick to tell, before a way is searched for.
            if not self.paths.clear(arm.joint_positions(RigidTransform.concatenate([before]))):
                return None
            way = self.paths.path_to(self.start, before, self.axis_point)
            if way is None:
                return None
            approach = arm.straight(way[-1], end)
            lift = arm.straight(approach[-1], _raised(end))
        except UnreachablePose:
            return None
        if not self.paths.clear(np.concatenate([approach, lift]), ignore_target=True):
            return None
        return GraspPlan(pose, before, c.guard, c.probability, c.azimuth, c.height, way, approach)


def _raised(pose: RigidTransform) -> RigidTransform:
    return RigidTransform.from_translation([0.0, 0.0, LIFT + LIFT_MARGIN]) * pose


def carry_out(world: GraspWorld, plan: GraspPlan) -> GraspOutcome:
    """Go to the pregrasp, approach until the gauge tells a seal, lift, and hold.

    Where nothing seals the arm stays where the approach ends.

    Args:
        world: at rest where the plan starts.
        plan: of `plan_grasp` for the world's arm.

    Raises:
        InvalidInput: the arm is not where the plan starts.
    """
    away = float(np.max(np.abs(world.joint_positions - plan.way[0])))
    if not away < AT_START:
        raise InvalidInput(
            f"the arm is {away:.3g} rad from where the plan starts; accepted: below {AT_START:g}"
        )
    world.follow(timed(plan.way))
    if world.approach(plan.approach).sealed:
        world.lift()
        world.hold(HOLD + SETTLING)
    return world.outcome
