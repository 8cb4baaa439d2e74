"""Random objects by family: smooth lathes, ellipsoids and superquadrics, some of them held out for tests.

| family | what it is | for |
|---|---|---|
| barrel | lathe, convex: widest half-way up | training |
| waisted | lathe, a saddle: narrowest half-way up | training |
| cone | lathe with a straight meridian: a frustum on either end | training |
| wavy | lathe of up to one and a half random waves | training |
| ellipsoid | elliptic sections, axis ratio up to 2 | training |
| superquadric | sections between an ellipse and a rectangle, axis ratio up to 2 | training |
| bottle | lathe: a body and a narrower neck | held out |
| gourd | lathe: a large and a small bulb | held out |
| boxy | superquadric nearer to a box, axis ratio up to 2 | held out |

All stand on the plane z = 0 with their axis through the origin. Meridians of lathes are nowhere more curved than
`TIGHTEST` of the level looked at, nor steeper than `STEEPEST`; a shape that would be is flattened until it is not.
"""

from collections.abc import Callable
from typing import Any, Literal, get_args

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from extremal.estimator.errors import InvalidInput
from extremal.scenes import Appearance, Ellipsoid, Lathe, Superquadric, Surface
from extremal.scenes.curves import Array
from extremal.scenes.profile import Profile

Family = Literal["barrel", "waisted", "cone", "wavy", "ellipsoid", "superquadric", "bottle", "gourd", "boxy"]
FAMILIES: tuple[Family, ...] = get_args(Family)
LATHES: tuple[Family, ...] = ("barrel", "waisted", "cone", "wavy", "bottle", "gourd")
HELD_OUT: tuple[Family, ...] = ("bottle", "gourd", "boxy")
TRAINING: tuple[Family, ...] = tuple(family for family in FAMILIES if family not in HELD_OUT)

RADIUS = (0.015, 0.08)  # [m]
LEVEL = 0.1  # [m]
TIGHTEST = 0.3  # smallest radius of curvature of a meridian, in levels
STEEPEST = 0.6  # |dr/dz| of a lathe
RATIO = 2.0  # of the axes of a horizontal section, at most
KNOTS = 13  # of a profile
PLAIN = Appearance()


def random_object(
    family: str,
    rng: np.random.Generator,
    *,
    radius: tuple[float, float] = RADIUS,
    level: float = LEVEL,
    appearance: Appearance = PLAIN,
    name: str = "object",
) -> Surface:
    """An object of a family, standing on z = 0, turned at random about the vertical axis through the origin.

    Args:
        family: one of `FAMILIES`.
        rng: the only source of randomness.
        radius: range [m], at the height `level`, of a lathe's radius or of the horizontal semi-axes of the others.
        level: height [m] that cameras look at, about half the object's; a plane of symmetry where it is no lathe.
        appearance: colour and reflectance.
        name: of the surface.

    Raises:
        InvalidInput: an unknown family, or a range that is not one.
    """
    checked_family(family)
    least, most = radius
    if not 1e-3 <= least <= most <= 10 or not 1e-2 <= level <= 10:
        wanted = "0.001 <= least <= most <= 10 m, level 0.01 to 10 m"
        raise InvalidInput(f"radius is {radius!r} and level {level!r}; accepted: {wanted}")
    turn = Rotation.from_rotvec([0.0, 0.0, rng.uniform(-np.pi, np.pi)])
    look: dict[str, Any] = {"name": name, "appearance": appearance}
    if family in LATHES:
        z, r = _profile(_SHAPES[family](rng), rng.uniform(least, most), level * rng.uniform(1.8, 2.2), level)
        pose = RigidTransform.from_rotation(turn)
        return Lathe(tuple(z.tolist()), tuple(r.tolist()), T_world_object=pose, **look)
    pose = RigidTransform.from_components([0.0, 0.0, level], turn)
    long = rng.uniform(least, most)
    short = rng.uniform(max(least, long / RATIO), long)
    if family == "ellipsoid":
        return Ellipsoid(long, short, level, T_world_object=pose, **look)
    e1, e2 = rng.uniform(*_EXPONENTS[family])
    return Superquadric(long, short, level, e1, e2, T_world_object=pose, **look)


def checked_family(family: str) -> None:
    """InvalidInput, listing the families, unless it is one of them."""
    if not isinstance(family, str) or family not in FAMILIES:
        raise InvalidInput(f"family is {family!r}; accepted: {', '.join(FAMILIES)}")


def _profile(
    shape: Callable[[Array], Array], radius: float, height: float, level: float
) -> tuple[Array, Array]:
    """Heights (KNOTS,) and radii (KNOTS,) [m] of the radius wanted at `level`, as bent as is accepted."""
    z = np.linspace(0, height, KNOTS)
    bend = shape(z / height) - shape(np.array(level / height))
    for _ in range(60):
        r = radius * np.exp(bend)
        if _gentle(Profile(z, r), TIGHTEST * level):
            break
        bend = 0.8 * bend
    return z, r  # pyright: ignore[reportPossiblyUnboundVariable]


def _gentle(profile: Profile, tightest: float) -> bool:
    _, r1, r2 = profile.derivatives(np.linspace(0, profile.height, 200))
    curvature = np.abs(r2) / (1 + r1 * r1) ** 1.5
    return bool(np.max(np.abs(r1)) <= STEEPEST and np.max(curvature) * tightest <= 1)


# Shapes: the logarithm of the radius, up to a constant, at the fraction u of the height.


def _bowed(low: float, high: float) -> Callable[[np.random.Generator], Callable[[Array], Array]]:
    def draw(rng: np.random.Generator) -> Callable[[Array], Array]:
        depth, middle = rng.uniform(low, high), rng.uniform(0.4, 0.6)
        return lambda u: depth * (2 * (u - middle)) ** 2

    return draw


def _cone(rng: np.random.Generator) -> Callable[[Array], Array]:
    taper = rng.uniform(0.1, 0.4) * rng.choice([-1, 1])
    return lambda u: np.log(1 + taper * (u - 0.5))


def _wavy(rng: np.random.Generator) -> Callable[[Array], Array]:
    frequencies = np.array([0.5, 1.0, 1.5])
    sizes, phases = rng.uniform(0, [0.12, 0.15, 0.08]), rng.uniform(0, 2 * np.pi, 3)
    return lambda u: np.sin(2 * np.pi * np.multiply.outer(u, frequencies) + phases) @ sizes


def _bottle(rng: np.random.Generator) -> Callable[[Array], Array]:
    depth, shoulder, width = rng.uniform(0.4, 0.8), rng.uniform(0.65, 0.75), rng.uniform(0.07, 0.1)
    return lambda u: -depth / (1 + np.exp(-(u - shoulder) / width))


def _gourd(rng: np.random.Generator) -> Callable[[Array], Array]:
    depth, phase, taper = rng.uniform(0.1, 0.2), rng.uniform(0.15, 0.3), rng.uniform(0.2, 0.4)
    return lambda u: depth * np.cos(2 * np.pi * 1.5 * (u - phase)) - taper * u


_SHAPES: dict[str, Callable[[np.random.Generator], Callable[[Array], Array]]] = {
    "barrel": _bowed(-0.5, -0.15),
    "waisted": _bowed(0.15, 0.5),
    "cone": _cone,
    "wavy": _wavy,
    "bottle": _bottle,
    "gourd": _gourd,
}
# Least and largest exponents of the meridians and of the parallels.
_EXPONENTS = {"superquadric": ((0.4, 0.6), (0.9, 0.95)), "boxy": ((0.3, 0.4), (0.5, 0.6))}
