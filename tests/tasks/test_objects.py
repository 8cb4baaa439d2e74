"""Random objects of every family: what is promised of them, measured on the surfaces themselves."""

from functools import cache

import numpy as np
import pytest

from extremal.estimator.errors import InvalidInput
from extremal.scenes import Appearance, Lathe, Surface
from extremal.tasks.level_string import Section, polyline_length, ways_around
from extremal.tasks.objects import (
    FAMILIES,
    HELD_OUT,
    LATHES,
    RATIO,
    STEEPEST,
    TIGHTEST,
    TRAINING,
    random_object,
)

SIZES = [((0.015, 0.08), 0.1), ((0.06, 0.15), 0.25)]
SEEDS = range(20)


def reach(surface: Surface, level: float, azimuths: np.ndarray) -> np.ndarray:
    """Distances from the vertical axis at which rays that come in from outside meet the surface."""
    out = np.stack([np.cos(azimuths), np.sin(azimuths), np.zeros(len(azimuths))], axis=1)
    return 2.0 - surface.intersect([0, 0, level] + 2.0 * out, -out)


@cache
def drawn(family: str) -> list[tuple[Surface, tuple[float, float], float]]:
    return [
        (random_object(family, np.random.default_rng([7, seed]), radius=radius, level=level), radius, level)
        for seed in SEEDS
        for radius, level in SIZES
    ]


@pytest.mark.parametrize("family", FAMILIES)
def test_radii_at_the_level_are_in_the_range_and_fill_it(family: str) -> None:
    relative = []
    for surface, (least, most), level in drawn(family)[: 24 if family in ("superquadric", "boxy") else None]:
        x = surface.T_world_object.rotation.as_matrix()[:, 0]
        axes = np.arctan2(x[1], x[0]) + np.array([0, np.pi / 2])
        r = reach(surface, level, axes)
        assert least - 1e-9 <= r.min() <= r.max() <= most + 1e-9
        assert r.max() / r.min() < RATIO + 1e-9
        assert (np.ptp(r) < 1e-12) == isinstance(surface, Lathe) == (family in LATHES)
        relative.append((r.max() - least) / (most - least))
    # Of 12 uniform draws, for a lathe or an ellipsoid's longer axis, none in the outer thirds: 2 * (2/3)^12 < 2 %.
    assert min(relative) < 1 / 3 and max(relative) > 2 / 3


@pytest.mark.parametrize("family", FAMILIES)
def test_objects_stand_on_the_table_about_twice_as_high_as_the_level(family: str) -> None:
    for surface, _, level in drawn(family)[:8]:
        down = surface.intersect([[0, 0, 3.0]], [[0, 0, -1.0]])[0]
        assert 1.8 <= (3.0 - down) / level <= 2.2
        assert surface.signed_distance([0.0, 0.0, 0.0]) == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize("family", LATHES)
def test_meridians_are_gentle(family: str) -> None:
    for surface, _, level in drawn(family):
        assert isinstance(surface, Lathe)
        z = np.linspace(0, surface.profile.height, 801)
        r = surface.profile.spline(z)
        slope, step = np.gradient(r, z), z[1]
        bend = np.abs(np.diff(r, 2)) / step**2 / (1 + slope[1:-1] ** 2) ** 1.5
        assert np.abs(slope).max() < STEEPEST * 1.01
        assert bend.max() * TIGHTEST * level < 1.01


def test_families_are_what_their_names_say() -> None:
    signs = {"barrel": 1, "waisted": -1, "cone": 0}
    for family, sign in signs.items():
        for surface, _, level in drawn(family):
            point = Section.of(surface, level).points[:1]
            kappa = surface.gaussian_curvature(point)[0] * level**2
            assert np.sign(np.round(kappa, 2)) == sign if sign == 0 else sign * kappa > 0
    assert set(TRAINING) | set(HELD_OUT) == set(FAMILIES) and not set(TRAINING) & set(HELD_OUT)


def test_the_same_generator_gives_the_same_object_and_appearance_is_kept() -> None:
    look = Appearance((0.2, 0.3, 0.4, 1.0), 0.5, 0.6)
    for family in FAMILIES:
        a, b = (random_object(family, np.random.default_rng(3), appearance=look, name="a") for _ in range(2))
        p = np.random.default_rng(4).normal(size=(50, 3)) * 0.2
        assert np.array_equal(a.signed_distance(p), b.signed_distance(p))
        assert a.appearance == look and a.name == "a"


def test_what_is_refused() -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(InvalidInput, match=r"'teapot'.*barrel, waisted.*boxy"):
        random_object("teapot", rng)
    for radius, level in [
        ((0.08, 0.015), 0.1),
        ((0.0, 0.1), 0.1),
        ((0.02, np.nan), 0.1),
        ((0.02, 0.03), 0.0),
    ]:
        with pytest.raises(InvalidInput, match="radius is"):
            random_object("barrel", rng, radius=radius, level=level)


@pytest.mark.parametrize("family", FAMILIES)
def test_sections_lie_on_the_surface(family: str) -> None:
    for surface, _, level in drawn(family)[:6]:
        section = Section.of(surface, level)
        assert np.abs(surface.signed_distance(section.points[::60])).max() < 1e-9
        assert np.abs(section.points[:, 2] - level).max() < 1e-12


def test_both_ways_around_a_circle_in_closed_form() -> None:
    cylinder = Lathe([0, 0.2, 0.4], [0.08] * 3)
    start, goal = np.array([-0.2, 0.0, 0.2]), 0.15 * np.array([np.cos(0.3), np.sin(0.3), 0]) + [0, 0, 0.2]
    ways = ways_around(Section.of(cylinder, 0.2), start, goal, 0.04)
    assert ways is not None
    free = np.sqrt(0.2**2 - 0.12**2) + np.sqrt(0.15**2 - 0.12**2)
    for way, angle in zip(ways, (np.pi + 0.3, np.pi - 0.3), strict=True):
        wrap = angle - np.arccos(0.12 / 0.2) - np.arccos(0.12 / 0.15)
        assert polyline_length(way) == pytest.approx(free + 0.12 * wrap, rel=2e-6)
        assert np.allclose(way[[0, -1]], [start, goal])
    assert ways[0][len(ways[0]) // 2, 1] < 0 < ways[1][len(ways[1]) // 2, 1]
    beside = ways_around(Section.of(cylinder, 0.2), np.array([-0.2, 0.3, 0]), np.array([0.2, 0.3, 0]), 0.04)
    assert beside is None
