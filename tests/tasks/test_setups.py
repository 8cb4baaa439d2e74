"""Set-ups of episodes: what is promised of them, measured on the scenes themselves; the same bytes in any process."""

import hashlib
import subprocess
import sys
import time
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from extremal.estimator import Camera
from extremal.estimator.errors import InvalidInput
from extremal.scenes import Lathe, Scene
from extremal.scenes.visibility import visible_edges
from extremal.sim import ArmKinematics
from extremal.tasks.grasp_motion import CupKinematics, cup_facing
from extremal.tasks.grasp_world import GraspWorld
from extremal.tasks.level_string import Section
from extremal.tasks.setups import GraspSetup, InspectSetup, NavigateSetup
from extremal.tasks.shortest_path import winding
from extremal.tasks.taut_string import string_path
from extremal.tasks.tiers import TEST_SEEDS, TIERS, Tier

KINDS = [NavigateSetup, GraspSetup, InspectSetup]
STANDARD, HELD_OUT = TIERS["standard-v0"], TIERS["held-out-v0"]
DRAWN = [(STANDARD, seed) for seed in range(8)] + [(HELD_OUT, seed) for seed in range(5)]
FEW = [(STANDARD, 0), (STANDARD, 1), (HELD_OUT, 3)] + [
    pytest.param(*pair, marks=pytest.mark.slow) for pair in DRAWN
]
KEEP = 0.04  # radius of the sphere and wanted clearance [m]


@cache
def navigate(tier: Tier, seed: int) -> NavigateSetup:
    return NavigateSetup.draw(seed, tier)


@cache
def grasp(tier: Tier, seed: int) -> GraspSetup:
    return GraspSetup.draw(seed, tier)


def in_image(T_world_camera: RigidTransform, points: np.ndarray) -> np.ndarray:
    """Which points (N, 3) the ideal camera has in its frame."""
    pixels, camera = Camera().project(T_world_camera.inv().apply(points)), Camera()
    return np.all((pixels > 0) & (pixels < (camera.width - 1, camera.height - 1)), axis=1)


def seen(scene: Scene, T_world_camera: RigidTransform, name: str, kind: str) -> list[np.ndarray]:
    """The parts (N, 3) of an object's edges of a kind that are in the frame and not hidden."""
    objects = [s for s in scene.objects if s.name != "table"]
    curves = visible_edges(objects, T_world_camera.translation)
    parts = [
        c.points[c.visible & in_image(T_world_camera, c.points)]
        for c in curves
        if (c.object, c.kind) == (name, kind)
    ]
    return [p for p in parts if len(p)]


def fingerprint() -> str:
    """A hash of what a set-up of each kind holds."""
    digest = hashlib.sha256()
    for kind in KINDS:
        for tier in (TIERS["cluttered-v0"], TIERS["textured-v0"]):
            setup = kind.draw(TEST_SEEDS[0], tier)
            for surface in setup.scene.objects:
                digest.update(surface.T_world_object.as_matrix().tobytes())
                digest.update(
                    repr((surface.name, surface.appearance, getattr(surface, "markings", ()))).encode()
                )
                digest.update(surface.signed_distance(np.eye(3)).tobytes())
            digest.update(repr(setup.scene.lights).encode())
            for value in vars(setup).values():
                if isinstance(value, np.ndarray | float | str | tuple):
                    digest.update(repr(value).encode())
                elif isinstance(value, RigidTransform):
                    digest.update(value.as_matrix().tobytes())
    return digest.hexdigest()


def test_the_same_bytes_in_another_process() -> None:
    code = "import test_setups; print(test_setups.fingerprint())"
    found = subprocess.run(
        [sys.executable, "-c", code],
        cwd=__file__.rsplit("/", 1)[0],
        capture_output=True,
        text=True,
        check=True,
    )
    assert found.stdout.strip() == fingerprint()


@pytest.mark.parametrize("tier", TIERS.values(), ids=lambda tier: tier.name)
def test_every_tier_gives_every_kind_of_set_up(tier: Tier) -> None:
    for kind in KINDS:
        setup = kind.draw(1, tier)
        names = [surface.name for surface in setup.scene.objects]
        assert ("box" in names) == (tier.crease == "present")
        assert sum(name.startswith("clutter") for name in names) == tier.clutter
        main = setup.scene.objects[1]
        painted = {m.name for m in main.markings} if isinstance(main, Lathe) else set()
        assert ("decoy" in painted) == (tier.crease == "decoy")
        assert (main.appearance.specular > 0) == (tier.appearance == "glossy")


@pytest.mark.parametrize("kind", KINDS)
def test_nothing_touches_anything_but_the_table(kind: Any) -> None:
    for seed in range(2):
        objects = kind.draw(seed, TIERS["cluttered-v0"]).scene.objects[1:]
        for a in objects:
            fixed = [curve.points[::50] for curve in a.fixed_curves()]
            # Ellipsoids and superquadrics are widest in the middle.
            middle = a.T_world_object.translation[2]
            rim = np.concatenate(fixed) if fixed else Section.of(a, middle).points[::20]
            assert all(b.signed_distance(rim).min() > 0.003 for b in objects if b is not a)


@pytest.mark.parametrize("kind", KINDS)
def test_tiers_differ_in_what_they_name_alone(kind: Any) -> None:
    p = np.random.default_rng(0).normal(0, 0.2, (40, 3))
    base = kind.draw(4, STANDARD)
    for name in (
        "no-crease-v0",
        "textured-v0",
        "glossy-v0",
        "low-contrast-v0",
        "cluttered-v0",
    ):
        other = kind.draw(4, TIERS[name])
        assert np.array_equal(
            base.scene.objects[1].signed_distance(p), other.scene.objects[1].signed_distance(p)
        )
        assert base.scene.lights == other.scene.lights


def test_seeds_that_are_refused() -> None:
    for seed in (-1, 1.5, True, None):
        with pytest.raises(InvalidInput, match="seed is"):
            NavigateSetup.draw(seed, STANDARD)  # pyright: ignore[reportArgumentType]
    with pytest.raises(InvalidInput, match="accepted in grasps"):
        GraspSetup.draw(0, STANDARD.with_options({"families": "ellipsoid"}))


# Navigate.


@pytest.mark.parametrize(("tier", "seed"), DRAWN)
def test_courses_wrap_around_an_obstacle_that_hides_the_goal(tier: Tier, seed: int) -> None:
    setup = navigate(tier, seed)
    assert setup.radius + setup.clearance == KEEP
    ends = np.stack([setup.start, setup.goal])
    gaps = setup.obstacle.signed_distance(ends) - setup.radius
    assert np.all((gaps > 0.03 - 1e-6) & (gaps < 0.05 + 1e-6))
    for surface in setup.scene.objects:
        assert surface.signed_distance(ends).min() >= KEEP
    assert 60 <= np.degrees(setup.winding) <= 120
    sight = setup.goal - setup.start
    assert setup.obstacle.intersect(setup.start, sight[None])[0] < 1
    path = setup.optimum
    assert np.allclose(path.points[[0, -1]], ends)
    assert setup.obstacle.signed_distance(path.points).min() > KEEP - 3e-6
    for surface in setup.scene.objects:
        if surface is not setup.obstacle:
            assert surface.signed_distance(path.points).min() > KEEP + 0.015
    # The path passes the obstacle on the side that it says.
    left = np.cross([0, 0, 1.0], sight)
    bulge = (path.points[len(path.points) // 2] - setup.start) @ left
    assert (bulge > 0) == (setup.side == "left")


@pytest.mark.parametrize(("tier", "seed"), FEW)
def test_the_start_sees_the_contour_generator_and_the_box(tier: Tier, seed: int) -> None:
    setup = navigate(tier, seed)
    ray = setup.contact - setup.start
    assert abs(setup.obstacle.signed_distance(setup.contact)) < 1e-6
    cosine = setup.obstacle.normals(setup.contact) @ ray / np.linalg.norm(ray)
    assert (
        abs(cosine) < 0.02
    )  # a section has points every 0.25 degrees; boxy ones bend faster at their corners
    limbs = seen(setup.scene, setup.T_world_camera, "obstacle", "extremal")
    nearest = min(np.linalg.norm(p - setup.contact, axis=1).min() for p in limbs)
    assert nearest < 0.004
    middle = Camera().project(setup.T_world_camera.inv().apply(setup.contact))
    assert np.allclose(middle, [Camera().cx, Camera().cy], atol=1e-6)
    upright = [p for p in seen(setup.scene, setup.T_world_camera, "box", "crease") if np.ptp(p[:, 2]) > 0.02]
    assert len(upright) >= 2
    # The box is on the free side of the contour.
    x = setup.T_world_camera.inv().apply(np.concatenate(upright))[:, 0]
    assert np.all(x < 0) if setup.side == "left" else np.all(x > 0)


def test_obstacles_are_of_all_families_and_not_all_round() -> None:
    kinds = {type(navigate(tier, seed).obstacle).__name__ for tier, seed in DRAWN}
    assert kinds == {"Lathe", "Ellipsoid", "Superquadric"}


def test_level_optima_agree_with_the_taut_string() -> None:
    setup = navigate(STANDARD.with_options({"families": "ellipsoid"}), 3)
    points, length = string_path(setup.obstacle, setup.start, setup.goal, KEEP)
    assert setup.optimum.length == pytest.approx(length, rel=1e-5)
    assert winding(points) == pytest.approx(setup.winding, abs=0.02)


@pytest.mark.slow
def test_level_optima_of_many_shapes_agree_with_the_taut_string() -> None:
    for family in ("ellipsoid", "superquadric", "boxy"):
        for seed in range(5):
            setup = navigate(STANDARD.with_options({"families": family}), seed)
            length = string_path(setup.obstacle, setup.start, setup.goal, KEEP)[1]
            assert setup.optimum.length == pytest.approx(length, rel=1e-5)


def test_decoys_are_near_the_contour_and_in_the_image() -> None:
    for seed in range(3):
        setup = navigate(TIERS["decoy-v0"], seed)
        stripes = np.concatenate(seen(setup.scene, setup.T_world_camera, "obstacle", "marking"))
        rays = stripes - setup.start
        to_contact = setup.contact - setup.start
        cosine = rays @ to_contact / np.linalg.norm(rays, axis=1) / np.linalg.norm(to_contact)
        assert np.degrees(np.arccos(cosine.max())) < 12
        assert np.ptp(stripes[:, 2]) > 0.03


def test_set_ups_are_drawn_quickly() -> None:
    for kind in KINDS:
        spent = []
        for seed in range(100, 109):
            begin = time.process_time()
            kind.draw(seed, STANDARD)
            spent.append(time.process_time() - begin)
        assert np.median(spent) < 0.2  # at most 0.1 s on a quiet machine


# Grasp.


@pytest.mark.parametrize(("tier", "seed"), DRAWN[::2])
def test_grasps_are_where_no_view_saw_the_vase(tier: Tier, seed: int) -> None:
    setup = grasp(tier, seed)
    r = setup.vase.profile.spline(setup.level)
    assert 0.025 <= r <= 0.08
    low, high = np.degrees(setup.azimuth_range)
    assert high - low > 8 and 135 <= low < high <= 285 + 1e-9
    generator = np.degrees(setup.generator)
    assert low == pytest.approx(generator + 45) and high <= generator + 90 + 1e-9
    azimuth = np.linspace(setup.generator - 0.02, setup.azimuth_range[1], 40)
    points = np.stack([r * np.cos(azimuth), r * np.sin(azimuth), np.full(40, setup.level)], axis=1)
    facing = setup.views.translation[:, None] - points
    faced = np.any(np.sum(setup.vase.normals(points) * facing, axis=-1) > 0, axis=0)
    # Seen up to the generator, and not beyond it.
    assert faced[0] and not faced[azimuth > setup.generator + 1e-6].any()
    assert np.allclose(setup.view_direction, setup.views[len(setup.views) // 2].as_matrix()[:3, 2])


@pytest.mark.parametrize(("tier", "seed"), DRAWN[::3])
def test_every_view_is_reached_and_sees_the_right_contour_and_the_box(tier: Tier, seed: int) -> None:
    setup = grasp(tier, seed)
    ArmKinematics(setup.T_world_base).joint_positions(setup.views)
    for i in (0, len(setup.views) // 2, len(setup.views) - 1):
        pose = setup.views[i]
        upright = [p for p in seen(setup.scene, pose, "box", "crease") if np.ptp(p[:, 2]) > 0.02]
        assert len(upright) >= 2
        limb = np.concatenate(seen(setup.scene, pose, "vase", "extremal"))
        at_level = limb[np.abs(limb[:, 2] - setup.level) < 0.002]
        assert pose.inv().apply(at_level)[:, 0].max() > 0.01


@pytest.mark.slow
def test_grasps_at_the_true_surface_succeed_among_the_obstacles() -> None:
    for seed in range(8):
        setup = grasp(TIERS["cluttered-v0"], seed)
        cup = CupKinematics(setup.T_world_base)
        azimuth = np.random.default_rng(seed).uniform(*setup.azimuth_range)
        r = float(setup.vase.profile.spline(setup.level))
        point = np.array([[r * np.cos(azimuth), r * np.sin(azimuth), setup.level]])
        pose = cup_facing(point, setup.vase.normals(point))[0]
        before, after = (pose * RigidTransform.from_translation([0, 0, s]) for s in (-0.02, 0.01))
        path = cup.straight_approach(before, after)
        obstacles = [s for s in setup.scene.objects if s.name not in ("table", "vase")]
        world = GraspWorld(setup.vase, cup, path[0], obstacles)
        world.approach(path)
        world.lift()
        world.hold(1.05)
        assert world.outcome.success, world.outcome
