"""What degenerate geometry gives: an error of a type of its own, or rows that say that they are not valid.

The table is the specification. "row": `valid` is False, sigma infinite, and every other number finite.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from extremal.estimator import (
    Camera,
    DegenerateGeometry,
    InvalidInput,
    OsculatingCircle,
    PosePrior,
    View,
    estimate_shape,
    osculating_circle,
    second_order_shape,
)
from extremal.estimator.camera import Array
from extremal.estimator.hand_eye import hand_eye

CENTRES = np.array([[-0.05, 0, 0], [-0.02, 0, 0], [0.02, 0, 0], [0.05, 0, 0]])
RADIUS, DISTANCE = 0.04, 0.5


def rays(centres: Array = CENTRES, radius: float = RADIUS, distance: float = DISTANCE) -> Array:
    """Unit rays (V, 3) that touch a circle in the plane y = 0 at z = `distance`, on its right."""
    to = np.array([0, 0, distance]) - centres
    length = np.linalg.norm(to, axis=1)
    turn = np.arcsin(radius / length)
    x, z = to[:, 0] / length, to[:, 2] / length
    cos, sin = np.cos(turn), np.sin(turn)
    return np.stack([cos * x + sin * z, 0 * x, cos * z - sin * x], axis=1)


def circle(centres: Array = CENTRES, p: Array | None = None, sigma: Any = 1e-4) -> OsculatingCircle:
    with np.errstate(divide="ignore", invalid="ignore"):
        return osculating_circle(centres, rays() if p is None else p, sigma, np.array([0.0, 1.0, 0.0]))


def at(index: int, value: Any, values: Array) -> Array:
    changed = np.array(values)
    changed[index] = value
    return changed


# Circles: what was done to four views of a circle.
CIRCLES: dict[str, Callable[[], OsculatingCircle]] = {
    "parallel rays": lambda: circle(p=np.tile(rays()[:1], (4, 1))),
    "zero baseline": lambda: circle(np.tile(CENTRES[:1], (4, 1))),
    "zero baseline, repeated views": lambda: circle(
        np.tile(CENTRES[:1], (4, 1)), np.tile(rays()[:1], (4, 1))
    ),
    "pure rotation": lambda: circle(np.zeros((4, 3)), rays()),
    "target behind": lambda: circle(p=-rays()),
    "target behind one camera": lambda: circle(p=at(1, -rays()[1], rays())),
    "motion along the ray": lambda: circle(
        np.array([[0, 0, z] for z in (0, 0.1, 0.2, 0.3)]), np.tile([0, 0, 1.0], (4, 1))
    ),
    "a centre that is not a number": lambda: circle(at(1, np.nan, CENTRES)),
    "an infinite centre": lambda: circle(at(1, np.inf, CENTRES)),
    "a ray that is not a number": lambda: circle(p=at(1, np.nan, rays())),
    "a ray of no length": lambda: circle(p=at(1, 0.0, rays())),
    "a ray across the plane": lambda: circle(p=at(1, [0, 1.0, 0], rays())),
    "infinite sigma": lambda: circle(sigma=np.inf),
    "infinite sigma in all views but two": lambda: circle(sigma=[1e-4, np.inf, np.inf, 1e-4]),
    "two different views, each repeated": lambda: circle(CENTRES[[0, 0, 3, 3]], rays()[[0, 0, 3, 3]]),
    "a target at infinity": lambda: circle(p=rays(distance=1e14)),
    "three views of which two are one": lambda: circle(CENTRES[[0, 0, 3]], rays()[[0, 0, 3]]),
}


@pytest.mark.parametrize("case", CIRCLES)
def test_circles_that_are_not_determined_are_rows_that_say_so(case: str) -> None:
    found = CIRCLES[case]()
    assert not found.valid and np.isposinf(found.sigma_radius)
    for name in ("radius", "centre", "points", "distances", "normals", "residuals", "gain"):
        assert np.all(np.isfinite(getattr(found, name))), name


def test_the_same_views_undisturbed_are_determined() -> None:
    """Otherwise the table would say nothing; a fixed point, coincident contours in other words, has the radius 0."""
    found = circle()
    assert found.valid and abs(found.radius) == pytest.approx(RADIUS, abs=1e-9)
    point = circle(p=rays(radius=0.0))
    assert point.valid and point.radius == pytest.approx(0, abs=1e-9)
    assert np.isfinite(point.sigma_radius) and point.sigma_radius > 0
    row = osculating_circle(CENTRES, np.stack([rays(), -rays()]), 1e-4, np.array([0.0, 1.0, 0.0]))
    assert row.valid.tolist() == [True, False]  # one bad row leaves the others alone


EDGELS = 9
ALONG = np.linspace(-0.2, 0.2, EDGELS)[:, None] * np.array([1.0, 0, 0])
AHEAD = np.tile([0, 0, 1.0], (EDGELS, 1))


def sphere(centres: Array) -> tuple[Array, Array, Array, Array]:
    """Edgels (M) of a sphere at z = 0.5: centres, rays, normals, sigma."""
    to = np.array([0, 0, DISTANCE]) - centres
    length = np.linalg.norm(to, axis=1, keepdims=True)
    side = np.cross([0, 1.0, 0], to / length)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    sine = RADIUS / length
    p = np.sqrt(1 - sine**2) * to / length + sine * side
    n = np.cross(p, np.tile([0, 1.0, 0], (len(p), 1)))
    return centres, p, n / np.linalg.norm(n, axis=1, keepdims=True), np.full(len(p), 1e-4)


def second_order(centres: Array = ALONG, **changes: Any) -> Any:
    v, p, n, s = sphere(centres)
    given = {"centres": v, "rays": p, "normals": n, "sigma": s} | changes
    return second_order_shape(**given)


# A plane curve seen edge on is a straight line in the image from everywhere in its plane.
SECOND_ORDER: dict[str, Callable[[], Any]] = {
    "zero baseline": lambda: second_order(np.zeros((EDGELS, 3))),
    "parallel rays": lambda: second_order(rays=AHEAD, normals=np.tile([1.0, 0, 0], (EDGELS, 1))),
    "target behind": lambda: second_order(rays=-sphere(ALONG)[1]),
    "infinite sigma": lambda: second_order(sigma=np.full(EDGELS, np.inf)),
    "plane curve seen edge on": lambda: second_order(normals=np.tile([0, 1.0, 0], (EDGELS, 1)), rays=in_plane()),
    "motion along the ray": lambda: second_order(
        np.zeros((EDGELS, 3)) + np.linspace(0, 0.2, EDGELS)[:, None] * [0, 0, 1.0], rays=AHEAD,
        normals=np.tile([1.0, 0, 0], (EDGELS, 1)),
    ),
    "one edgel, repeated": lambda: second_order_shape(*(np.repeat(a[:1], EDGELS, axis=0) for a in sphere(ALONG))),
}  # fmt: skip


def in_plane() -> Array:
    to = np.array([0, 0, DISTANCE]) - ALONG
    return to / np.linalg.norm(to, axis=1, keepdims=True)


@pytest.mark.parametrize("case", SECOND_ORDER)
def test_surfaces_that_are_not_determined_are_rows_that_say_so(case: str) -> None:
    found = SECOND_ORDER[case]()
    assert not found.valid and np.all(np.isposinf(np.diagonal(found.covariance, axis1=-2, axis2=-1)))
    assert np.all(np.isfinite(found.position)) and np.isfinite(found.gaussian)
    assert np.isposinf(found.sigma_gaussian) and np.all(np.isposinf(found.sigma_curvatures))


CAMERA = Camera(64, 48, fx=80.0, fy=80.0)
VIEW = View(CAMERA, RigidTransform.identity(), np.zeros((48, 64), np.uint8))
MOVED = [replace(VIEW, T_world_camera=RigidTransform.from_translation(c)) for c in CENTRES]
TURNED = [
    replace(VIEW, T_world_camera=RigidTransform.from_rotation(Rotation.from_rotvec([0, a, 0])))
    for a in (0.0, 0.1, 0.2)
]
ONE_AXIS = RigidTransform.from_rotation(Rotation.from_rotvec([[0, 0, a] for a in (0.0, 0.3, 0.6, 0.9)]))


def tilted(size: float) -> Array:
    """A covariance that is not positive semi-definite."""
    return np.diag([1.0, 1, 1, 1, 1, -1]) * size


# Errors: what is called, the error's type, and a part of its message.
ERRORS: dict[str, tuple[Callable[[], object], type[Exception], str]] = {
    "two views for a circle": (lambda: osculating_circle(CENTRES[:2], rays()[:2]), DegenerateGeometry, "2 views"),
    "two views for a shape": (lambda: estimate_shape(MOVED[:2]), DegenerateGeometry, "2 view"),
    "repeated views": (lambda: estimate_shape([VIEW] * 4), DegenerateGeometry, "accepted: a baseline"),
    "pure rotation": (lambda: estimate_shape(TURNED), DegenerateGeometry, "accepted: a baseline"),
    "few edgels": (lambda: second_order_shape(*(a[:6] for a in sphere(ALONG))), DegenerateGeometry, "6 edgels"),
    "sigma of zero": (lambda: circle(sigma=0.0), InvalidInput, "positive"),
    "sigma that is not a number": (lambda: circle(sigma=np.nan), InvalidInput, "positive"),
    "second order, sigma of zero": (lambda: second_order(sigma=np.zeros(EDGELS)), InvalidInput, "accepted: positive"),
    "second order, a centre that is not a number": (
        lambda: second_order(centres=ALONG, rays=at(1, np.nan, AHEAD)), InvalidInput, "not finite",
    ),
    "a view with a pose that is not a number": (
        lambda: replace(VIEW, T_world_camera=RigidTransform.from_translation([np.nan, 0, 0])), InvalidInput, "not finite",
    ),
    "a view with an infinite covariance": (
        lambda: replace(VIEW, pose_covariance=np.full((6, 6), np.inf)), InvalidInput, "finite",
    ),
    "a covariance that is none": (
        lambda: PosePrior.of([replace(v, pose_covariance=tilted(1e-6)) for v in MOVED]), InvalidInput, "semi-definite",
    ),
    "hand-eye about one axis": (lambda: hand_eye(ONE_AXIS, ONE_AXIS), DegenerateGeometry, "two axes"),
    "hand-eye without motion": (lambda: hand_eye(ONE_AXIS[[0] * 4], ONE_AXIS[[0] * 4]), DegenerateGeometry, "two axes"),
    "hand-eye of two views": (lambda: hand_eye(ONE_AXIS[:2], ONE_AXIS[:2]), DegenerateGeometry, "2 views"),
}  # fmt: skip


@pytest.mark.parametrize("case", ERRORS)
def test_errors_have_a_type(case: str) -> None:
    call, kind, part = ERRORS[case]
    with pytest.raises(kind, match=part) as caught:
        call()
    assert len(str(caught.value).splitlines()) == 1


def test_zero_covariance_is_exact_and_blank_images_have_no_points() -> None:
    """No contour at all, as one of no length: no row, rather than a row of zeros."""
    assert PosePrior.of(MOVED).exact
    found = estimate_shape(MOVED)
    assert len(found.radius) == len(found.sigma_radius) == len(found.position) == 0
