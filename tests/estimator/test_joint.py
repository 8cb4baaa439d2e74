"""Poses and shape together, from rendered views of a vase and a box whose poses are believed 1 mm and 1 mrad off."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from extremal.estimator import Camera, DegenerateGeometry, InvalidInput, Shape, View, estimate_shape
from extremal.estimator.camera import Array
from extremal.estimator.poses import PosePrior, pose_exp
from extremal.estimator.projection import adjoint
from extremal.estimator.shape import Estimator
from extremal.scenes import Scene, load_scene
from extremal.scripts.scoring import score
from extremal.sim import LinearMotion, Recording, record

CAMERA = Camera(width=320, height=240, fx=400.0, fy=400.0)
VIEWS, SEEDS = 15, range(5)
ERROR = 1e-3  # [m], [rad]
ESTIMATORS: tuple[Estimator, ...] = ("circle", "parallax", "joint")
OF_POINTS = [f.name for f in fields(Shape) if f.name not in ("reference", "T_world_camera")]


@dataclass(frozen=True, eq=False)
class Taken:
    """Views from known poses, and what they show."""

    scene: Scene
    recording: Recording

    @property
    def actual(self) -> RigidTransform:
        return RigidTransform.concatenate(list(self.recording.actual))

    def believed(self, seed: int, error: float = ERROR) -> list[View]:
        """The views with poses that are off in all six directions by random errors [m], [rad], and say so."""
        errors = error * np.random.default_rng(seed).standard_normal((VIEWS, 6))
        poses = self.actual * pose_exp(errors).inv()
        covariance = error**2 * np.eye(6)
        return [
            replace(view, T_world_camera=poses[i], pose_covariance=covariance)
            for i, view in enumerate(self.recording.views)
        ]

    def errors(self, shape: Shape) -> tuple[Array, Array, np.ndarray]:
        """Error of R (k,) [m] and its sigma, and whether the point is extremal, of all points of known truth."""
        scored = score(shape, self.recording, self.scene)
        off = scored.column("radius_m") - scored.column("true_radius_m")
        known = np.isfinite(off)
        extremal = scored.column("true_label") == "extremal"
        return off[known], scored.column("sigma_radius_m")[known], extremal[known]

    def apart(self, poses: RigidTransform) -> float:
        """Root mean square [m], [rad] by which poses are off relative to that of the reference view."""
        middle = VIEWS // 2
        relative, true = poses[middle].inv() * poses, self.actual[middle].inv() * self.actual
        return float(np.sqrt(np.mean((true.inv() * relative).as_exp_coords() ** 2)))


@pytest.fixture(scope="module")
def taken() -> Taken:
    scene = load_scene("vase-and-box")
    motion = LinearMotion(views=VIEWS, baseline=0.4, distance=0.6)
    rng = np.random.default_rng(1)
    return Taken(scene, record(scene, CAMERA, motion, "standard", rng=rng, workers=1))


@pytest.fixture(scope="module")
def shapes(taken: Taken) -> dict[Estimator, list[Shape]]:
    """One shape a seed, by each estimator."""
    return {
        name: [estimate_shape(taken.believed(seed), estimator=name) for seed in SEEDS] for name in ESTIMATORS
    }


@pytest.fixture(scope="module")
def exact(taken: Taken) -> Shape:
    return estimate_shape(taken.recording.views)


def same(shape: Shape, other: Shape) -> None:
    for name in OF_POINTS:
        np.testing.assert_array_equal(getattr(shape, name), getattr(other, name), name)
    np.testing.assert_array_equal(shape.T_world_camera.as_matrix(), other.T_world_camera.as_matrix())


def matched(shape: Shape, other: Shape) -> tuple[np.ndarray, np.ndarray]:
    """Indices of the points that two shapes share."""
    distance = np.linalg.norm(shape.pixels[:, None] - other.pixels, axis=2)
    found = distance.min(axis=1) < 1e-6
    return np.flatnonzero(found), np.argmin(distance, axis=1)[found]


def blank(views: Sequence[View]) -> list[View]:
    return [replace(view, image=np.full_like(view.image, 128)) for view in views]


# Which estimator.


def test_the_default_is_joint_where_poses_are_uncertain(
    taken: Taken, shapes: dict[Estimator, list[Shape]]
) -> None:
    """And the same views give the same shape."""
    same(estimate_shape(taken.believed(0)), shapes["joint"][0])


def test_the_default_is_the_circle_where_they_are_exact(taken: Taken, exact: Shape) -> None:
    same(exact, estimate_shape(taken.recording.views, estimator="circle"))
    np.testing.assert_allclose(exact.T_world_camera.as_matrix(), taken.actual.as_matrix(), atol=1e-12)


def test_an_uncertain_prior_of_exact_views_makes_it_joint(taken: Taken) -> None:
    views = taken.believed(0)
    stripped = [replace(view, pose_covariance=np.zeros((6, 6))) for view in views]
    shape = estimate_shape(stripped, prior=PosePrior.of(views))
    assert taken.apart(shape.T_world_camera) < 0.6 * taken.apart(PosePrior.of(views).T_world_camera)


# How good it is. Medians of |R error| over these seeds: circle 22 mm, parallax 5.8 mm, joint 0.41 mm.


def test_joint_beats_parallax_beats_circles(taken: Taken, shapes: dict[Estimator, list[Shape]]) -> None:
    error = {}
    for name, found in shapes.items():
        every = [taken.errors(shape) for shape in found]
        error[name] = np.median(np.concatenate([np.abs(off[extremal]) for off, _, extremal in every]))
        assert sum(extremal.sum() for _, _, extremal in every) >= 200
    assert error["joint"] < 1e-3
    assert 4 * error["joint"] < error["parallax"] < 0.5 * error["circle"]


def test_sigma_of_the_joint_estimate_is_honest(taken: Taken, shapes: dict[Estimator, list[Shape]]) -> None:
    off, sigma, extremal = (np.concatenate(x) for x in zip(*map(taken.errors, shapes["joint"]), strict=True))
    for kind in (extremal, ~extremal):
        assert np.mean(np.abs(off[kind]) < 1.96 * sigma[kind]) > 0.88
    assert np.median(sigma[extremal]) < 1.5e-3


def test_labels_and_relative_radii_of_the_joint_estimate(
    taken: Taken, shapes: dict[Estimator, list[Shape]]
) -> None:
    for shape in shapes["joint"]:
        _, _, extremal = taken.errors(shape)
        known = np.isfinite(score(shape, taken.recording, taken.scene).column("true_radius_m"))
        assert np.mean(shape.extremal[known] == extremal) > 0.93
        references = np.unique(shape.relative_to)
        assert references[0] >= 0  # every point has one
        assert shape.extremal[references].mean() < 0.15


def test_adjusted_poses_are_nearer_to_each_others_true_places(
    taken: Taken, shapes: dict[Estimator, list[Shape]]
) -> None:
    for seed, shape in zip(SEEDS, shapes["joint"], strict=True):
        believed = PosePrior.of(taken.believed(seed)).T_world_camera
        assert taken.apart(shape.T_world_camera) < 0.6 * taken.apart(believed)
        by_parallax = shapes["parallax"][seed].T_world_camera
        np.testing.assert_array_equal(by_parallax.as_matrix(), believed.as_matrix())


def test_nearly_exact_poses_leave_the_circles(taken: Taken, exact: Shape) -> None:
    shape = estimate_shape(taken.believed(0, 1e-7), estimator="joint")
    here, there = matched(shape, exact)
    assert len(here) > 0.95 * len(shape.pixels) > 100
    for kind in (exact.extremal[there], ~exact.extremal[there]):
        off = np.abs(shape.radius[here] - exact.radius[there])[kind] / exact.sigma_radius[there][kind]
        assert np.median(off) < 0.5
    ratio = shape.sigma_radius[here] / exact.sigma_radius[there]
    assert 0.9 < np.median(ratio) < 1.1


def test_errors_common_to_all_views_add_to_sigma(taken: Taken, shapes: dict[Estimator, list[Shape]]) -> None:
    """Of the radii little, of positions in the world what the hand-eye transform does not tell."""
    views, without = taken.believed(0), shapes["joint"][0]
    common = np.tile(ERROR * np.eye(6), (VIEWS, 1, 1))
    shape = estimate_shape(views, prior=PosePrior.of(views, common))
    here, there = matched(without, shape)
    assert len(here) > 0.95 * len(without.pixels)
    radius = shape.sigma_radius[there] / without.sigma_radius[here]
    # evidence decides on orders and references anew: some radii gain by that
    assert np.median(radius) > 1 and np.mean(radius > 0.99) > 0.7
    spread = [np.trace(s.covariance, axis1=1, axis2=2) for s in (shape, without)]
    assert np.mean(spread[0][there] > spread[1][here]) > 0.9


# What it refuses, and what it does not mind.


def test_a_world_that_is_wrong_as_a_whole_changes_nothing_but_places(taken: Taken) -> None:
    """All cameras believed 20 mm and 20 mrad off together, and known to be: R as without; positions are said to be uncertain."""
    views = taken.believed(0)
    rng = np.random.default_rng(5)
    world = 0.02 * rng.standard_normal(6)
    believed = RigidTransform.concatenate([pose_exp(world) * view.T_world_camera for view in views])
    moved = [replace(view, T_world_camera=believed[i]) for i, view in enumerate(views)]
    prior = PosePrior.of(moved, common=0.02 * adjoint(believed.inv()))
    plain, found = (estimate_shape(v, estimator="joint", prior=p) for v, p in ((views, None), (moved, prior)))
    errors = []
    for shape in (plain, found):
        off, sigma, extremal = taken.errors(shape)
        errors.append(np.median(np.abs(off[extremal])))
        assert np.mean(np.abs(off[extremal]) < 1.96 * sigma[extremal]) > 0.85
    assert errors[1] < 1.2 * errors[0]
    spread = np.sqrt(np.trace(found.covariance, axis1=1, axis2=2))
    assert np.median(spread[np.isfinite(spread)]) > 0.02


@pytest.mark.parametrize("name", ["circles", "", "JOINT"])
def test_an_unknown_estimator(taken: Taken, name: str) -> None:
    with pytest.raises(
        InvalidInput, match=f"estimator is '{name}'; accepted: circle, parallax, joint"
    ) as error:
        estimate_shape(taken.believed(0), estimator=name)  # pyright: ignore[reportArgumentType]
    assert len(str(error.value).splitlines()) == 1


def test_a_prior_of_another_number_of_views(taken: Taken) -> None:
    views = taken.believed(0)
    with pytest.raises(InvalidInput, match=f"the prior has {VIEWS - 1} poses; accepted: {VIEWS}"):
        estimate_shape(views, prior=PosePrior.of(views[1:]))


@pytest.mark.parametrize("name", ESTIMATORS)
def test_motions_that_determine_nothing(taken: Taken, name: Estimator) -> None:
    views = taken.believed(0)
    with pytest.raises(DegenerateGeometry, match="accepted: a baseline"):
        estimate_shape([views[3]] * 5, estimator=name)
    turned = RigidTransform.from_components(views[0].centre, taken.actual.rotation)
    with pytest.raises(DegenerateGeometry, match="accepted: a baseline"):
        estimate_shape(
            [replace(view, T_world_camera=turned[i]) for i, view in enumerate(views)], estimator=name
        )


def test_a_path_that_is_no_longer_than_it_is_uncertain(taken: Taken) -> None:
    """Also one that would be long enough, were it known better."""
    short = [view.centre - taken.actual.translation[0] for view in taken.recording.views]
    path = RigidTransform.from_components(
        taken.actual.translation[0] + 0.015 * np.array(short), taken.actual.rotation
    )
    uncertain = [replace(view, T_world_camera=path[i]) for i, view in enumerate(taken.believed(0))]
    with pytest.raises(DegenerateGeometry, match=r"0.006 m, no more than their uncertainty.*at least 0.01 m"):
        estimate_shape(blank(uncertain))
    known = [replace(view, T_world_camera=path[i]) for i, view in enumerate(taken.recording.views)]
    assert len(estimate_shape(blank(known)).pixels) == 0


@pytest.mark.parametrize("name", ESTIMATORS)
def test_blank_images_have_no_points(taken: Taken, name: Estimator) -> None:
    shape = estimate_shape(blank(taken.believed(0)), estimator=name)
    for field in OF_POINTS:
        assert len(getattr(shape, field)) == 0, field
    assert shape.pixels.shape == (0, 2) and shape.covariance.shape == (0, 3, 3)
    believed = PosePrior.of(taken.believed(0)).T_world_camera
    np.testing.assert_array_equal(shape.T_world_camera.as_matrix(), believed.as_matrix())


@pytest.mark.parametrize("seen", [[7], [6, 7], [6, 7, 8], [0, 7, 14]])
def test_some_blank_images(taken: Taken, seen: list[int]) -> None:
    """Points need the reference view and two more. What little there is, is given with finite sigma or not at all."""
    given = [view if i in seen else blank([view])[0] for i, view in enumerate(taken.believed(0))]
    shape = estimate_shape(given, estimator="joint")
    assert len(seen) >= 3 or len(shape.pixels) == 0
    assert np.all(np.isfinite(shape.radius)) and np.all(np.isfinite(shape.sigma_radius))
    assert np.all(shape.views == 3)
    off, sigma, _ = taken.errors(shape)
    assert np.sum(np.abs(off) < 1.96 * sigma) >= 0.85 * len(off)
