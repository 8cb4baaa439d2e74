"""An episode of inspection: an object beside a box on a table; what is one contour, where, and how curved?

The camera starts 0.5 to 0.6 m from the object, at an azimuth of 180 +- 20 degrees, and fixates its axis at the `level`. The
question is about one outline of the object (or, sometimes, of the box): the edge furthest to its left or right in the plane
through the camera's centre that holds the fixation point and the horizontal across the line of sight. That is the epipolar
plane of a camera that moves sideways and keeps fixating. An edge of the box that is asked about stays the one asked about; at the
start no other edge is seen in line with it, and it is high enough to cross the plane from wherever one looks.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from extremal.estimator.errors import DegenerateGeometry, InvalidInput, NotConverged
from extremal.scenes import Box, Lathe, Scene, Surface, SurfaceCurve
from extremal.scenes.curves import Array, Kind
from extremal.scenes.matching import match
from extremal.scenes.visibility import visible_edges
from extremal.sim import fixating
from extremal.tasks.level_string import Section, Side
from extremal.tasks.objects import LEVEL, RADIUS, random_object
from extremal.tasks.surroundings import TRIES, Streams, clutter, dressed, furnished, standing_box, with_decoy
from extremal.tasks.tiers import Tier

DISTANCE, ELEVATION = (0.5, 0.6), (np.radians(5), np.radians(20))
AZIMUTH = np.radians(20)  # of the camera from the negative x axis, at most
FIXED = 0.25  # how often the question is about the box
SLANT = 0.6  # cosine of the angle between ray and meridian on a lathe, at most: the outline is not end-on
BOX_HEIGHT = (0.14, 0.17)  # [m]: the plane of the question rises towards the camera
APART = 0.025  # [rad] between the edge that may be asked about and others
HIDES = 1e-3  # share of the way, by which what hides a point is nearer
CLUTTER_GAP, CLUTTER_RING = 0.04, (0.15, 0.4)  # [m]


@dataclass(frozen=True, eq=False)
class InspectTruth:
    """The right answer, for the view in which it is asked.

    Attributes:
        kind: "extremal", "crease" or "marking".
        point: (3,) contact point [m], world.
        normal: (3,) outward unit normal there.
        radius: of curvature of the section in the plane of the question [m]; 0 for fixed features.
        visible: false where an object hides the point.
    """

    kind: Kind
    point: Array
    normal: Array
    radius: float
    visible: bool

    @property
    def is_fixed(self) -> bool:
        return self.kind != "extremal"


@dataclass(frozen=True, eq=False)
class InspectSetup:
    """What an episode of inspection starts from. The same seed and tier give the same set-up.

    Attributes:
        tier, seed: what it was drawn from.
        scene: objects "table", "object", "box" (where the tier has a crease) and "clutter0", ...
        target: name of the object that is asked about.
        side: which of its outlines, as the camera sees it.
        fixation: (3,) point [m] at the object's level that the question's plane passes through, world.
        T_world_camera: pose at the start.
    """

    tier: Tier
    seed: int
    scene: Scene
    target: str
    side: Side
    fixation: Array
    T_world_camera: RigidTransform

    @staticmethod
    def draw(seed: int, tier: Tier) -> "InspectSetup":
        """The set-up of a seed.

        Raises:
            NotConverged: nothing acceptable was found (not met in thousands of seeds).
        """
        streams = Streams.of(2, seed)
        family = str(streams.shape.choice(tier.obstacles))
        side = 1 if streams.place.random() < 0.5 else -1
        about_box = bool(streams.place.random() < FIXED)
        for _ in range(TRIES):
            surface = random_object(family, streams.shape, radius=RADIUS, level=LEVEL, name="object")
            centre = _centre(streams.shape)
            if _outlined(surface, centre):
                box = _box(surface, centre, side if about_box else -side, streams.place)
                return _furnished(seed, tier, surface, box, centre, side, about_box, streams)
        raise NotConverged(f"no view of an object of the family {family!r} for seed {seed}")


def inspect_truth(setup: InspectSetup, T_world_camera: RigidTransform) -> InspectTruth:
    """The answer from exact geometry (`extremal.scenes.Truth`) for one camera pose.

    A contour generator slides over the object as the camera moves and stays its outline. An edge of the box doesn't: the question
    stays about the edge that is the outline at the start, though from elsewhere another may be.

    Raises:
        InvalidInput: not one finite pose.
        DegenerateGeometry: the camera is above or below the fixation point, or the target has no outline in the plane.
    """
    if not T_world_camera.single or not np.all(np.isfinite(T_world_camera.as_matrix())):
        raise InvalidInput("T_world_camera is not one finite pose; accepted: a single transform")
    centre = T_world_camera.translation
    target = setup.scene[setup.target]
    curves = visible_edges([target], centre)
    if isinstance(target, Box):
        start = setup.T_world_camera.translation
        asked = _outline(setup, visible_edges([target], start), start)[0].name
        curves = [
            replace(c, visible=np.ones_like(c.visible)) for c in target.fixed_curves() if c.name == asked
        ]
    _, ray, tangent, plane = _outline(setup, curves, centre)
    truth = match([target], curves, centre, ray[None], tangent[None], plane[None], tolerance=0.002)
    if not truth.matched[0]:
        raise DegenerateGeometry(
            f"the outline of {setup.target!r} is not definite seen from {centre.tolist()}"
        )
    ray = truth.point[0] - centre
    hidden = any(surface.intersect(centre, ray[None])[0] < 1 - HIDES for surface in setup.scene.objects)
    kind: Kind = str(truth.kind[0])  # pyright: ignore[reportAssignmentType]
    return InspectTruth(kind, truth.point[0], truth.normal[0], float(truth.radius[0]), not hidden)


def _outline(
    setup: InspectSetup, curves: Sequence[SurfaceCurve], centre: Array
) -> tuple[SurfaceCurve, Array, Array, Array]:
    """Where the plane of the question seen from `centre` crosses the outermost of curves: the curve, the unit ray (3,), the
    tangent plane's normal (3,), and the plane's (3,)."""
    ahead = setup.fixation - centre
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    if not np.linalg.norm(right) > 1e-3:
        raise DegenerateGeometry(
            f"camera at {centre.tolist()} is above or below the object; accepted: beside it"
        )
    right /= np.linalg.norm(right)
    plane = np.cross(right, ahead) / np.linalg.norm(ahead)
    sign = -1.0 if setup.side == "left" else 1.0
    outer = max(
        ((curve, *found) for curve in curves for found in _crossings(curve, centre, plane)),
        key=lambda found: sign * np.arctan2(found[1] @ right, found[1] @ ahead),
        default=None,
    )
    if outer is None:
        raise DegenerateGeometry(f"{setup.target!r} has no outline in the plane seen from {centre.tolist()}")
    return *outer, plane


def _crossings(curve: SurfaceCurve, centre: Array, plane: Array) -> list[tuple[Array, Array]]:
    """Unit rays (3,) to the visible points at which a curve crosses a plane through the centre, and its tangent planes."""
    ray = curve.points - centre
    height = ray @ plane
    at = np.nonzero((height[:-1] * height[1:] <= 0) & (height[:-1] != height[1:]) & curve.visible[:-1])[0]
    found = []
    for i in at:
        w = height[i] / (height[i] - height[i + 1])
        met, tangent = (1 - w) * ray[i] + w * ray[i + 1], np.cross(ray[i], ray[i + 1])
        normal = curve.normals[i] if curve.kind == "extremal" else tangent / np.linalg.norm(tangent)
        found.append((met / np.linalg.norm(met), normal))
    return found


def _centre(rng: np.random.Generator) -> Array:
    """Centre (3,) [m] of the camera at the start."""
    azimuth, elevation, distance = (
        np.pi + rng.uniform(-AZIMUTH, AZIMUTH),
        rng.uniform(*ELEVATION),
        rng.uniform(*DISTANCE),
    )
    flat = distance * np.cos(elevation)
    return np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), LEVEL + distance * np.sin(elevation)])


def _outlined(surface: Surface, centre: Array) -> bool:
    """Whether both outlines of a lathe are seen from the side in the plane of the question."""
    if not isinstance(surface, Lathe):
        return True
    z = LEVEL + np.linspace(-0.2, 0.2, 9) * LEVEL  # the plane rises from the axis to the outline
    r, r1, _ = surface.profile.derivatives(z)
    return bool(np.max(np.abs(r - r1 * (z - centre[2]))) < SLANT * np.hypot(*centre[:2]))


def _box(surface: Surface, centre: Array, side: int, rng: np.random.Generator) -> Box:
    """A box on one side (1: left) of the object as seen from the start, level with it or behind; of its upright edges, none is
    seen in line with the outer one."""
    size = np.append(rng.uniform(0.04, 0.07, 2), rng.uniform(*BOX_HEIGHT))
    aside = np.radians(90 + rng.uniform(0, 30))
    azimuth = np.arctan2(centre[1], centre[0]) - side * aside
    reach = float(np.max(np.linalg.norm(Section.of(surface, LEVEL).points[:, :2], axis=1)))
    distance = reach + 0.03 + float(np.hypot(*size[:2])) / 2 + rng.uniform(0, 0.02)
    place = distance * np.array([np.cos(azimuth), np.sin(azimuth)])
    for _ in range(TRIES):
        turn = rng.uniform(-np.pi, np.pi)
        if _outer_edge_apart(size, place - centre[:2], turn, side):
            break
    return standing_box(size, place, turn)  # pyright: ignore[reportPossiblyUnboundVariable]


def _outer_edge_apart(size: Array, ahead: Array, turn: float, side: int) -> bool:
    """Whether the outermost upright edge of a box is seen APART from the others; `ahead` (2,) [m] leads from the camera to it."""
    corners = np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]]) * size[:2] / 2
    cos, sin = np.cos(turn), np.sin(turn)
    ray = ahead + corners @ np.array([[cos, sin], [-sin, cos]])
    left = np.array([-ahead[1], ahead[0]])
    bearing = np.sort(side * np.arctan2(ray @ left, ray @ ahead))
    return bool(bearing[-1] - bearing[-2] > APART)


def _furnished(
    seed: int,
    tier: Tier,
    surface: Surface,
    box: Box,
    centre: Array,
    side: int,
    about_box: bool,
    streams: Streams,
) -> InspectSetup:
    """The set-up, dressed as the tier says."""
    looks, facing = streams.looks, float(np.arctan2(centre[1], centre[0]))
    fixation = np.array([0.0, 0.0, LEVEL])
    dressed_surface, dressed_box = dressed(surface, tier, looks, facing), dressed(box, tier, looks, facing)
    limb = Section.of(surface, LEVEL).tangent_point(centre, side)
    if tier.crease == "decoy":
        dressed_surface = with_decoy(dressed_surface, limb, centre, looks)
    place = box.T_world_object.translation
    around = 0.08 * np.array([[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]])
    sights = [np.linspace(centre, end, 60) for end in (*(fixation + around), place)]
    extra = clutter(
        tier, streams.clutter, np.concatenate([*sights, place + around])[:, :2], CLUTTER_GAP, CLUTTER_RING
    )
    present = tier.crease == "present"
    scene = furnished(
        (dressed_surface, *((dressed_box,) if present else ()), *extra), looks, facing, fixation, "inspect"
    )
    pose = fixating(centre[None], fixation)[0]
    target = "box" if about_box and present else "object"
    return InspectSetup(tier, seed, scene, target, "left" if side > 0 else "right", fixation, pose)
