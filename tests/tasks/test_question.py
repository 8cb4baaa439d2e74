"""What features say of the contour that is asked about, against circles and spheres in closed form."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from extremal.estimator import Camera
from extremal.estimator.camera import Array
from extremal.sim import fixating
from extremal.tasks.question import BEYOND, LEAST_SIGMA, ROUND, Question, Tracked, interpolating

CAMERA, FIXATION, R = Camera(), np.array([0.0, 0.0, 0.1]), 0.04
UP = np.array([0.0, 0.0, 1.0])
EYE = np.array([-0.53, 0.02, 0.19])


def sphere_contour(eye: Array, angle: Array) -> tuple[Array, Array]:
    """Contact points and normals (n, 3) of a sphere about FIXATION, at angles from the right-hand side upwards."""
    away = eye - FIXATION
    d = np.linalg.norm(away)
    pose = fixating(eye[None], FIXATION)[0].rotation.as_matrix()
    around = np.cos(angle)[:, None] * pose[:, 0] - np.sin(angle)[:, None] * pose[:, 1]
    normal = R / d * away / d + np.sqrt(1 - (R / d) ** 2) * around
    return FIXATION + R * normal, normal


def question() -> tuple[Question, RigidTransform]:
    """About the right-hand outline of the sphere."""
    first = fixating(EYE[None], FIXATION)[0]
    asked = sphere_contour(EYE, np.zeros(1))[0]
    return Question(CAMERA, first, CAMERA.project(first.inv().apply(asked))[0]), first


def told(eye: Array) -> Tracked:
    """Features all around the sphere, nowhere at the level that is asked about, and of an edge far to the left."""
    angle = np.radians([-50, -28, -9, 13, 34, 60, 120, 170, 190, 250])
    points, normals = sphere_contour(eye, angle)
    edge = FIXATION + np.column_stack([np.zeros(3), np.full(3, 0.12), [-0.02, 0.0, 0.03]])
    return Tracked(
        np.concatenate([points, edge]),
        np.concatenate([normals, np.tile([0.0, 1.0, 0.0], (3, 1))]),
        np.array([0] * 10 + [1] * 3),
        np.full(13, 30),
        np.append(np.full(10, R), np.zeros(3)),
        np.full(13, 0.001),
    )


def test_those_near_the_pixel_belong() -> None:
    asked, _ = question()
    seen = told(EYE)
    np.testing.assert_array_equal(np.flatnonzero(asked.belongs(seen)), [1, 2, 3, 4])
    assert not asked.belongs(replace(seen, looks=np.full(13, 2))).any()
    nothing = Tracked(*(getattr(seen, name)[:0] for name in Tracked.__dataclass_fields__))
    assert len(asked.belongs(nothing)) == 0
    assert asked.answer(EYE, nothing) is None


@pytest.mark.parametrize("sideways", [0.0, -0.15, 0.15])
def test_the_contact_is_where_the_view_of_the_answer_has_it(sideways: float) -> None:
    """Interpolated along one outline of a closed contour, slid over the surface to where the eye is now."""
    asked, first = question()
    seen = told(first.apply([0.05, 0.0, 0.0]))
    eye = first.apply([sideways, 0.0, 0.0])
    found = asked.answer(eye, seen)
    assert found is not None
    expected = sphere_contour(eye, np.zeros(1))[0][0]
    assert np.linalg.norm(found.point - expected) < 0.0015
    assert found.radius == pytest.approx(R, rel=0.02) and found.extremal > 0.99
    assert abs(asked.plane(eye) @ (found.point - eye)) < 1e-9


def test_a_contour_that_is_known_to_one_side_goes_on_to_where_it_is_asked_about() -> None:
    """The limb of an upright cylinder, tracked from 25 mm above the plane on."""
    first = fixating(EYE[None], FIXATION)[0]
    axis = FIXATION[:2] - EYE[:2]
    away = np.linalg.norm(axis)
    side = axis @ np.array([[0.0, -1.0], [1.0, 0.0]]) / away
    normal = np.append(side * np.sqrt(1 - (R / away) ** 2) - axis / away * R / away, 0.0)
    foot = np.append(FIXATION[:2], 0.0) + R * normal
    assert abs(normal[:2] @ (foot - EYE)[:2]) < 1e-12
    level = EYE[2] + (FIXATION - EYE)[2] / away * np.linalg.norm((foot - EYE)[:2])
    asked = Question(CAMERA, first, CAMERA.project(first.inv().apply(foot + level * UP)[None])[0])
    there = foot + (level + 0.025 + 0.012 * np.arange(4))[:, None] * UP
    seen = Tracked(
        there, np.tile(normal, (4, 1)), np.zeros(4, int), np.full(4, 30), np.full(4, R), np.full(4, 0.001)
    )
    found = asked.answer(EYE, seen)
    assert found is not None and found.radius == pytest.approx(R)
    assert abs(asked.plane(EYE) @ (found.point - EYE)) < 1e-9
    # how it goes on along the rays, it is not told
    assert np.linalg.norm(found.point - foot - level * UP) < 0.005


def test_normals_and_radii_of_the_wrong_sign_are_the_same_feature() -> None:
    asked, _ = question()
    seen = told(EYE)
    flip = np.where(np.arange(13) == 2, -1.0, 1.0)
    as_it_is = asked.answer(EYE, seen)
    again = asked.answer(EYE, replace(seen, normal=flip[:, None] * seen.normal, radius=flip * seen.radius))
    assert as_it_is is not None and again is not None
    assert np.linalg.norm(again.point - as_it_is.point) < 1e-12
    assert again.radius == pytest.approx(as_it_is.radius)


def test_what_is_hardly_known_leaves_the_answer_as_it_is() -> None:
    """A track that was lost early, between others."""
    asked, _ = question()
    seen = told(EYE)
    row = np.arange(13) == 3
    lost = replace(seen, radius=np.where(row, 0.01, seen.radius), sigma=np.where(row, 0.04, seen.sigma))
    found = asked.answer(EYE, lost)
    assert found is not None
    assert found.radius == pytest.approx(R, rel=0.02) and found.sigma < 0.003


def test_the_plane_of_the_question_holds_the_pixels_ray_and_is_level_across() -> None:
    asked, first = question()
    ray = first.rotation.apply(CAMERA.rays(asked.query))
    assert abs(asked.plane(EYE) @ ray) < 1e-12
    for eye in (EYE, first.apply([0.2, 0.0, 0.0])):
        level = np.cross(FIXATION - eye, [0.0, 0.0, 1.0])
        assert abs(asked.plane(eye) @ (FIXATION - eye)) < 1e-3
        assert abs(asked.plane(eye) @ level / np.linalg.norm(level)) < 0.02


def test_sigma_is_that_of_errors_that_are_alike_or_of_each_its_own() -> None:
    """Of equal sigma, interpolated with weights that add up to one."""
    asked, _ = question()
    found = asked.answer(EYE, told(EYE))
    assert found is not None
    assert found.sigma == pytest.approx(np.sqrt(0.001**2 + (ROUND * R) ** 2 + LEAST_SIGMA**2), rel=1e-3)


def test_weights_interpolate_parabolas() -> None:
    rng = np.random.default_rng(4)
    a, b, c = rng.standard_normal(3)
    for n in (3, 4, 9):
        h = rng.uniform(-0.03, 0.03, n)
        h[:2] = -0.004, 0.007
        weight = interpolating(h)
        assert weight @ (a + b * h + c * h**2) == pytest.approx(a, abs=1e-9)
    for h, values in (([0.004, 0.02], [1.4, 3.0]), ([-0.01, 0.02], [0.0, 3.0])):
        assert interpolating(np.array(h)) @ values == pytest.approx(1.0)  # a line
    np.testing.assert_array_equal(interpolating(np.array([2 * BEYOND, 3 * BEYOND])), [1.0, 0.0])
    np.testing.assert_array_equal(interpolating(np.array([0.5])), [1.0])
