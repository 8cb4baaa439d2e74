"""The geometric sensor: exact contacts against ray casting and the scene's own, estimates against the truth."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from extremal.estimator import Camera, InvalidInput, SceneError
from extremal.estimator.adjustment import adjust
from extremal.estimator.camera import Array
from extremal.estimator.poses import PosePrior, pose_exp
from extremal.estimator.support import Sections
from extremal.scenes import Box, Mesh, Scene, Sphere, load_scene, randomised
from extremal.sim import LinearMotion
from extremal.tasks.contacts import EdgeGeometry
from extremal.tasks.edge_choice import choose
from extremal.tasks.edge_model import EdgeModel
from extremal.tasks.features import Features
from extremal.tasks.geometric import GeometricSensor
from extremal.tasks.section_smoother import SectionSmoother

CAMERA = Camera()
VIEWS = 24
MOTION = LinearMotion(views=VIEWS, baseline=0.35, distance=0.55)


def vase_and_box(seed: int) -> Scene:
    return randomised(load_scene("vase-and-box"), np.random.default_rng(seed))


def told(
    scene: Scene, seed: int, pose: float, sensor: GeometricSensor | None = None, views: int = VIEWS
) -> Features:
    """What the sensor tells after a linear motion with poses that are off by `pose` [m], [rad] in each look."""
    rng = np.random.default_rng([5, seed])
    poses = MOTION.poses(scene.target, rng)
    believed = poses * pose_exp(pose * rng.standard_normal((VIEWS, 6)))
    sensor = sensor or GeometricSensor()
    sensor.reset(scene, CAMERA, rng)
    features = Features.empty()
    for i in range(views):
        features = sensor.look(poses[i].as_matrix(), believed[i].as_matrix(), pose**2 * np.eye(6))
    return features


def errors(scene: Scene, features: Features) -> tuple[Array, Array, Array]:
    """(R - truth) / sigma of limbs and of fixed features, and errors of limbs [m]: of the nearest surface or curve."""
    curves = np.concatenate([c.points for s in scene.objects for c in s.fixed_curves()])
    away = np.array([np.linalg.norm(curves - p, axis=1).min() for p in features.position])
    vase = scene["vase"]
    n = vase.normals(features.position)
    aligned = np.sum(n * features.normal, axis=1)
    on_vase = (np.abs(vase.signed_distance(features.position)) < 0.006) & (np.abs(aligned) > 0.97)
    limb, known = on_vase & (away > 0.004), np.isfinite(features.best_sigma)
    true = np.where(limb, np.sign(aligned) * vase.section_radius(features.position, features.plane), 0.0)
    error = features.best_radius - true
    z = error / features.best_sigma
    return z[limb & known], z[(away < 0.004) & ~limb & known], error[limb & known]


@pytest.mark.parametrize(("pose", "seeds"), [(0.0, range(6)), (1e-3, range(20, 30))])
def test_sigma_is_honest(pose: float, seeds: range) -> None:
    """Between 90 and 99 % within 1.96 sigma. Errors of one trial hang together through its poses, so that its tracks count
    like a few: the bounds are wider by two standard deviations of a proportion of 4 a trial."""
    limbs, fixed = [], []
    for seed in seeds:
        scene = vase_and_box(seed)
        limb, other, _ = errors(scene, told(scene, seed, pose))
        limbs.append(limb)
        fixed.append(other)
    slack = 2 * np.sqrt(0.95 * 0.05 / (4 * len(seeds)))
    for z in (np.concatenate(limbs), np.concatenate(fixed)):
        assert len(z) > 8 * len(seeds)
        assert 0.90 - slack < np.mean(np.abs(z) < 1.96)
        assert np.median(np.abs(z)) > 0.2  # sigma is not just large


def test_labels_and_references() -> None:
    scene = vase_and_box(40)
    features = told(scene, 40, 1e-3)
    on_vase = np.abs(scene["vase"].signed_distance(features.position)) < 0.003
    assert features.reference.sum() >= 8
    assert np.mean(features.extremal[features.reference]) < 0.3
    assert on_vase.sum() > 5 and features.visible.mean() > 0.7
    relative = np.isfinite(features.sigma_relative) & np.isfinite(features.sigma_radius)
    assert np.median((features.sigma_relative / features.sigma_radius)[relative]) < 0.4


def test_same_seed_same_bytes() -> None:
    one, two = (told(vase_and_box(3), 3, 1e-3, views=12) for _ in range(2))
    np.testing.assert_array_equal(one.radius, two.radius)
    np.testing.assert_array_equal(one.pixels, two.pixels)


def test_before_there_are_enough_looks() -> None:
    scene, sensor = vase_and_box(1), GeometricSensor()
    with pytest.raises(InvalidInput, match="before `reset`"):
        sensor.look(np.eye(4), np.eye(4), np.zeros((6, 6)))
    assert len(told(scene, 1, 0.0, sensor, views=3)) == 0
    assert sensor.frame is None
    pose = MOTION.poses(scene.target, np.random.default_rng(0))[0]
    sensor.reset(scene, CAMERA, np.random.default_rng(0))
    for _ in range(9):
        assert len(sensor.look(pose.as_matrix(), pose.as_matrix(), np.zeros((6, 6)))) == 0  # no motion
    sensor.close()


def test_nothing_in_sight() -> None:
    scene, sensor = vase_and_box(1), GeometricSensor()
    poses = MOTION.poses((3.0, 0.0, 0.5), np.random.default_rng(0))
    sensor.reset(scene, CAMERA, np.random.default_rng(0))
    for i in range(12):
        assert len(sensor.look(poses[i].as_matrix(), poses[i].as_matrix(), np.zeros((6, 6)))) == 0


def test_a_mesh_is_refused() -> None:
    corners = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]])
    mesh = Mesh(vertices=corners, faces=np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]), name="m")
    with pytest.raises(SceneError, match="'m' is a mesh"):
        GeometricSensor().reset(Scene((mesh,)), CAMERA, np.random.default_rng(0))


@pytest.mark.parametrize("name", ["vase-and-box", "ellipsoid", "waisted-vase"])
def test_contacts_follow_exactly(name: str) -> None:
    """Every contact lies in its plane; limbs on the surface, where rays graze it; fixed ones on their curves."""
    scene = load_scene(name)
    poses = MOTION.poses(scene.target, np.random.default_rng(2)).as_matrix()
    geometry, travel = EdgeGeometry(scene), np.array([0, 1.0, 0])
    contacts, _ = choose(geometry, CAMERA, poses[8, :3, :3], poses[8, :3, 3], travel)
    planes = np.cross(travel, contacts.points - poses[8, :3, 3])
    for i in range(9, 13):
        c = poses[i, :3, 3]
        contacts = geometry.advance(contacts, c, planes)
        there = contacts.there
        assert there.mean() > 0.9
        ray = contacts.points - c
        assert np.abs(np.sum(planes * ray, axis=1))[there].max() < 1e-6
        assert np.abs(np.sum(contacts.normals * ray, axis=1))[there].max() < 1e-8
        for k in np.unique(contacts.surface[contacts.surface >= 0]):
            rows = there & (contacts.surface == k)
            assert np.abs(scene.objects[k].signed_distance(contacts.points[rows])).max() < 1e-8


def test_what_hides_agrees_with_ray_casting() -> None:
    scene = vase_and_box(7)
    geometry, c = EdgeGeometry(scene), np.array([-0.4, -0.35, 0.2])
    points = geometry.fixed.points[::37]
    ray = points - c
    first = np.min([s.intersect(c, ray) for s in scene.objects], axis=0)
    exact = first < 1 - 0.003 / np.linalg.norm(ray, axis=1)
    assert 0.2 < exact.mean() < 0.9
    assert np.mean(geometry.hidden(c, points) != exact) < 0.02


def test_a_sphere_behind_a_box_is_not_seen() -> None:
    scene = Scene(
        (
            Sphere(radius=0.05, T_world_object=RigidTransform.from_translation([0, 0, 0.05])),
            Box(size=(0.02, 1.5, 1.5), T_world_object=RigidTransform.from_translation([-0.2, 0, 0])),
        ),
        target=(0, 0, 0.05),
    )
    features = told(scene, 0, 0.0, views=8)
    assert not np.any(np.linalg.norm(features.position - [0, 0, 0.05], axis=1) < 0.06)


def test_smoother_equals_the_batch_adjustment() -> None:
    """The same planes through `adjust`, which has another parametrisation of weights and steps."""
    rng = np.random.default_rng(0)
    scene = vase_and_box(9)
    poses = MOTION.poses(scene.target, rng)
    believed = poses * pose_exp(1e-3 * rng.standard_normal((VIEWS, 6)))
    geometry, travel = EdgeGeometry(scene), np.array([0, 1.0, 0])
    P, B, middle = poses.as_matrix(), believed.as_matrix(), VIEWS // 2
    contacts, _ = choose(geometry, CAMERA, P[middle, :3, :3], P[middle, :3, 3], travel)
    away = contacts.points - P[middle, :3, 3]
    origin = contacts.points * 1.0
    ray = away / np.linalg.norm(away, axis=1, keepdims=True)
    plane = np.cross(travel, ray)
    plane /= np.linalg.norm(plane, axis=1, keepdims=True)
    first = np.cross(ray, plane)
    first *= np.sign(first @ travel)[:, None]
    frame = np.stack([first, ray, np.cross(first, ray)], axis=1)
    smoother = SectionSmoother(origin, frame, np.linalg.norm(away, axis=1), 0.0, 0.1, False)
    # so that what circles leave of the vase is within the errors of edges: it weighs nothing in the batch
    sigma, normals, order = 5e-4, np.zeros((len(ray), VIEWS, 3)), [*range(middle, -1, -1)]
    for part in (order, list(range(middle + 1, VIEWS))):
        moved = contacts
        for i in part:
            moved = geometry.advance(moved, P[i, :3, 3], plane)
            n = moved.normals * np.sign(np.sum(moved.normals * first, axis=1))[:, None]
            towards = moved.points - P[i, :3, 3]
            towards /= np.linalg.norm(towards, axis=1, keepdims=True)
            n = n + sigma * rng.standard_normal((len(n), 1)) * towards
            normals[:, i] = (n / np.linalg.norm(n, axis=1, keepdims=True)) @ P[i, :3, :3]
    fixed = contacts.curve >= 0
    smoother.fixed = fixed
    for i in range(VIEWS):
        smoother.update(B[i], 1e-3 * np.eye(6), normals[:, i], np.full(len(ray), sigma))
    held = [smoother.solve() for _ in range(15)][-1].held(fixed)
    sections = Sections(
        normals[:, None], np.full((len(ray), 1, VIEWS), sigma), origin, frame, np.where(fixed, 2, 3)
    )
    batch = adjust(PosePrior(believed, np.tile(1e-3 * np.eye(6), (VIEWS, 1, 1))), [sections], 1.0).shapes[0]
    off = np.abs(held.radius - batch.radius) / batch.sigma_radius
    assert np.median(off[~fixed]) < 0.25 and off[~fixed].max() < 0.5
    np.testing.assert_allclose(held.sigma[~fixed], batch.sigma_radius[~fixed], rtol=0.15)


def test_edge_model_draws_what_it_says() -> None:
    model, rng, n = EdgeModel(0.05, 0.1, 0.1, 0.1, 0.0, 1.0), np.random.default_rng(1), 20_000
    bias = model.first_bias(n, rng)
    later = model.next_bias(bias, 0.05, rng)
    assert np.std(later) == pytest.approx(0.1, rel=0.03)
    assert np.corrcoef(bias, later)[0, 1] == pytest.approx(np.exp(-0.5), abs=0.02)
    error, found = model.draw(bias, model.noise(np.zeros(n, bool)), rng)
    assert np.std(error - bias) == pytest.approx(0.05, rel=0.03)
    assert np.mean(found) == pytest.approx(0.9, abs=0.01)
    with pytest.raises(InvalidInput, match=r"dropout of edges is 1\.5"):
        EdgeModel(dropout=1.5)
