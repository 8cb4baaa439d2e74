"""The arm's error model: what is common and what is independent, priors against Monte Carlo, the presets' sizes."""

from dataclasses import fields, replace

import numpy as np
import pytest
from jacobian import assert_jacobian
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from extremal.estimator import InvalidInput
from extremal.estimator.poses import PosePrior, pose_exp
from extremal.sim import ARMS, NOMINAL, ArmErrors, ArmKinematics, LinearMotion, get_arm
from extremal.sim.arm_errors import FlangeKinematics
from extremal.sim.kinematics import HOME

T_WORLD_BASE = RigidTransform.from_components([0.1, 0.2, 0.3], Rotation.from_rotvec([0.3, -0.2, 0.5]))
PRESETS = {"calibrated": (1e-4, 1e-4), "typical": (1e-3, 1e-3), "poor": (3e-3, 5e-3)}
INDEPENDENT = {"calibrated": (2e-5, 2e-5), "typical": (4e-5, 5e-5), "poor": (1e-4, 1.5e-4)}
SYSTEMATIC = ("joint_offset", "link_length", "hand_eye_position", "hand_eye_rotation")

Floats = NDArray[np.floating]


def look_readings(motion: LinearMotion) -> Floats:
    target = np.array([0.0, 0.0, 0.1])
    poses = motion.poses(target, np.random.default_rng(0))
    return ArmKinematics.behind(motion.centre(target)).joint_positions(poses)


def near_home(views: int, seed: int = 5) -> Floats:
    return HOME + np.random.default_rng(seed).uniform(-0.5, 0.5, (views, 6))


def believe(model: ArmErrors, q: Floats, seed: int) -> tuple[Floats, PosePrior]:
    """An arm that went to q, and the prior: pose errors e (V, 6) with T_actual = T_believed exp(e)."""
    rng = np.random.default_rng(seed)
    arm = model.draw(rng)
    noise, off = model.scatter(len(q), rng)
    prior = model.prior(NOMINAL, q + noise, T_WORLD_BASE)
    actual = T_WORLD_BASE * arm.camera_poses(q) * pose_exp(off)
    return np.roll((prior.T_world_camera.inv() * actual).as_exp_coords(), 3, axis=-1), prior


def whole_covariance(prior: PosePrior) -> Floats:
    """(6 V, 6 V) of the errors of all views together."""
    views = len(prior.root)
    common = prior.common.reshape(6 * views, -1)
    covariance = common @ common.T
    for i, own in enumerate(prior.root @ np.swapaxes(prior.root, 1, 2)):
        covariance[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] += own
    return covariance


def test_no_errors_no_difference() -> None:
    error, prior = believe(ArmErrors(), near_home(4), 0)
    assert np.abs(error).max() < 1e-12
    assert prior.exact and prior.common.shape == (4, 6, 0) and prior.root.shape == (4, 6, 0)
    assert ARMS["ideal"] == ArmErrors()


def test_errors_of_each_view_have_the_stated_covariance() -> None:
    count = 4000
    error, prior = believe(ArmErrors(position=1e-3, rotation=2e-3), np.tile(HOME, (count, 1)), 1)
    covariance = error.T @ error / count
    expected = np.diag([1e-6] * 3 + [4e-6] * 3)
    np.testing.assert_allclose(prior.root[7] @ prior.root[7].T, expected, atol=1e-18)
    assert prior.common.shape == (count, 6, 0)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    # The sd of an estimated variance is sqrt(2 / n) of it, of a correlation 1 / sqrt(n).
    assert np.abs((covariance - expected) / scale).max() < 4.5 * np.sqrt(2 / count)


def test_encoder_noise_goes_through_the_arm() -> None:
    count = 4000
    error, prior = believe(ArmErrors(encoder_noise=1e-4), np.tile(HOME, (count, 1)), 2)
    covariance = error.T @ error / count
    jacobian = NOMINAL.camera_derivatives(HOME[None])[0, :, :6]
    expected = 1e-8 * jacobian @ jacobian.T
    np.testing.assert_allclose(prior.root[3] @ prior.root[3].T, expected, atol=1e-3 * expected.max())
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert np.abs((covariance - expected) / scale).max() < 5 * np.sqrt(2 / count)


def test_a_wrong_mounting_is_common_to_all_views() -> None:
    model = ArmErrors(hand_eye_position=1e-3, hand_eye_rotation=2e-3)
    found = [believe(model, near_home(5), seed) for seed in range(300)]
    errors = np.array([error for error, _ in found])
    np.testing.assert_allclose(errors, np.repeat(errors[:, :1], 5, axis=1), atol=1e-12)
    np.testing.assert_allclose(errors[:, 0].std(axis=0), model.hand_eye, rtol=4 / np.sqrt(2 * 300))
    np.testing.assert_array_equal(found[0][1].common, np.tile(np.diag(model.hand_eye), (5, 1, 1)))


@pytest.mark.parametrize("name", ["joint_offset", "link_length"])
def test_the_prior_knows_what_all_views_share(name: str) -> None:
    """Errors of the chain are few common numbers, of unit variance, times the prior's columns."""
    trials, q = 300, near_home(7)
    found = [believe(ArmErrors(**{name: 1e-4}), q, seed) for seed in range(trials)]
    columns = found[0][1].common.reshape(42, -1)
    errors = np.array([error.ravel() for error, _ in found])
    numbers = np.linalg.lstsq(columns, errors.T, rcond=None)[0]
    assert np.abs(columns @ numbers - errors.T).max() < 1e-6  # what is of second order
    spread = np.mean(errors**2, axis=0) / np.sum(columns**2, axis=1).clip(1e-20)
    moving = np.sum(columns**2, axis=1) > 1e-14  # a length does not turn anything
    assert np.abs(spread[moving] - 1).max() < 5 * np.sqrt(2 / trials)


@pytest.mark.parametrize("name", PRESETS)
@pytest.mark.parametrize("motion", [LinearMotion(), LinearMotion(3, 0.1, 0.5)], ids=["15 views", "3 views"])
def test_presets(name: str, motion: LinearMotion) -> None:
    """Their sizes over many arms, and that priors of all views together describe their errors, second order included."""
    q, arms = look_readings(motion), 400
    found = [believe(ARMS[name], q, seed) for seed in range(arms)]
    errors = np.array([error for error, _ in found])
    sizes = [np.sqrt(np.mean(errors[..., axes] ** 2)) for axes in (slice(0, 3), slice(3, 6))]
    np.testing.assert_allclose(sizes, PRESETS[name], rtol=0.12)

    own = ARMS[name]
    for systematic in SYSTEMATIC:
        own = replace(own, **{systematic: 0.0})
    own_prior = own.prior(NOMINAL, q, T_WORLD_BASE)
    sizes = np.sqrt(np.diagonal(own_prior.covariance, axis1=1, axis2=2).reshape(-1, 2, 3).mean(axis=(0, 2)))
    np.testing.assert_allclose(sizes, INDEPENDENT[name], rtol=0.15)

    nees = []
    for error, prior in found:
        covariance = whole_covariance(prior)
        scale = np.sqrt(np.diag(covariance))
        whitened = error.ravel() / scale
        nees.append(whitened @ np.linalg.solve(covariance / np.outer(scale, scale), whitened))
    assert abs(np.mean(nees) / errors[0].size - 1) < 4 * np.sqrt(2 / errors.size)


def test_an_individual_depends_on_its_generator_alone() -> None:
    small, large = (
        ArmErrors(joint_offset=s, link_length=s).draw(np.random.default_rng(7)) for s in (1e-6, 1e-3)
    )
    np.testing.assert_allclose(large.parameters, 1e3 * small.parameters)
    moved = ArmErrors(joint_offset=1e-6, link_length=1e-6).draw(np.random.default_rng(7), large)
    np.testing.assert_allclose(moved.parameters, 1.001 * large.parameters)


def test_flange_model() -> None:
    """At any c the exact arm and its derivatives there; what is independent as in the camera's prior."""
    q, model = near_home(4), ARMS["poor"]
    believed = model.draw(np.random.default_rng(9))
    flange = model.flange_model(believed, q)
    assert isinstance(flange, FlangeKinematics)
    assert len(flange.names) == 15 and flange.names[0] == "joint_offset_1"
    np.testing.assert_array_equal(flange.scales, [2e-3] * 5 + [1e-3] * 10)
    c = np.random.default_rng(3).standard_normal(15)
    arm, expected = flange.geometry(c), np.zeros(18)
    expected[flange.uncertain] = c * flange.scales
    np.testing.assert_allclose(arm.parameters, believed.parameters + expected)
    here = flange(c)
    np.testing.assert_array_equal(here.T_world_camera.as_matrix(), arm.flange_poses(q).as_matrix())
    back = here.T_world_camera.inv()
    assert_jacobian(
        lambda c: np.roll((back * flange(c).T_world_camera).as_exp_coords(), 3, axis=-1),
        here.common,
        c,
        rtol=1e-7,
        step=0.3,
    )
    at_camera = model.prior(believed, q, RigidTransform.identity())
    to_camera = believed.T_flange_camera.inv()
    for i in range(4):
        pushed = [
            np.roll((to_camera * pose_exp(1e-3 * r) * to_camera.inv()).as_exp_coords(), 3)
            for r in here.root[i].T
        ]
        covariance = 1e6 * np.array(pushed).T @ np.array(pushed)
        np.testing.assert_allclose(covariance, at_camera.root[i] @ at_camera.root[i].T, rtol=1e-6, atol=1e-14)


def test_a_flange_model_has_uncertain_parameters_only() -> None:
    flange = ArmErrors(position=1e-4, joint_offset=1e-3).flange_model(NOMINAL, near_home(3))
    assert flange.names == tuple(f"joint_offset_{i}" for i in range(1, 6))
    assert flange(np.zeros(5)).common.shape == (3, 6, 5)
    exact = ArmErrors().flange_model(NOMINAL, near_home(3))
    assert exact.names == () and exact(np.zeros(0)).exact


def test_presets_by_name() -> None:
    assert get_arm("typical") is ARMS["typical"]
    with pytest.raises(InvalidInput, match="accepted: ideal, calibrated, typical, poor"):
        get_arm("perfect")


@pytest.mark.parametrize("name", [field.name for field in fields(ArmErrors)])
@pytest.mark.parametrize("value", [-1.0, float("nan"), float("inf")])
def test_bad_values_are_named(name: str, value: float) -> None:
    with pytest.raises(InvalidInput, match=name.replace("_", " ")):
        ArmErrors(**{name: value})
