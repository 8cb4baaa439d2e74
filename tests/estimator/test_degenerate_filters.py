"""Filters and corner fits on spoilt input: an error of a type of its own, or rows that say that they are not known."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from extremal.estimator import Camera, DegenerateGeometry, ExtremalError, InvalidInput
from extremal.estimator.board import Board
from extremal.estimator.camera import Array
from extremal.estimator.circle_filter import CircleFilter
from extremal.estimator.contour_filter import ContourFilter
from extremal.estimator.corner_fit import CornerFit, Windows, fit_corners
from extremal.estimator.corners import Corners, find_corners
from extremal.estimator.epipolar import EpipolarPlanes

pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")  # numbers that overflow

VALUES = (np.nan, np.inf, -np.inf, 0.0, -1.0, 1e-300, 1e-160, 1e5, 1e10, -1e10, 1e160, 1e300)
N, DEPTH = 6, 0.6


def spoilt(values: Any, rng: np.random.Generator) -> Array:
    """One number replaced, all of them, all scaled; rows left out, or all alike; seldom nothing."""
    out, value = np.array(values, float), VALUES[rng.integers(len(VALUES))]
    match rng.integers(8):
        case 0:
            return out
        case 1 | 2 | 3:
            out.flat[rng.integers(out.size)] = value
        case 4:
            out *= value
        case 5:
            return out[: rng.integers(len(out))] if out.ndim else out
        case 6:
            out[...] = out[0] if out.ndim else value
        case _:
            out[...] = value
    return out


def survives(call: Callable[[], None]) -> bool:
    """Whether a call ended well; False: with an error that extremal raises on purpose, in one line."""
    try:
        call()
    except ExtremalError as error:
        assert "\n" not in str(error) and len(str(error)) < 600
        return False
    return True


def fuzzed(attempt: Callable[[np.random.Generator], None], count: int) -> None:
    """Some attempts are refused, some give results, none does anything else."""
    rng = np.random.default_rng(5)
    well = [survives(lambda: attempt(rng)) for _ in range(count)]
    assert count / 20 < sum(well) < count * 19 / 20


# The circle filter: six circles, seen by a camera that moves along x.
RAYS = np.stack([np.linspace(-0.2, 0.2, N), np.linspace(0, 0.5, N), np.ones(N)], axis=1)
RAYS /= np.linalg.norm(RAYS, axis=1, keepdims=True)


def circles(rays: Array = RAYS, **given: Array) -> CircleFilter:
    planes = EpipolarPlanes.through(np.zeros(3), np.array([1.0, 0, 0]), RAYS)
    values = {"depth": np.full(N, DEPTH), "sigma": np.full(N, 1e-4)} | given
    return CircleFilter(planes, rays, values["depth"], values["sigma"])


def check_prediction(found: CircleFilter, centre: Array) -> Array:
    points, sigma = found.predict(centre)
    known = np.isfinite(sigma)
    assert np.all(np.isfinite(points[known])) and np.all(sigma[known] > 0)
    assert np.all(np.isnan(points[~known])) and np.all(np.isposinf(sigma[~known]))
    return known


def test_circle_filter_survives_anything() -> None:
    def attempt(rng: np.random.Generator) -> None:
        which = rng.integers(8)

        def given(i: int, value: Any) -> Array:
            return spoilt(value, rng) if which == i else np.array(value, float)

        found = circles(given(0, RAYS), depth=given(1, np.full(N, DEPTH)), sigma=given(2, np.full(N, 1e-4)))
        for i in range(3):
            centre = given(3, [0.02 * (i + 1), 0, 0])
            check_prediction(found, centre)
            rays = given(4, RAYS)
            found.innovation(centre, given(5, DEPTH * RAYS), rays)
            found.update(np.ones(N, bool), centre, rays, given(6, np.full(N, 1e-4)), given(7, DEPTH * RAYS))
            check_prediction(found, centre + 0.01)

    fuzzed(attempt, 250)


def test_a_spoilt_circle_leaves_the_others_as_they_were() -> None:
    rays, depth = RAYS.copy(), np.full(N, DEPTH)
    rays[1], depth[2], depth[3] = np.nan, -1.0, 0.0
    rays[4] = np.cross([1.0, 0, 0], RAYS[4])  # perpendicular to its plane
    spoilt_ones, sound = circles(rays, depth=depth), circles()
    centre = np.array([0.05, 0, 0])
    np.testing.assert_array_equal(check_prediction(spoilt_ones, centre), [True, *[False] * 4, True])
    for a, b in zip(spoilt_ones.predict(centre), sound.predict(centre), strict=True):
        np.testing.assert_array_equal(a[[0, 5]], b[[0, 5]])


def test_a_ray_that_is_not_finite_tells_nothing() -> None:
    found, centre = circles(), np.array([0.05, 0, 0])
    before = found.predict(centre)
    found.update(np.ones(N, bool), centre, RAYS * np.nan, np.full(N, 1e-4), DEPTH * RAYS)
    found.update(np.ones(N, bool), centre, RAYS, np.full(N, np.nan), DEPTH * RAYS)
    found.update(np.ones(N, bool), centre, RAYS, np.full(N, -1e-4), DEPTH * RAYS)
    for a, b in zip(found.predict(centre), before, strict=True):
        np.testing.assert_array_equal(a, b)


# The contour filter: fixed upright edges, seen by a camera that moves along y.
EDGES = np.stack([np.zeros(N), np.linspace(-0.1, 0.1, N), np.zeros(N)], axis=1)
FRAME = np.tile([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]], (N, 1, 1))  # N_0, T_0 (away from the camera), N_0 x T_0
LOOKING = Rotation.from_matrix(
    np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]]).T
)  # along x, the image's y down


def pose(i: int) -> RigidTransform:
    return RigidTransform.from_components([-DEPTH, 0.05 * (i - 4), 0], LOOKING)


def planes(i: int) -> Array:
    """Normals (N, 3) of the tangent planes in the camera frame."""
    to = EDGES - pose(i).translation
    world = np.stack([-to[:, 1], to[:, 0], 0 * to[:, 0]], axis=1)
    return LOOKING.inv().apply(world / np.linalg.norm(world, axis=1, keepdims=True))


def live(views: int = 6, **given: Array) -> ContourFilter:
    values = {"origin": EDGES, "frame": FRAME, "depth": np.full(N, 0.05)} | given
    out = ContourFilter(values["origin"], values["frame"], values["depth"])
    for i in range(views):
        out.update(pose(i), 1e-3 * np.eye(6), planes(i), np.full(N, 1e-4))
    return out


def check_sections(found: ContourFilter) -> None:
    sections, valid = (it := found.sections(found.fixed)), it.valid
    for name in ("theta", "covariance", "radius", "sigma_radius", "own_variance", "shared"):
        values = getattr(sections, name)
        assert np.all(np.isfinite(values[valid])) and not np.any(np.isnan(values)), name
    assert np.all(sections.sigma_radius > 0) and np.all(np.isposinf(sections.sigma_radius[~valid]))
    for values in (found.pose_covariance, found.T_world_camera.as_matrix()):
        assert np.all(np.isfinite(values))


def test_edges_as_they_are_have_no_radius() -> None:
    found = live(9)
    sections = found.sections(found.fixed)
    assert sections.valid.all() and np.all(np.abs(sections.radius) < 4 * sections.sigma_radius)


def test_contour_filter_survives_anything() -> None:
    def attempt(rng: np.random.Generator) -> None:
        which, when = rng.integers(6), rng.integers(5)

        def given(i: int, value: Array, now: bool = True) -> Array:
            return spoilt(value, rng) if which == i and now else value

        found = live(0, origin=given(0, EDGES), frame=given(1, FRAME), depth=given(2, np.full(N, 0.05)))
        for i in range(5):
            root, normals = given(3, 1e-3 * np.eye(6), i == when), given(4, planes(i), i == when)
            found.update(pose(i), root, normals, given(5, np.full(N, 1e-4), i == when))
        check_sections(found)

    fuzzed(attempt, 80)


def test_before_the_first_view_there_are_no_estimates() -> None:
    found = live(0)
    for ask in (lambda: found.sections(np.zeros(N, bool)), lambda: found.T_world_camera):
        with pytest.raises(DegenerateGeometry, match="no view was taken in yet"):
            ask()


@pytest.mark.parametrize(
    "fixed", [np.zeros(N - 1, bool), np.zeros(N, int), np.zeros((N, 1), bool), np.arange(3)]
)
def test_sections_are_fixed_or_not_each(fixed: np.ndarray) -> None:
    """Whole numbers would be taken for indices."""
    found = live(3)
    with pytest.raises(InvalidInput, match=rf"fixed is .*accepted: bool \({N},\)"):
        found.sections(fixed)
    found.fixed = fixed
    with pytest.raises(InvalidInput, match="fixed is"):
        found.update(pose(3), 1e-3 * np.eye(6), planes(3), np.full(N, 1e-4))
    assert found.count == 3


def test_no_sections_are_no_rows() -> None:
    found = live(0, origin=EDGES[:0], frame=FRAME[:0], depth=np.zeros(0))
    found.update(pose(0), 1e-3 * np.eye(6), np.zeros((0, 3)), np.zeros(0))
    assert len(found.sections(found.fixed).radius) == 0


def test_frames_and_normals_are_of_unit_length() -> None:
    with pytest.raises(InvalidInput, match="frame"):
        live(0, frame=2 * FRAME)
    with pytest.raises(InvalidInput, match="unit normals"):
        live(3).update(pose(3), 1e-3 * np.eye(6), 2 * planes(3), np.full(N, 1e-4))


# Corners.
BOARD = Board()
PIXELS = Camera().project(
    RigidTransform.from_components([0.1, 0.1, -0.5], Rotation.from_rotvec([0.4, 0.1, 0]))
    .inv()
    .apply(BOARD.corners)
)
COUNT = len(PIXELS)
IMAGE = np.kron(np.indices((5, 7)).sum(axis=0) % 2, np.ones((12, 12))) * 200.0  # corners every 12 px


def windows(**given: Any) -> Windows:
    centre = np.array([[23.5, 23.5], [35.5, 23.5], [47.5, 35.5]])
    values: dict[str, Any] = {
        "centre": centre, "first": np.tile(12 * np.eye(2), (3, 1, 1)), "second": np.zeros((3, 2, 2, 2)),
        "dark": np.array([1.0, -1.0, 1.0]), "gap": 0.125, "ring": 0.125, "blur": np.full(2, 0.75),
    }  # fmt: skip
    return Windows(**(values | given))


def check_fit(found: CornerFit) -> None:
    for name in ("pixels", "covariance", "variance", "contrast", "blur"):
        assert np.all(np.isfinite(getattr(found, name)[found.settled])), name


def test_corner_fit_survives_anything() -> None:
    names = ("centre", "first", "second", "dark", "blur", "gap", "ring", "image")

    def attempt(rng: np.random.Generator) -> None:
        name = names[rng.integers(len(names))]
        image = spoilt(IMAGE, rng) if name == "image" else IMAGE
        value = spoilt(getattr(windows(), name), rng) if name != "image" else None
        given = {} if value is None else {name: value if value.ndim else float(value)}
        check_fit(fit_corners(image, windows(**given)))

    fuzzed(attempt, 100)


def test_a_spoilt_window_has_not_settled_and_leaves_the_others_as_they_were() -> None:
    sound = fit_corners(IMAGE, windows())
    for name in ("centre", "first", "second"):
        for value in (np.nan, np.inf, 1e300, -1e9):
            given = getattr(windows(), name).copy()
            given[1] = value
            found = fit_corners(IMAGE, windows(**{name: given}))
            assert not found.settled[1]
            np.testing.assert_array_equal(found.settled[[0, 2]], sound.settled[[0, 2]])
            np.testing.assert_allclose(found.pixels[[0, 2]], sound.pixels[[0, 2]], atol=1e-9)


def corners(
    ids: np.ndarray | None = None, pixels: Array = PIXELS, covariance: Array | None = None
) -> Corners:
    each = np.tile(0.01 * np.eye(2), (COUNT, 1, 1)) if covariance is None else covariance
    return Corners(np.arange(COUNT) if ids is None else ids, pixels, each)


@pytest.mark.parametrize(
    "ids", [-np.arange(COUNT), np.zeros(COUNT, int), 1.5 * np.arange(COUNT), np.arange(COUNT - 1)],
    ids=["negative", "repeated", "broken", "too few"],
)  # fmt: skip
def test_ids_of_corners_are_checked(ids: np.ndarray) -> None:
    with pytest.raises(InvalidInput, match="accepted"):
        corners(ids)


def test_corners_that_the_board_does_not_have_are_told() -> None:
    np.testing.assert_array_equal(corners().on(BOARD), BOARD.corners)
    with pytest.raises(InvalidInput, match=rf"id {COUNT}; accepted: 0 to {COUNT - 1}"):
        corners(np.arange(COUNT) + 1).on(BOARD)


@pytest.mark.parametrize(
    "bad",
    [np.diag([1.0, 0.0]), np.ones((2, 2)), -np.eye(2), np.full((2, 2), np.nan), np.array([[1, 0.5], [0, 1]])],
)
def test_covariances_of_corners_are_positive_definite(bad: Array) -> None:
    covariance = np.tile(0.01 * np.eye(2), (COUNT, 1, 1))
    covariance[3] = bad
    with pytest.raises(InvalidInput, match="positive definite"):
        corners(covariance=covariance)


@pytest.mark.parametrize("shape", [(0, 0), (0, 30), (30, 0, 3)])
def test_an_image_without_pixels_is_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(InvalidInput, match="one or more pixels"):
        find_corners(np.zeros(shape, np.uint8), None, BOARD)
    assert len(find_corners(np.zeros((1, 1), np.uint8), None, BOARD)) == 0
