"""Patches of another colour whose outlines are known curves: geometry, not textures."""

from dataclasses import dataclass
from itertools import combinations
from typing import Literal

import numpy as np

from extremal.estimator.errors import SceneError
from extremal.scenes.curves import Colour, check_colour

Face = Literal["+x", "-x", "+y", "-y", "+z", "-z"]
FACES: tuple[Face, ...] = ("+x", "-x", "+y", "-y", "+z", "-z")
MOST_MARKINGS = 500


@dataclass(frozen=True)
class LathePatch:
    """Part of a lathe's side: an interval of azimuth and one of height.

    Attributes:
        name: unique on its object.
        azimuth: centre [rad], from the object's x axis towards y.
        width: extent in azimuth [rad], up to 2 pi (a band).
        bottom, top: heights [m] in the object frame.
        rgba: colour.
    """

    name: str
    azimuth: float
    width: float
    bottom: float
    top: float
    rgba: Colour

    def __post_init__(self) -> None:
        check_colour(f"marking {self.name!r}", self.rgba)
        if not (abs(self.azimuth) <= 100 and 1e-3 <= self.width <= 2 * np.pi + 1e-9):
            raise SceneError(
                f"marking {self.name!r}: azimuth {self.azimuth!r} or width {self.width!r} is not an angle [rad]; "
                "accepted: a width from 0.001 to 2 pi"
            )
        if not 0 <= self.bottom < self.bottom + 1e-4 <= self.top <= 100:
            raise SceneError(
                f"marking {self.name!r}: bottom {self.bottom!r} and top {self.top!r} must satisfy 0 <= bottom < top"
            )

    @property
    def is_band(self) -> bool:
        return self.width >= 2 * np.pi - 1e-6

    @property
    def start(self) -> float:
        """First azimuth in [0, 2 pi) [rad]."""
        return float(np.mod(self.azimuth - self.width / 2, 2 * np.pi))

    def overlaps(self, other: "LathePatch") -> bool:
        """Whether the two patches share an area."""
        if min(self.top, other.top) <= max(self.bottom, other.bottom) + 1e-9:
            return False
        gap = abs(np.mod(self.azimuth - other.azimuth + np.pi, 2 * np.pi) - np.pi)
        return bool(gap < (self.width + other.width) / 2 - 1e-9 or self.is_band or other.is_band)


@dataclass(frozen=True)
class BoxPatch:
    """Rectangle on a face of a box.

    The coordinates on a face are the two other object axes in the order x, y, z, from the face's centre.

    Attributes:
        name: unique on its object.
        face: "+x", "-x", "+y", "-y", "+z" or "-z" of the object frame.
        centre, size: (2,) [m].
        rgba: colour.
    """

    name: str
    face: Face
    centre: tuple[float, float]
    size: tuple[float, float]
    rgba: Colour

    def __post_init__(self) -> None:
        check_colour(f"marking {self.name!r}", self.rgba)
        if self.face not in FACES:
            raise SceneError(f"marking {self.name!r}: face is {self.face!r}; accepted: {', '.join(FACES)}")
        if (
            len(self.centre) != 2
            or len(self.size) != 2
            or not np.all(np.isfinite([*self.centre, *self.size]))
        ):
            raise SceneError(f"marking {self.name!r}: centre and size must each be two finite numbers [m]")
        if not min(self.size) >= 1e-4:
            raise SceneError(f"marking {self.name!r}: size is {self.size!r}; accepted: at least 0.0001 m")

    def overlaps(self, other: "BoxPatch") -> bool:
        """Whether the two rectangles share an area."""
        gap = np.abs(np.subtract(self.centre, other.centre))
        room = (np.array(self.size) + other.size) / 2
        return self.face == other.face and bool(np.all(gap < room - 1e-9))


def check_markings(owner: str, markings: tuple[LathePatch, ...] | tuple[BoxPatch, ...]) -> None:
    """Raise SceneError for too many markings, equal names or overlaps (their outlines would not be edges)."""
    if len(markings) > MOST_MARKINGS:
        raise SceneError(f"{owner} has {len(markings)} markings; accepted: up to {MOST_MARKINGS}")
    for a, b in combinations(markings, 2):
        if a.name == b.name:
            raise SceneError(f"{owner} has two markings called {a.name!r}; names must differ")
        if a.overlaps(b):  # pyright: ignore[reportArgumentType]
            raise SceneError(f"{owner}: markings {a.name!r} and {b.name!r} overlap")
