"""Truth of inspections against closed forms, and against circles through points of the section."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from extremal.estimator import Camera
from extremal.estimator.errors import DegenerateGeometry, InvalidInput
from extremal.scenes import Scene, Sphere
from extremal.sim import fixating
from extremal.tasks.level_string import Section
from extremal.tasks.setups import InspectSetup, inspect_truth
from extremal.tasks.tiers import TIERS, Tier

STANDARD, HELD_OUT = TIERS["standard-v0"], TIERS["held-out-v0"]


def test_the_start_has_the_object_and_the_box_in_the_frame() -> None:
    camera = Camera()
    for tier in (STANDARD, HELD_OUT):
        for seed in range(15):
            setup = InspectSetup.draw(seed, tier)
            box, surface = setup.scene["box"], setup.scene["object"]
            creases = np.concatenate([c.points for c in box.fixed_curves() if np.ptp(c.points[:, 2]) > 0.02])
            outline = Section.of(surface, setup.fixation[2]).points
            pixels = camera.project(setup.T_world_camera.inv().apply(np.concatenate([creases, outline])))
            assert np.all((pixels > 0) & (pixels < (camera.width, camera.height)))
            eye = setup.T_world_camera.translation
            assert np.mean(surface.intersect(eye, creases[::40] - eye) > 1) >= 0.5


def with_sphere(radius: float) -> InspectSetup:
    """A set-up whose object is a sphere about the fixation point, alone."""
    setup = InspectSetup.draw(2, TIERS["no-crease-v0"])
    ball = Sphere(radius, name="object", T_world_object=RigidTransform.from_translation(setup.fixation))
    return replace(setup, scene=Scene((ball,)))


def test_the_truth_of_a_sphere_in_closed_form() -> None:
    for side, sign in (("left", -1.0), ("right", 1.0)):
        setup = replace(with_sphere(0.05), side=side)
        pose = setup.T_world_camera
        answer = inspect_truth(setup, pose)
        d = np.linalg.norm(pose.translation - setup.fixation)
        local = pose.inv().apply(answer.point)
        expected = [sign * 0.05 * np.sqrt(1 - (0.05 / d) ** 2), 0, d - 0.05**2 / d]
        assert np.abs(local - expected).max() < 1e-9
        assert answer.radius == pytest.approx(0.05) and answer.visible
        assert answer.kind == "extremal" and not answer.is_fixed


@pytest.mark.parametrize(
    ("tier", "seed"), [(STANDARD, s) for s in range(8)] + [(HELD_OUT, s) for s in range(4)]
)
def test_the_truth_is_the_circle_through_three_points_of_the_section(tier: Tier, seed: int) -> None:
    setup = InspectSetup.draw(seed, tier)
    pose = fixating(setup.T_world_camera.translation[None] + [0.02, 0.15, 0.03], setup.fixation)[0]
    answer = inspect_truth(setup, pose)
    target = setup.scene[setup.target]
    centre, right, down = pose.translation, *pose.as_matrix()[:3, :2].T
    assert abs((answer.point - centre) @ down) < 1e-9
    assert np.sign((answer.point - setup.fixation) @ right) == (-1 if setup.side == "left" else 1)
    assert abs(target.signed_distance(answer.point)) < 1e-6
    if setup.target == "box":
        assert answer.kind == "crease" and answer.radius == 0 and answer.is_fixed
        return
    ray = answer.point - centre
    assert abs(answer.normal @ ray) < 1e-8
    # Rays from outside meet the section near the contact.
    inward = np.cross(np.cross(answer.normal, down), down)
    inward *= -np.sign(inward @ answer.normal) / np.linalg.norm(inward)
    along = np.cross(inward, down)
    s = 3e-4
    outside = answer.point - 0.02 * inward + np.array([[-s], [0], [s]]) * along
    a, b, c = outside + target.intersect(outside, np.tile(inward, (3, 1)))[:, None] * inward
    area = np.linalg.norm(np.cross(b - a, c - a)) / 2
    measured = np.prod([np.linalg.norm(v) for v in (a - b, b - c, c - a)]) / (4 * area)
    assert answer.radius == pytest.approx(measured, rel=0.01)


def test_hidden_targets_are_said_to_be_and_what_has_no_answer_is_refused() -> None:
    setup = with_sphere(0.03)
    pose = setup.T_world_camera
    half = (pose.translation + setup.fixation) / 2
    screen = Sphere(0.06, name="screen", T_world_object=RigidTransform.from_translation(half))
    hidden = replace(setup, scene=Scene((*setup.scene.objects, screen)))
    assert not inspect_truth(hidden, pose).visible
    above = RigidTransform.from_translation(np.add(setup.fixation, [0, 0, 0.5]))
    with pytest.raises(DegenerateGeometry, match="above or below"):
        inspect_truth(setup, above)
    with pytest.raises(DegenerateGeometry, match="no outline"):
        inspect_truth(setup, RigidTransform.from_translation(np.add(setup.fixation, [0.01, 0, 0])))
    with pytest.raises(InvalidInput, match="not one finite pose"):
        inspect_truth(setup, RigidTransform.concatenate([pose, pose]))


def test_the_question_stays_about_one_edge_of_the_box() -> None:
    """Though from elsewhere another edge is the outline, or hides it; and at the start no other edge is in line with it."""
    asked = [setup for s in range(60) if (setup := InspectSetup.draw(s, STANDARD)).target == "box"]
    assert len(asked) >= 6
    for setup in asked[:6]:
        pose, camera = setup.T_world_camera, Camera()
        start = inspect_truth(setup, pose)
        corners = [c.points[0] for c in setup.scene["box"].fixed_curves() if np.ptp(c.points[:, 2]) > 0.02]
        level = np.column_stack([np.array(corners)[:, :2], np.full(4, start.point[2])])
        across = camera.project(pose.inv().apply(level))[:, 0]
        mine = int(np.argmin(np.linalg.norm(level - start.point, axis=1)))
        assert np.linalg.norm(level[mine] - start.point) < 1e-6
        assert np.min(np.abs(np.delete(across, mine) - across[mine])) > 15
        assert mine == (np.argmin(across) if setup.side == "left" else np.argmax(across))
        for sideways in (-0.3, -0.15, 0.15, 0.3):
            there = pose.apply([sideways, 0.0, 0.0])
            answer = inspect_truth(setup, fixating(there[None], setup.fixation)[0])
            assert np.linalg.norm(answer.point[:2] - start.point[:2]) < 1e-6
            assert answer.is_fixed and answer.radius == 0
