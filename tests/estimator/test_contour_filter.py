"""The contour filter against the joint adjustment of all views at once, the truth, and itself in another order."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from extremal.estimator import InvalidInput
from extremal.estimator.adjustment import Shapes, adjust
from extremal.estimator.arrowhead import inverse_of
from extremal.estimator.camera import Array
from extremal.estimator.contour_filter import START, WINDOW, ContourFilter, SectionEstimates
from extremal.estimator.poses import PosePrior
from extremal.estimator.support import FIXED, Sections
from extremal.scripts.spatial_study import random_scene
from extremal.scripts.synthetic import TangentScene, observe

EDGE = 0.1 / 800  # [rad]
ROUGH = 0.04  # of the distance: sigma of depth at the start


@dataclass(frozen=True, eq=False)
class Case:
    """Sections as V views show them, poses as they are believed, which sections are fixed, and the truth."""

    prior: PosePrior
    sections: Sections
    fixed: np.ndarray
    scene: TangentScene

    def filtered(
        self, order: list[int] | None = None, believed: bool = True, rough: float = ROUGH
    ) -> ContourFilter:
        s, poses = self.sections, self.prior.T_world_camera
        distance = np.linalg.norm(s.origin - poses.translation[0], axis=1)
        out = ContourFilter(s.origin, s.frame, rough * distance)
        if believed:
            out.fixed = self.fixed
        for i in range(len(poses)) if order is None else order:
            out.update(poses[i], self.prior.root[i], s.normals[:, 0, i], s.sigma[:, 0, i])
        return out

    def batch(self, fixed: bool = True) -> Shapes:
        held = self.fixed if fixed else np.zeros(len(self.fixed), bool)
        return adjust(self.prior, [replace(self.sections, order=np.where(held, 2, 3))]).shapes[0]


def case(
    n: int = 200,
    views: int = 30,
    pose: float = 1e-3,
    edge: float = EDGE,
    unseen: float = 0.0,
    seed: int = 0,
) -> Case:
    """Irregular steps over 0.8 m at 1 m; `pose` [m], [rad]; each plane is unseen with a probability."""
    rng = np.random.default_rng(seed)
    scene = random_scene(views, n, 0, rng)
    root = np.tile(pose * np.eye(6), (views, 1, 1)) if pose else np.zeros((views, 6, 0))
    seen = observe(scene, PosePrior(scene.T_world_camera, root), edge, rng, fixed_known=True)
    sections = seen.features[0]
    assert isinstance(sections, Sections)
    fixed = sections.order == FIXED
    sigma = np.where(rng.uniform(size=sections.sigma.shape) < unseen, np.inf, sections.sigma)
    return Case(seen.prior, replace(sections, sigma=sigma, order=np.full(n, 3)), fixed, scene)


def differences(found: SectionEstimates, batch: Shapes) -> tuple[Array, Array]:
    """|R - R_batch| / sigma_batch, and |sigma / sigma_batch - 1|, where both are valid."""
    both = found.valid & batch.valid
    assert np.mean(found.valid == batch.valid) > 0.98
    sigma = batch.sigma_radius[both]
    off = np.abs(found.radius - batch.radius)[both] / sigma
    return off, np.abs(found.sigma_radius[both] / sigma - 1)


CASES = {
    "30 views": {},
    "60 views": {"views": 60, "seed": 1},
    "15 views": {"views": 15, "seed": 2},
    "exact poses": {"pose": 0.0, "seed": 4},
    "good poses": {"pose": 3e-5, "seed": 5},
    "poor poses": {"pose": 2e-3, "seed": 6},
    "few sections": {"n": 26, "seed": 7},
    "dropouts": {"unseen": 0.25, "seed": 8},
    "fine edges": {"edge": 0.02 / 800, "seed": 9},
}


@pytest.mark.parametrize("name", CASES)
def test_equal_to_the_batch(name: str) -> None:
    """With known references. Far planes lose weight at the end of the batch, here as they leave the window: a few radii
    differ by more than the rest."""
    problem = case(**CASES[name])
    off, ratio = differences(problem.filtered().sections(problem.fixed), problem.batch())
    assert np.sqrt(np.mean(off**2)) < 0.1
    assert np.quantile(off, 0.9) < 0.15
    assert np.quantile(ratio, 0.98) < 0.1


@pytest.mark.parametrize("name", ["30 views", "exact poses", "few sections", "60 views"])
def test_absolute_radii_near_the_batch(name: str) -> None:
    """Nothing fixed: what is known least, a change of all radii together, is where linearising once shows."""
    problem = case(**CASES[name])
    none = np.zeros(len(problem.fixed), bool)
    off, ratio = differences(problem.filtered().sections(none), problem.batch(False))
    assert np.sqrt(np.mean(off**2)) < 0.5
    assert np.quantile(ratio, 0.98) < 0.1


def test_estimates_do_not_contain_the_depths_to_start_from() -> None:
    """A hundred depths, each known to a few per cent, would fix the mean of all: with poor poses it is the least known of all."""
    problem = case(n=100, views=20, seed=3)
    none = np.zeros(100, bool)
    usual, sure = (problem.filtered(rough=rough).sections(none) for rough in (ROUGH, ROUGH / 4))
    assert np.abs((sure.radius - usual.radius) / usual.sigma_radius).max() < 0.1
    np.testing.assert_allclose(sure.covariance[:, 1, 1], usual.covariance[:, 1, 1], rtol=0.05)


def test_covariances_of_all_parameters_and_of_pairs() -> None:
    problem = case()
    found, batch = problem.filtered().sections(problem.fixed), problem.batch()
    free = ~problem.fixed & found.valid & batch.valid
    for k in range(3):
        ratio = found.covariance[free, k, k] / batch.covariance[free, k, k]
        assert np.quantile(np.abs(ratio - 1), 0.95) < 0.1
    np.testing.assert_allclose(
        found.own_variance[free] + np.sum(found.shared[free] ** 2, axis=1), found.sigma_radius[free] ** 2
    )
    of_pairs = found.shared[free] @ found.shared[free].T - batch.shared[free] @ batch.shared[free].T
    sigma = batch.sigma_radius[free]
    assert np.quantile(np.abs(of_pairs) / np.outer(sigma, sigma), 0.99) < 0.05


def test_order_of_the_views_hardly_matters() -> None:
    problem = case(n=100, views=24, seed=10)
    rng = np.random.default_rng(0)
    forward = problem.filtered().sections(problem.fixed)
    for order in (list(range(24))[::-1], rng.permutation(24).tolist()):
        other = problem.filtered(order).sections(problem.fixed)
        both = forward.valid & other.valid
        assert both.mean() > 0.95
        off = np.abs(other.radius - forward.radius)[both] / forward.sigma_radius[both]
        assert np.sqrt(np.mean(off**2)) < 0.15
        assert np.quantile(np.abs(other.sigma_radius / forward.sigma_radius - 1)[both], 0.95) < 0.1


def test_radii_and_live_poses_are_as_uncertain_as_stated() -> None:
    trials, views = 30, 20
    of_radii, of_fixed, of_poses, inside = [], [], [], []
    for seed in range(trials):
        problem = case(n=60, views=views, seed=100 + seed)
        track = problem.filtered()
        found = track.sections(problem.fixed)
        z = (found.radius - problem.scene.section_radii(problem.sections)) / found.sigma_radius
        free = found.valid & ~problem.fixed
        of_radii.append(np.mean(z[free] ** 2))
        inside.append(np.mean(np.abs(z[free]) < 1.96))
        of_fixed.append(np.mean(z[found.valid & problem.fixed] ** 2))
        missed = (track.T_world_camera.inv() * problem.scene.T_world_camera[views - 1]).as_exp_coords()
        missed = np.concatenate([missed[3:], missed[:3]])
        of_poses.append(missed @ np.linalg.solve(track.pose_covariance, missed) / 6)
    # radii of a trial share the cameras' errors: the trials' own scatter tells how well their mean is known
    for squares in (of_radii, of_fixed, of_poses):
        assert np.mean(squares) == pytest.approx(1, abs=4 * np.std(squares) / np.sqrt(trials) + 0.02)
    assert np.mean(inside) == pytest.approx(0.95, abs=4 * np.std(inside) / np.sqrt(trials) + 0.01)


def test_the_state_does_not_grow() -> None:
    problem = case(n=40, views=60, seed=11)
    sizes = []
    track = problem.filtered(order=[])
    poses, s = problem.prior.T_world_camera, problem.sections
    for i in range(60):
        track.update(poses[i], problem.prior.root[i], s.normals[:, 0, i], s.sigma[:, 0, i])
        sizes.append((track._known.border.size, len(track._window)))
    assert len(set(sizes[30:])) == 1
    assert max(window for _, window in sizes) <= START + 1 and sizes[-1][1] == WINDOW


def test_same_views_same_estimates() -> None:
    problem = case(n=30, views=16, seed=12)
    one, two = (problem.filtered().sections(problem.fixed) for _ in range(2))
    np.testing.assert_array_equal(one.radius, two.radius)
    np.testing.assert_array_equal(one.covariance, two.covariance)


@pytest.mark.parametrize("pose", [0.0, 1e-3])
def test_a_camera_that_stays_tells_no_shape(pose: float) -> None:
    problem = case(n=30, views=20, pose=pose, seed=13)
    still = problem.filtered(order=[])
    rng = np.random.default_rng(0)
    s = problem.sections
    for _ in range(20):
        normals = s.normals[:, 0, 3] + EDGE * rng.standard_normal((30, 3))
        still.update(problem.prior.T_world_camera[3], problem.prior.root[3], normals, s.sigma[:, 0, 3])
    found = still.sections(problem.fixed)
    assert not found.valid.any()
    assert np.all(np.isinf(found.sigma_radius)) and np.all(np.isinf(found.covariance))
    assert np.all(np.isfinite(found.radius)) and np.all(np.isfinite(still.pose_covariance))


def test_sections_that_are_seen_too_rarely_are_invalid_and_harm_no_other() -> None:
    problem = case(n=80, views=20, seed=14)
    sigma = problem.sections.sigma.copy()
    sigma[:10, :, 2:] = np.inf
    sigma[10:20] = np.inf
    rare = replace(problem, sections=replace(problem.sections, sigma=sigma))
    found, whole = (p.filtered().sections(p.fixed) for p in (rare, problem))
    assert not found.valid[:20].any() and found.valid[20:].mean() > 0.95
    both = found.valid & whole.valid
    assert np.all(np.abs(found.radius - whole.radius)[both] < 2 * found.sigma_radius[both])


def test_bad_input_changes_nothing() -> None:
    problem = case(n=12, views=8, seed=15)
    track = problem.filtered(list(range(6)))
    before = track.sections(problem.fixed)
    s, pose, root = problem.sections, problem.prior.T_world_camera[6], problem.prior.root[6]
    normals, sigma = s.normals[:, 0, 6], s.sigma[:, 0, 6]
    broken = RigidTransform.from_translation([np.nan, 0.0, 0.0])
    for arguments, message in (
        ((broken, root, normals, sigma), "T_world_camera.*not finite"),
        ((pose, root * np.nan, normals, sigma), "root.*not finite"),
        ((pose, root[:, :3], normals, sigma), r"accepted.*\(6, 6\)"),
        ((pose, root, normals[:5], sigma), r"accepted.*\(12, 3\)"),
        ((pose, root, normals * np.inf, sigma), "normals.*not finite"),
        ((pose, root, normals, 0 * sigma), "sigma.*positive"),
        ((pose, root, normals, sigma * np.nan), "sigma.*positive"),
    ):
        with pytest.raises(InvalidInput, match=message):
            track.update(*arguments)
    np.testing.assert_array_equal(track.sections(problem.fixed).radius, before.radius)
    assert track.count == 6
    with pytest.raises(InvalidInput, match="sigma_depth"):
        ContourFilter(s.origin, s.frame, np.zeros(12))
    with pytest.raises(InvalidInput, match="finite numbers of shapes"):
        ContourFilter(s.origin * np.nan, s.frame, np.ones(12))


def test_inverses_of_blocks() -> None:
    rng = np.random.default_rng(3)
    root = rng.normal(size=(50, 3, 3)) * [1e2, 1e1, 1.0]
    blocks = np.swapaxes(root, 1, 2) @ root
    np.testing.assert_allclose(inverse_of(blocks) @ blocks, np.tile(np.eye(3), (50, 1, 1)), atol=1e-6)
