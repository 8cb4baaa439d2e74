"""What stands around the object of a task: table, box, clutter, lights, and how all of it looks."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from extremal.estimator.errors import InvalidInput, NotConverged, is_whole
from extremal.scenes import Appearance, Background, Box, BoxPatch, Lathe, LathePatch, Light, Scene, Surface
from extremal.scenes.curves import Array, Colour
from extremal.scenes.markings import Face
from extremal.tasks.objects import TRAINING, random_object
from extremal.tasks.tiers import Tier

SKY, TABLE_COLOUR = (0.86, 0.88, 0.9), (0.9, 0.88, 0.85, 1.0)
CLUTTER_LEVEL, CLUTTER_RADIUS = (0.04, 0.1), (0.015, 0.04)  # [m]
TRIES = 400
_STREAM = 0x7461736B  # first word of the seeds of task set-ups: nothing else draws from these streams


@dataclass(frozen=True, eq=False)
class Streams:
    """Independent generators for what is drawn, so that one does not change with another."""

    shape: np.random.Generator
    place: np.random.Generator
    looks: np.random.Generator
    clutter: np.random.Generator

    @staticmethod
    def of(task: int, seed: int) -> "Streams":
        """Those of a task, by its number, and of the seed of an episode.

        Raises:
            InvalidInput: a seed that is not a whole number from 0.
        """
        if not (is_whole(seed) and seed >= 0):
            raise InvalidInput(f"seed is {seed!r}; accepted: a whole number from 0")
        return Streams(*(np.random.default_rng([_STREAM, task, seed, i]) for i in range(4)))


def dressed(surface: Surface, tier: Tier, rng: np.random.Generator, facing: float) -> Surface:
    """The object or box with the tier's appearance.

    Args:
        surface: textured ones get patches if they are lathes or boxes.
        tier: names the appearance.
        rng: draws as many numbers whatever the appearance.
        facing: azimuth [rad], world, of the side seen first; patches are around it.
    """
    grey, tint = rng.uniform(0.25, 0.5), rng.uniform(0.88, 1.12, 3)
    shine, tone = rng.uniform(0.5, 0.9, 2), rng.uniform(0.03, 0.08)
    pattern = rng.uniform(-1, 1, (3, 2))
    colour = grey * tint
    if tier.appearance == "low_contrast":
        colour = np.array(TABLE_COLOUR[:3]) - tone * tint
    specular, shininess = shine if tier.appearance == "glossy" else (0.0, 0.0)
    rgba = _opaque(colour)
    surface = replace(surface, appearance=Appearance(rgba, float(specular), float(shininess)))
    return _textured(surface, pattern, facing) if tier.appearance == "textured" else surface


def _opaque(colour: Array) -> Colour:
    r, g, b = np.clip(colour, 0, 1).tolist()
    return (r, g, b, 1.0)


def _textured(surface: Surface, pattern: Array, facing: float) -> Surface:
    """Three patches on a lathe, one above the other; one on every side of a box."""
    light = _opaque(np.array([0.85, 0.82, 0.75]))
    if isinstance(surface, Box):
        x, y, z = surface.size
        faces: list[tuple[Face, float]] = [("-x", y), ("+x", y), ("-y", x), ("+y", x)]
        patches = tuple(BoxPatch(face, face, (0.0, 0.1 * z), (0.5 * w, 0.4 * z), light) for face, w in faces)
        return replace(surface, markings=patches)
    if isinstance(surface, Lathe):
        height, turn = surface.profile.height, _yaw(surface)
        patches = tuple(
            LathePatch(
                f"patch{i}",
                facing - turn + 0.5 * float(shift),
                0.5 + 0.15 * float(size),
                height * (0.2 + 0.22 * i),
                height * (0.3 + 0.22 * i),
                light,
            )
            for i, (shift, size) in enumerate(pattern)
        )
        return replace(surface, markings=patches)
    return surface


def with_decoy(surface: Surface, limb: Array, eye: Array, rng: np.random.Generator) -> Surface:
    """A lathe with an upright stripe painted 10 to 20 degrees of azimuth on the near side of its contour generator.

    Args:
        limb: (3,) a point of the contour generator.
        eye: (3,) from where it is seen.
        rng: places the stripe.
    """
    assert isinstance(surface, Lathe)  # tiers with a decoy have no other families
    axis = surface.T_world_object.translation
    at, seen = (np.arctan2(*(p - axis)[1::-1]) for p in (limb, eye))
    towards = np.sign(np.mod(seen - at + np.pi, 2 * np.pi) - np.pi)
    near = float(at + towards * np.radians(rng.uniform(10, 20)) - _yaw(surface))
    width, height = np.radians(rng.uniform(4, 7)), surface.profile.height
    grey = 0.85 if np.mean(surface.appearance.rgba[:3]) < 0.6 else 0.35
    stripe = LathePatch(
        "decoy",
        near + towards * width / 2,
        float(width),
        0.05 * height,
        0.95 * height,
        _opaque(np.full(3, grey)),
    )
    # A patch and the stripe must not overlap.
    return replace(surface, markings=(*(m for m in surface.markings if not m.overlaps(stripe)), stripe))


def _yaw(surface: Surface) -> float:
    """Azimuth [rad] of an upright object's x axis."""
    x = surface.T_world_object.rotation.as_matrix()[:, 0]
    return float(np.arctan2(x[1], x[0]))


def standing_box(size: Array, place: Array, yaw: float, name: str = "box") -> Box:
    """A box of `size` (3,) [m] on the table, its axis at `place` (2,) [m], turned by `yaw` [rad]."""
    rotation = Rotation.from_rotvec([0.0, 0.0, yaw])
    centre = [place[0], place[1], size[2] / 2]
    pose = RigidTransform.from_components(centre, rotation)
    return Box(tuple(size.tolist()), name=name, T_world_object=pose)


def clutter(
    tier: Tier, rng: np.random.Generator, keep_clear: Array, gap: float, ring: tuple[float, float]
) -> tuple[Surface, ...]:
    """The tier's extra objects on the table: lathes, ellipsoids and superquadrics of the training families.

    Args:
        tier: says how many.
        rng: the only source of randomness.
        keep_clear: (M, 2) points [m], close together, of places that objects keep away from.
        gap: by how much [m].
        ring: range of their distance [m] from the world's z axis.

    Raises:
        NotConverged: there is no room.
    """
    objects: list[Surface] = []
    discs: list[tuple[Array, float]] = []
    for _ in range(TRIES):
        if len(objects) == tier.clutter:
            break
        azimuth, distance = rng.uniform(-np.pi, np.pi), rng.uniform(*ring)
        place = distance * np.array([np.cos(azimuth), np.sin(azimuth)])
        room = np.min(np.linalg.norm(keep_clear - place, axis=1)) - gap
        if room < CLUTTER_RADIUS[0]:
            continue
        one = random_object(
            str(rng.choice(TRAINING)),
            rng,
            radius=CLUTTER_RADIUS,
            level=rng.uniform(*CLUTTER_LEVEL),
            name=f"clutter{len(objects)}",
        )
        wide = _width(one)
        if room >= wide and all(np.linalg.norm(place - p) >= wide + w + 0.01 for p, w in discs):
            pose = RigidTransform.from_translation([*place, 0.0]) * one.T_world_object
            objects.append(dressed(replace(one, T_world_object=pose), tier, rng, np.pi))
            discs.append((place, wide))
    if len(objects) < tier.clutter:
        raise NotConverged(f"{tier.clutter} extra objects found no room between {ring[0]} and {ring[1]} m")
    return tuple(objects)


def _width(surface: Surface) -> float:
    """Radius [m] of an upright cylinder about the axis that holds the object."""
    if isinstance(surface, Lathe):
        return surface.profile.largest
    return float(np.hypot(*(getattr(surface, axis) for axis in "ab")))


def furnished(
    objects: tuple[Surface, ...], rng: np.random.Generator, facing: float, target: Array, name: str
) -> Scene:
    """The scene of these objects on a table under two lights.

    Args:
        objects: what stands on the table.
        rng: draws the lights.
        facing: azimuth [rad] of the side seen first: the first light comes from within 60 degrees of it, the second
            from anywhere; both from 25 to 60 degrees above.
        target: (3,) [m] to look at.
        name: of the scene.
    """
    table = Box(
        (1.4, 1.4, 0.03),
        name="table",
        T_world_object=RigidTransform.from_translation([0.0, 0.0, -0.015]),
        appearance=Appearance(TABLE_COLOUR),
    )
    lights = (
        _light(facing + rng.uniform(-np.pi / 3, np.pi / 3), rng, 0.5, ambient=0.3),
        _light(rng.uniform(-np.pi, np.pi), rng, 0.3),
    )
    x, y, z = target.tolist()
    return Scene((table, *objects), lights, Background(SKY), (x, y, z), name)


def _light(azimuth: float, rng: np.random.Generator, diffuse: float, ambient: float = 0.0) -> Light:
    elevation = rng.uniform(np.radians(25), np.radians(60))
    along = -np.cos(elevation) * np.array([np.cos(azimuth), np.sin(azimuth)])
    direction = (float(along[0]), float(along[1]), float(-np.sin(elevation)))
    return Light(direction, diffuse=float(diffuse * rng.uniform(0.8, 1.15)), ambient=ambient)
