"""Tiers: named, versioned combinations of what makes an episode hard, and the seeds to train and to test on.

Each tier differs from `standard-v0` in one thing, and shapes, places, looks and clutter are drawn from streams of their own:
with the same seed the rest stays the same, so that tiers are compared pair by pair (`held-out-v0` and `decoy-v0`, whose
families are others, excepted). What a name stands for never changes; a change gets a new version.

Train on `TRAIN_SEEDS` = 0 to 99,999; report on `TEST_SEEDS` = 1,000,000 to 1,000,999, the first n of them for n episodes.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, replace
from types import MappingProxyType
from typing import Any, Literal, get_args

import numpy as np

from extremal.estimator.errors import InvalidInput, is_whole
from extremal.sim import get_arm
from extremal.sim.arm_errors import ArmName
from extremal.tasks.objects import FAMILIES, HELD_OUT, LATHES, TRAINING, Family, checked_family

TRAIN_SEEDS = range(100_000)
TEST_SEEDS = range(1_000_000, 1_001_000)

Crease = Literal["present", "absent", "decoy"]
Looks = Literal["textureless", "textured", "glossy", "low_contrast"]
MOST_CLUTTER = 6


@dataclass(frozen=True)
class Tier:
    """What episodes are drawn from.

    Attributes:
        name: with its version; made by `with_options` it ends in "+" and the options.
        families: of the obstacle or vase, equally likely.
        arm_bias: preset of `extremal.sim.ARMS` for what is wrong with the individual arm in all views alike.
        arm_noise: preset for what is drawn anew in each look (`carried` tells how much of it).
        edge_noise: factor, 0 to 20, on the noise of edges in the geometric sensor and of grey levels in the rendered one.
        crease: the fixed feature. "present": a box beside the object. "absent": none. "decoy": no box, but a stripe painted
            on the object itself near its contour generator and nearly parallel to it; it does not slip over the surface,
            so it serves as a reference, and whoever takes it for the apparent contour finds no radius. Lathes only.
        appearance: "textureless": one matte colour. "textured": patches of other colours on lathes and box. "glossy":
            highlights that move with the camera. "low_contrast": nearly the colour of table and sky.
        clutter: number of extra objects, 0 to 6, away from the shortest ways.
    """

    name: str
    families: tuple[Family, ...] = TRAINING
    arm_bias: ArmName = "typical"
    arm_noise: ArmName = "typical"
    edge_noise: float = 1.0
    crease: Crease = "present"
    appearance: Looks = "textureless"
    clutter: int = 0

    def __post_init__(self) -> None:
        given = (self.families,) if isinstance(self.families, str) else self.families
        families = tuple(given) if isinstance(given, Iterable) else (given,)
        for family in families:
            checked_family(family)
        if not families:
            raise InvalidInput(f"families is (); accepted: one or more of {', '.join(FAMILIES)}")
        object.__setattr__(self, "families", families)
        for preset in (self.arm_bias, self.arm_noise):
            get_arm(preset)
        for name, names in (("crease", get_args(Crease)), ("appearance", get_args(Looks))):
            if not isinstance(getattr(self, name), str) or getattr(self, name) not in names:
                raise InvalidInput(f"{name} is {getattr(self, name)!r}; accepted: {', '.join(names)}")
        if not (isinstance(self.edge_noise, int | float | np.number) and 0 <= self.edge_noise <= 20):
            raise InvalidInput(f"edge_noise is {self.edge_noise!r}; accepted: a factor from 0 to 20")
        if not (is_whole(self.clutter) and 0 <= self.clutter <= MOST_CLUTTER):
            raise InvalidInput(
                f"clutter is {self.clutter!r}; accepted: a whole number from 0 to {MOST_CLUTTER}"
            )
        if self.crease == "decoy" and not self.lathes:
            raise InvalidInput(
                f"families is {families!r} with a decoy; accepted: one or more of {', '.join(LATHES)}"
            )

    @property
    def lathes(self) -> tuple[Family, ...]:
        """Those of the families that are lathes."""
        return tuple(family for family in self.families if family in LATHES)

    @property
    def obstacles(self) -> tuple[Family, ...]:
        """The families that fit the tier: lathes alone if a decoy is painted on them."""
        return self.lathes if self.crease == "decoy" else self.families

    def with_options(self, options: Mapping[str, Any] | None) -> "Tier":
        """The tier with some fields replaced.

        Args:
            options: field names and values, as `reset(options=...)` of an environment takes them.

        Raises:
            InvalidInput: no mapping, an unknown name or a value that is not accepted.
        """
        if options is None:
            return self
        if not isinstance(options, Mapping):
            raise InvalidInput(f"options are {options!r:.200}; accepted: a mapping of field names")
        known = [field.name for field in fields(self) if field.name != "name"]
        unknown = [key for key in options if key not in known]
        if unknown:
            raise InvalidInput(f"option is {unknown[0]!r}; accepted: {', '.join(known)}")
        if not options:
            return self
        suffix = ",".join(f"{key}={options[key]}" for key in known if key in options)
        return replace(self, name=f"{self.name}+{suffix}", **options)


def get_tier(name: str) -> Tier:
    """A tier by its name; InvalidInput lists the names."""
    if not isinstance(name, str) or name not in TIERS:
        raise InvalidInput(f"tier is {name!r}; accepted: {', '.join(TIERS)}")
    return TIERS[name]


TIERS: Mapping[str, Tier] = MappingProxyType(
    {
        tier.name: tier
        for tier in (
            Tier("standard-v0"),
            Tier("held-out-v0", families=HELD_OUT),
            Tier("ideal-calibration-v0", arm_bias="ideal", arm_noise="ideal"),
            Tier("calibrated-v0", arm_bias="calibrated", arm_noise="calibrated"),
            Tier("poor-calibration-v0", arm_bias="poor", arm_noise="poor"),
            Tier("bias-only-v0", arm_bias="poor", arm_noise="ideal"),
            Tier("noise-only-v0", arm_bias="ideal", arm_noise="poor"),
            Tier("noisy-v0", edge_noise=3.0),
            Tier("no-crease-v0", crease="absent"),
            Tier("decoy-v0", crease="decoy"),
            Tier("textured-v0", appearance="textured"),
            Tier("glossy-v0", appearance="glossy"),
            Tier("low-contrast-v0", appearance="low_contrast"),
            Tier("cluttered-v0", clutter=4),
        )
    }
)
