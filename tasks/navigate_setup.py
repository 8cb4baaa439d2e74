"""An episode of navigation: from beside a curved obstacle to a goal that it hides.

Seen from above, the obstacle's axis being the origin:

    the sphere's surface is `GAP` = 30 to 50 mm from the obstacle at the start and at the goal, more than the wanted clearance;
    the goal is 100 to 180 degrees around the obstacle from the start, and hidden by it;
    the shortest way at the clearance turns by `WRAP` = 60 to 120 degrees, and the other way is at least 5 % longer.

So near, the obstacle subtends 60 to 95 degrees, more than a camera's 44: the camera does not look at the obstacle's middle
but along the tangent, at the point of the contour generator in the start's own level, on the side of the shortest way. In
the image the obstacle is on one side of the middle; on the other there is the free space past it and, 1 to 18 degrees from
the contour and at about twice its distance, the box. The box keeps `ROOM` from both ways around the obstacle.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from extremal.estimator.errors import NotConverged
from extremal.scenes import Box, Lathe, Scene, Surface
from extremal.scenes.curves import Array
from extremal.sim import fixating
from extremal.tasks.level_string import Section, Side, polyline_length, ways_around
from extremal.tasks.objects import random_object
from extremal.tasks.shortest_path import Path, shortest_path, winding
from extremal.tasks.surroundings import TRIES, Streams, clutter, dressed, furnished, standing_box, with_decoy
from extremal.tasks.tiers import Tier

SPHERE, CLEARANCE = 0.02, 0.02  # radius of the camera's sphere, wanted distance from its surface [m]
GAP = (0.03, 0.05)  # [m] from the sphere's surface to the obstacle at both ends
WRAP = (np.radians(60), np.radians(120))
APART = (np.radians(100), np.radians(180))  # of azimuth between start and goal
LONGER = 1.05  # the other way, in lengths of the shortest
RADIUS, LEVEL, RISE = (0.06, 0.15), 0.25, 0.02  # of the obstacle and the ends [m]
ROOM = 0.06  # from the sphere's centre on either way to the box [m]
FIELD = np.radians(18)  # from the optical axis, within which the box's upright creases are
CLUTTER_GAP, CLUTTER_RING = 0.1, (0.3, 0.6)  # [m]


@dataclass(frozen=True, eq=False)
class NavigateSetup:
    """What an episode of navigation starts from. The same seed and tier give the same set-up.

    Attributes:
        tier, seed: what it was drawn from.
        scene: objects "table", "obstacle", "box" (where the tier has a crease) and "clutter0", ...
        start, goal: (3,) positions [m] of the sphere's centre, world.
        radius: of the camera's sphere [m].
        clearance: wanted distance from the sphere's surface to any object [m].
        T_world_camera: pose at the start, fixating a point of the contour generator.
        side: of the obstacle on which the shortest way passes, seen from the start.
        contact: (3,) the point fixated.
        optimum: the true shortest path of the sphere's centre that keeps the wanted clearance.
    """

    tier: Tier
    seed: int
    scene: Scene
    start: Array
    goal: Array
    T_world_camera: RigidTransform
    side: Side
    contact: Array
    optimum: Path
    radius: float = SPHERE
    clearance: float = CLEARANCE

    @property
    def obstacle(self) -> Surface:
        return self.scene["obstacle"]

    @property
    def winding(self) -> float:
        """Angle [rad] by which the shortest path turns."""
        return winding(self.optimum)

    @staticmethod
    def draw(seed: int, tier: Tier) -> "NavigateSetup":
        """The set-up of a seed.

        Raises:
            NotConverged: nothing acceptable was found (not met in thousands of seeds).
        """
        streams = Streams.of(0, seed)
        family = str(streams.shape.choice(tier.obstacles))
        for _ in range(TRIES):
            obstacle = random_object(family, streams.shape, radius=RADIUS, level=LEVEL, name="obstacle")
            course = _course(obstacle, streams.shape)
            box = None if course is None else _box(obstacle, course, streams.place)
            if course is None or box is None:
                continue
            optimum = _optimum(obstacle, course)
            if WRAP[0] <= winding(optimum) <= WRAP[1]:
                return _furnished(seed, tier, obstacle, box, course, optimum, streams)
        raise NotConverged(f"no course around an obstacle of the family {family!r} for seed {seed}")


@dataclass(frozen=True, eq=False)
class _Course:
    """Ends (3,), the contact (3,) looked at, its side (1: left) and both ways around (n, 3), the shortest first."""

    start: Array
    goal: Array
    contact: Array
    side: int
    ways: tuple[Array, Array]


def _course(obstacle: Surface, rng: np.random.Generator) -> _Course | None:
    """Ends beside the obstacle, or None where the string between them is not as wanted."""
    rise = rng.uniform(-RISE, RISE, 2) if isinstance(obstacle, Lathe) else np.zeros(2)
    gaps, apart, which = rng.uniform(*GAP, 2), rng.uniform(*APART), rng.choice([-1, 1])
    azimuth = np.pi + rng.uniform(-np.pi / 6, np.pi / 6)
    ends = []
    for height, gap, at in zip(LEVEL + rise, gaps + SPHERE, (azimuth, azimuth + which * apart), strict=True):
        section = Section.of(obstacle, float(height))
        i = int(np.round(np.mod(at, 2 * np.pi) / (2 * np.pi) * len(section.points))) % len(section.points)
        ends.append(section.points[i] + gap * section.normals[i])
    start, goal = ends
    # Beside a waist another point may be nearer.
    if isinstance(obstacle, Lathe) and np.max(np.abs(obstacle.signed_distance(ends) - gaps - SPHERE)) > 1e-6:
        return None
    ways = ways_around(Section.of(obstacle, LEVEL), start, goal, SPHERE + CLEARANCE)
    if ways is None:
        return None
    right, left = (polyline_length(way) for way in ways)
    side = 1 if left < right else -1
    slack = np.radians(3) if isinstance(obstacle, Lathe) else 0.0
    turn = winding(ways[0] if side < 0 else ways[1])
    if max(left, right) < LONGER * min(left, right) or not WRAP[0] - slack <= turn <= WRAP[1] + slack:
        return None
    if not obstacle.intersect(start, [goal - start])[0] < 1:
        return None  # the goal is in sight
    contact = Section.of(obstacle, float(start[2])).tangent_point(start, side)
    return _Course(start, goal, contact, side, ways if side < 0 else (ways[1], ways[0]))


def _optimum(obstacle: Surface, course: _Course) -> Path:
    if isinstance(obstacle, Lathe):
        return shortest_path(obstacle, course.start, course.goal, SPHERE + CLEARANCE)
    # Both ends lie in the obstacle's plane of symmetry, and so does the shortest path.
    return Path(course.ways[0], polyline_length(course.ways[0]))


def _box(obstacle: Surface, course: _Course, rng: np.random.Generator) -> Box | None:
    """A box past the contour on its free side, clear of both ways and in sight; None if none is found."""
    eye, along = course.start[:2], course.contact[:2] - course.start[:2]
    bearing, distance = np.arctan2(along[1], along[0]), float(np.linalg.norm(along))
    level = course.start[2]
    on_ways = np.concatenate(course.ways)
    for _ in range(20):
        size = np.append(rng.uniform(0.04, 0.07, 2), level + rng.uniform(-0.03, 0.03))
        aside = bearing + course.side * np.radians(rng.uniform(6, 14))
        place = eye + distance * rng.uniform(1.7, 3.0) * np.array([np.cos(aside), np.sin(aside)])
        box = standing_box(size, place, rng.uniform(-np.pi, np.pi))
        if np.min(box.signed_distance(on_ways)) >= ROOM and _in_sight(box, obstacle, course, bearing):
            return box
    return None


def _in_sight(box: Box, obstacle: Surface, course: _Course, bearing: float) -> bool:
    """Whether all upright creases are in the field of view, on the free side of the contour."""
    x, y, _ = np.array(box.size) / 2
    corners = box.T_world_object.apply([[x, y, 0], [-x, y, 0], [-x, -y, 0], [x, -y, 0]])
    corners[:, 2] = course.start[2]
    rays = corners - course.start
    angle = np.mod(np.arctan2(rays[:, 1], rays[:, 0]) - bearing + np.pi, 2 * np.pi) - np.pi
    outward = course.side * angle
    return bool(
        np.all((outward > np.radians(1)) & (outward < FIELD))
        and np.all(obstacle.intersect(course.start, rays) > 1)
    )


def _furnished(
    seed: int,
    tier: Tier,
    obstacle: Surface,
    box: Box,
    course: _Course,
    optimum: Path,
    streams: Streams,
) -> NavigateSetup:
    """The set-up of a course, dressed as the tier says."""
    facing = float(np.arctan2(course.start[1], course.start[0]))
    looks = streams.looks
    obstacle = dressed(obstacle, tier, looks, facing)
    dressed_box = dressed(box, tier, looks, facing)
    if tier.crease == "decoy":
        obstacle = with_decoy(obstacle, course.contact, course.start, looks)
    seen = (course.contact, box.T_world_object.translation)
    keep_clear = np.concatenate([*course.ways, *(np.linspace(course.start, p, 60) for p in seen)])[:, :2]
    extra = clutter(tier, streams.clutter, keep_clear, CLUTTER_GAP, CLUTTER_RING)
    objects = (obstacle, *((dressed_box,) if tier.crease == "present" else ()), *extra)
    scene = furnished(objects, looks, facing, course.contact, "navigate")
    pose = fixating(course.start[None], np.append(course.contact[:2], course.start[2]))[0]
    side: Side = "left" if course.side > 0 else "right"
    return NavigateSetup(tier, seed, scene, course.start, course.goal, pose, side, course.contact, optimum)
