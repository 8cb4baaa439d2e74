"""What no solver can solve: an error of a type of its own instead of a traceback, and nothing that is not a number.

Each case is one number of a sound problem that is out of place: not finite, or so large or small that squares overflow or
sums lose it.
"""

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from extremal.estimator import Camera, DegenerateGeometry, ExtremalError, InvalidInput, View, estimate_shape
from extremal.estimator.adjustment import adjust
from extremal.estimator.board import Board
from extremal.estimator.board_pose import board_pose
from extremal.estimator.camera import Array
from extremal.estimator.contour_filter import START, ContourFilter
from extremal.estimator.corners import Corners
from extremal.estimator.egomotion import combined
from extremal.estimator.hand_eye import hand_eye
from extremal.estimator.poses import PosePrior, square_root
from extremal.estimator.references import References, bootstrap
from extremal.estimator.strip_arcs import fit_arcs
from extremal.estimator.support import Sections
from extremal.sim import fixating

VIEWS, N = 9, 6
RADIUS, DISTANCE, EDGE = 0.04, 0.6, 1e-4
CENTRES = np.linspace(-0.2, 0.2, VIEWS)[:, None] * np.array([0.0, 1.0, 0.0])
POSES = fixating(CENTRES - [DISTANCE, 0, 0], np.zeros(3))


def changed(values: Array, value: float, at: int = 2) -> Array:
    out = np.array(values, float)
    out[at] = value
    return out


# Contours of upright cylinders of radius RADIUS.


def cylinders(poses: RigidTransform = POSES) -> Sections:
    """N cylinders that stand beside each other, as all views show them."""
    middles = np.linspace(-0.1, 0.1, N)[:, None] * np.array([0.0, 1.0, 0.0])
    to = middles[:, None] - poses.translation
    distance = np.hypot(to[..., 0], to[..., 1])
    angle = np.arctan2(to[..., 1], to[..., 0]) + np.arccos(-RADIUS / distance)
    world = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)
    normals = np.einsum("nvk,vkj->nvj", world, poses.rotation.as_matrix())
    first = world[:, 0]
    frame = np.stack([first, np.cross([0, 0, 1.0], first), np.tile([0, 0, 1.0], (N, 1))], axis=1)
    if np.any(np.sum(frame[:, 1] * to[:, 0], axis=1) < 0):
        frame[:, 1:] *= -1
    origin = middles + RADIUS * first
    return Sections(normals[:, None], np.full((N, 1, VIEWS), EDGE), origin, frame, np.full(N, 3))


def prior(sigma: float = 1e-3) -> PosePrior:
    return PosePrior(POSES, np.tile(sigma * np.eye(6), (VIEWS, 1, 1)))


def adjusted(sections: Sections, poses: PosePrior | None = None, start: Array | None = None) -> object:
    return adjust(poses or prior(), [sections], start=start)


def filtered(
    views: int = START + 3, pose: float = 1e-3, depth: float = 0.05, **values: Array
) -> ContourFilter:
    s = replace(cylinders(), **values)
    out = ContourFilter(s.origin, s.frame, np.full(N, depth))
    for i in np.arange(views) % VIEWS:
        out.update(POSES[i], pose * np.eye(6), s.normals[:, 0, i], s.sigma[:, 0, i])
    return out


# References, arcs, boards, poses.

RNG = np.random.default_rng(0)
RADII = {
    "radius": RNG.normal(0, 1e-3, 8),
    "own_variance": np.full(8, 1e-6),
    "shared": RNG.normal(0, 1e-3, (8, 4)),
}


def referenced(prior: float = 0.5, overlap: float = 1.0, **values: Array) -> References:
    given = RADII | values
    return bootstrap(
        given["radius"], given["own_variance"], given["shared"], np.arange(8), prior=prior, overlap=overlap
    )


def arcs(centres: Array | None = None, sigma: float = EDGE, shared: float = 0.0) -> object:
    s = cylinders()
    world = np.einsum("nvj,vkj->nvk", s.normals[:, 0], POSES.rotation.as_matrix())
    there: Array = POSES.translation if centres is None else centres
    return fit_arcs(
        s.origin,
        s.frame,
        world,
        there,
        np.full((N, VIEWS), sigma),
        np.full((N, VIEWS, 1), shared),
        np.zeros(N),
    )


BOARD, CAMERA = Board(), Camera()
T_BOARD_CAMERA = RigidTransform.from_components([0.1, 0.1, -0.5], Rotation.from_rotvec([0.4, 0.1, 0]))
PIXELS = CAMERA.project(T_BOARD_CAMERA.inv().apply(BOARD.corners))


def board(variance: float) -> object:
    covariance = np.tile(4e-4 * np.eye(2), (len(PIXELS), 1, 1))
    covariance[2] = np.diag([variance, variance])
    return board_pose(CAMERA, BOARD, Corners(np.arange(len(PIXELS)), PIXELS, covariance))


TURNED = RigidTransform.from_components(
    RNG.normal(size=(6, 3)), Rotation.from_rotvec(RNG.normal(size=(6, 3)))
)

CASES: dict[str, tuple[Callable[[], object], type[ExtremalError]]] = {
    "adjust: planes beyond squares": (
        lambda: adjusted(replace(cylinders(), sigma=np.full((N, 1, VIEWS), 1e-160))), DegenerateGeometry,
    ),
    "adjust: a plane without error": (
        lambda: adjusted(replace(cylinders(), sigma=changed(np.full((N, 1, VIEWS), EDGE), 1e-12))), DegenerateGeometry,
    ),
    "adjust: poses of no scale": (lambda: adjusted(cylinders(), prior(1e100)), DegenerateGeometry),
    "adjust: normals of no length": (
        lambda: adjusted(replace(cylinders(), normals=changed(cylinders().normals, 0.0))), InvalidInput,
    ),
    "adjust: a start that is not a number": (
        lambda: adjusted(cylinders(), start=np.full(6 * VIEWS, np.nan)), InvalidInput,
    ),
    "adjust: a start far away": (lambda: adjusted(cylinders(), start=np.full(6 * VIEWS, 1e200)), InvalidInput),
    "adjust: a start of another shape": (lambda: adjusted(cylinders(), start=np.zeros(3)), InvalidInput),
    "filter: nothing seen": (lambda: filtered(sigma=np.full((N, 1, VIEWS), np.inf)), DegenerateGeometry),
    "filter: planes beyond double precision": (lambda: filtered(sigma=np.full((N, 1, VIEWS), 1e-13)), InvalidInput),
    "filter: poses of no scale": (lambda: filtered(pose=1e100), DegenerateGeometry),
    "filter: depths beyond squares": (lambda: filtered(depth=1e200), DegenerateGeometry),
    "filter: sections at the camera": (
        lambda: filtered(origin=np.tile(POSES.translation[0], (N, 1))), DegenerateGeometry,
    ),
    "filter: sections far away": (lambda: filtered(origin=cylinders().origin + 1e100), DegenerateGeometry),
    "references: a radius that is not a number": (
        lambda: referenced(radius=changed(RADII["radius"], np.nan)), InvalidInput,
    ),
    "references: a radius beyond squares": (lambda: referenced(radius=changed(RADII["radius"], 1e200)), InvalidInput),
    "references: a negative variance": (
        lambda: referenced(own_variance=changed(RADII["own_variance"], -1.0)), InvalidInput,
    ),
    "references: no variance": (lambda: referenced(own_variance=np.zeros(8)), InvalidInput),
    "references: shared errors that are not numbers": (
        lambda: referenced(shared=changed(RADII["shared"], np.nan)), InvalidInput,
    ),
    "references: shared errors beyond squares": (
        lambda: referenced(shared=changed(RADII["shared"], 1e160)), InvalidInput,
    ),
    "references: no prior": (lambda: referenced(prior=np.nan), InvalidInput),
    "references: no overlap": (lambda: referenced(overlap=np.nan), InvalidInput),
    "references: endless overlap": (lambda: referenced(overlap=np.inf), InvalidInput),
    "arcs: a camera at a contact point": (
        lambda: arcs(np.concatenate([cylinders().origin[:1], POSES.translation[1:]])), DegenerateGeometry,
    ),
    "arcs: planes beyond squares": (lambda: arcs(sigma=1e-160), DegenerateGeometry),
    "arcs: shared errors beyond squares": (lambda: arcs(shared=1e200), DegenerateGeometry),
    "board: corners without error": (lambda: board(0.0), InvalidInput),
    "board: a negative variance": (lambda: board(-1.0), InvalidInput),
    "board: a variance that is not a number": (lambda: board(np.nan), InvalidInput),
    "board: corners beyond double precision": (lambda: board(1e-300), InvalidInput),
    "hand-eye: the board moves along": (lambda: hand_eye(TURNED, TURNED[[0] * 6]), DegenerateGeometry),
    "a covariance that is not a number": (lambda: square_root(np.full((1, 6, 6), np.nan)), InvalidInput),
    "poses whose covariances overflow": (
        lambda: combined(prior(1e160), prior(1e160), np.ones(VIEWS, bool)), InvalidInput,
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # numbers that overflow
def test_what_cannot_be_solved_has_an_error_of_its_own(case: str) -> None:
    call, kind = CASES[case]
    with pytest.raises(kind) as caught:
        call()
    assert len(str(caught.value).splitlines()) == 1


def test_the_same_problems_undisturbed_are_solved() -> None:
    """Otherwise the table would say nothing."""
    found = adjust(prior(), [cylinders()]).shapes[0]
    assert found.valid.all() and found.radius == pytest.approx(RADIUS, abs=5e-4)
    live = filtered()
    assert live.sections(live.fixed).valid.any()
    assert np.all(np.isfinite(referenced().sigma_radius))
    arcs()
    board(4e-4)
    mounting = RigidTransform.from_components([0.1, 0.2, 0.3], Rotation.from_rotvec([0.1, 0.2, 0.3]))
    seen = (TURNED * mounting).inv() * T_BOARD_CAMERA
    np.testing.assert_allclose(hand_eye(TURNED, seen)[0].as_matrix(), mounting.as_matrix(), atol=1e-9)
    combined(prior(), prior(), np.ones(VIEWS, bool))


def test_features_that_no_view_sees_are_rows_that_say_so() -> None:
    found = adjust(prior(), [replace(cylinders(), sigma=np.full((N, 1, VIEWS), np.inf))]).shapes[0]
    assert not found.valid.any() and np.all(np.isposinf(found.sigma_radius))
    assert np.all(np.isfinite(found.radius)) and np.all(np.isfinite(found.theta))


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_view_that_can_not_be_taken_in_changes_nothing() -> None:
    """Also where the filter has begun when it fails."""
    s, live = cylinders(), filtered(START)
    before = live.sections(live.fixed)
    with pytest.raises(DegenerateGeometry):
        live.update(POSES[0], 1e160 * np.eye(6), s.normals[:, 0, 0], np.full(N, EDGE))
    after = live.sections(live.fixed)
    assert live.count == START
    for name in ("theta", "covariance", "radius", "sigma_radius"):
        np.testing.assert_array_equal(getattr(after, name), getattr(before, name))
    live.update(POSES[0], 1e-3 * np.eye(6), s.normals[:, 0, 0], np.full(N, EDGE))
    assert live.count == START + 1


def test_joint_estimate_of_exact_poses() -> None:
    """Poses without any uncertainty leave no unknown to the cameras."""
    camera = Camera(120, 90, fx=120.0, fy=120.0)
    views = []
    for i in range(5):
        image = np.full((90, 120), 30, np.uint8)
        cv2.circle(image, (58 + i, 45), 20, 200, -1)
        blurred = np.asarray(cv2.GaussianBlur(image, (0, 0), 0.8), np.uint8)
        views.append(View(camera, POSES[2 + i], blurred))
    found = estimate_shape(views, estimator="joint")
    assert np.all(np.isfinite(found.radius))
