"""An episode of grasping: a vase beside a box, seen from one side and to be grasped on another, that was never seen.

Seen from above, the vase's axis being the origin and azimuths counted from x towards y; the arm stands at (-0.7, 0.1):

    the hand camera looks from azimuths `VIEWED` (112 to 136 degrees), 0.35 m away, 28 to 34 degrees above the vase's level;
    the contour generator that it sees on the right is, over all views, at most at an azimuth g of about 200 to 230 degrees;
    the cup grasps between g + 45 and g + 90 degrees, as far as the arm reaches (285 degrees);
    the box stands behind the vase on the left in the image, out of the arm's way.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from extremal.estimator.errors import InvalidInput, NotConverged
from extremal.scenes import Box, Lathe, Scene
from extremal.scenes.curves import Array
from extremal.sim import fixating
from extremal.tasks.grasp_motion import T_TABLE_BASE
from extremal.tasks.objects import LATHES, random_object
from extremal.tasks.surroundings import TRIES, Streams, clutter, dressed, furnished, standing_box, with_decoy
from extremal.tasks.tiers import Tier

RADIUS, LEVEL = (0.025, 0.08), 0.1  # at the grasp height [m]
FLARE = (
    0.015  # by which a vase is wider anywhere than at the grasp height, at most: the hand comes in level [m]
)
SLOPE = 0.2  # |dr/dz| there, at most
VIEWS, DISTANCE, ELEVATION = 15, 0.35, (np.radians(28), np.radians(34))
VIEWED = (np.radians(112), np.radians(136))
IRREGULAR = 0.35  # interior views are moved by up to this fraction of a step
BEYOND = (np.radians(45), np.radians(90))
REACHED = (np.radians(135), np.radians(285))  # azimuths at which the arm grasps and lifts
FIELD = np.tan(np.radians(20))  # x/z and y/z of image points that are well within the frame, x
CLUTTER_GAP, CLUTTER_RING = 0.05, (0.2, 0.45)  # [m]


@dataclass(frozen=True, eq=False)
class GraspSetup:
    """What an episode of grasping starts from. The same seed and tier give the same set-up.

    Attributes:
        tier, seed: what it was drawn from.
        scene: objects "table", "vase", "box" (where the tier has a crease) and "clutter0", ...
        level: height of the grasp [m].
        views: T_world_camera (V) from which the hand camera looks, in order.
        view_direction: (3,) unit vector in which the middle view looks.
        generator: azimuth [rad] of the contour generator at the grasp's level, the furthest seen in any of the views.
        azimuth_range: least and largest azimuth [rad] of the outward normal of an accepted grasp; world, from x towards y.
        T_world_base: pose of the arm's base.
    """

    tier: Tier
    seed: int
    scene: Scene
    level: float
    views: RigidTransform
    view_direction: Array
    generator: float
    azimuth_range: tuple[float, float]
    T_world_base: RigidTransform = T_TABLE_BASE

    @property
    def vase(self) -> Lathe:
        vase = self.scene["vase"]
        assert isinstance(vase, Lathe)
        return vase

    @staticmethod
    def draw(seed: int, tier: Tier) -> "GraspSetup":
        """The set-up of a seed.

        Raises:
            InvalidInput: none of the tier's families is a lathe.
            NotConverged: nothing acceptable was found (not met in thousands of seeds).
        """
        if not tier.lathes:
            raise InvalidInput(
                f"families is {tier.families!r}; accepted in grasps: one or more of {', '.join(LATHES)}"
            )
        streams = Streams.of(1, seed)
        family = str(streams.shape.choice(tier.lathes))
        for _ in range(TRIES):
            vase = random_object(family, streams.shape, radius=RADIUS, level=LEVEL, name="vase")
            assert isinstance(vase, Lathe)
            centres = _centres(streams.shape)
            generator = _generator(vase, centres)
            box = None if generator is None else _box(vase, centres, streams.place)
            if generator is not None and box is not None:
                return _furnished(seed, tier, vase, box, centres, generator, streams)
        raise NotConverged(f"no place for a vase of the family {family!r} for seed {seed}")


def _centres(rng: np.random.Generator) -> Array:
    """Camera centres (V, 3) [m] along an arc, in irregular steps."""
    azimuth = np.linspace(*VIEWED, VIEWS)
    azimuth[1:-1] += (azimuth[1] - azimuth[0]) * IRREGULAR * rng.uniform(-1, 1, VIEWS - 2)
    elevation = rng.uniform(*ELEVATION)
    flat = np.cos(elevation)
    along = np.column_stack(
        [flat * np.cos(azimuth), flat * np.sin(azimuth), np.full(VIEWS, np.sin(elevation))]
    )
    return np.array([0.0, 0.0, LEVEL]) + DISTANCE * along


def _generator(vase: Lathe, centres: Array) -> float | None:
    """Largest azimuth [rad] of the contour generator at the level; None where vase or generator is not as wanted.

    On a lathe at the height z, seen from (rho, theta, z_c): cos(azimuth - theta) = (r - r' (z - z_c)) / rho.
    """
    r, r1, _ = (float(value) for value in vase.profile.derivatives(np.array(LEVEL)))
    if abs(r1) > SLOPE or vase.profile.largest > r + FLARE:
        return None
    rho, theta = np.hypot(centres[:, 0], centres[:, 1]), np.arctan2(centres[:, 1], centres[:, 0])
    q = (r - r1 * (LEVEL - centres[:, 2])) / rho
    return float(np.max(theta + np.arccos(q))) if np.all(np.abs(q) < 0.7) else None


def _box(vase: Lathe, centres: Array, rng: np.random.Generator) -> Box | None:
    """A box behind the vase, on the left in the image, two upright creases of it in sight of all views; else None."""
    middle = np.mean(VIEWED)
    for _ in range(20):
        size = np.append(rng.uniform(0.035, 0.055, 2), rng.uniform(0.09, 0.13))
        azimuth = middle - np.pi / 2 - np.radians(rng.uniform(5, 40))
        distance = vase.profile.largest + float(np.hypot(*size[:2])) / 2 + rng.uniform(0.01, 0.03)
        box = standing_box(
            size, distance * np.array([np.cos(azimuth), np.sin(azimuth)]), rng.uniform(-np.pi, np.pi)
        )
        if all(_creases_seen(box, vase, pose) >= 2 for pose in _poses(centres[[0, VIEWS // 2, -1]], box)):
            return box
    return None


def _poses(centres: Array, box: Box) -> RigidTransform:
    """T_world_camera (V): looking between vase and box, nearer to the vase."""
    return fixating(centres, [*(0.2 * box.T_world_object.translation[:2]), LEVEL])


def _creases_seen(box: Box, vase: Lathe, T_world_camera: RigidTransform) -> int:
    """How many upright creases of the box are in the image, over the upper half of their length."""
    half = np.array(box.size) / 2
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (0, 1)]) * half
    p = box.T_world_object.apply(corners)
    centre, seen = T_world_camera.translation, T_world_camera.inv().apply(p)
    inside = np.all(np.abs(seen[:, :2]) < np.array([1, 0.75]) * FIELD * seen[:, 2:], axis=1)
    # A corner lies on the box: from a little nearer to the camera it is free of its own faces.
    rays = (p - centre) * (1 - 1e-6)
    free = (vase.intersect(centre, rays) > 1) & (box.intersect(centre, rays) > 1)
    return int(np.sum(np.all((inside & free).reshape(4, 2), axis=1)))


def _furnished(
    seed: int, tier: Tier, vase: Lathe, box: Box, centres: Array, generator: float, streams: Streams
) -> GraspSetup:
    """The set-up, dressed as the tier says."""
    looks, facing, poses = streams.looks, float(np.mean(VIEWED)), _poses(centres, box)
    dressed_vase, dressed_box = dressed(vase, tier, looks, facing), dressed(box, tier, looks, facing)
    limb = np.array([np.cos(generator), np.sin(generator), 0.0])
    if tier.crease == "decoy":
        dressed_vase = with_decoy(dressed_vase, limb, centres[-1], looks)
    place = box.T_world_object.translation
    sights = [np.linspace(centre, end, 60) for centre in centres[::7] for end in (0 * place, place)]
    keep_clear = np.concatenate([_arms_side(), *sights])[:, :2]
    extra = clutter(tier, streams.clutter, keep_clear, CLUTTER_GAP, CLUTTER_RING)
    objects = (dressed_vase, *((dressed_box,) if tier.crease == "present" else ()), *extra)
    target = np.array([0.0, 0.0, LEVEL])
    scene = furnished(objects, looks, facing, target, "grasp")
    direction = poses[VIEWS // 2].rotation.apply([0.0, 0.0, 1.0])
    allowed = (generator + BEYOND[0], min(generator + BEYOND[1], REACHED[1]))
    return GraspSetup(tier, seed, scene, LEVEL, poses, direction, generator, allowed)


def _arms_side() -> Array:
    """Points (M, 3) of the table over which the arm moves: azimuths of 90 to 320 degrees."""
    azimuth, distance = np.meshgrid(np.radians(np.arange(90, 321, 5)), np.arange(0.1, 0.6, 0.03))
    return np.stack([distance * np.cos(azimuth), distance * np.sin(azimuth), 0 * distance], axis=-1).reshape(
        -1, 3
    )
