"""The rendered sensor: frames, few looks, and agreement with the geometric one on the same path."""

from typing import Any

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from extremal.estimator import Camera, Contours, InvalidInput, find_contours
from extremal.estimator.camera import Array
from extremal.estimator.poses import pose_exp
from extremal.estimator.threads import blas_threads
from extremal.scenes import Scene, load_scene, randomised
from extremal.scripts.sensor_study import sensor_study
from extremal.sim import LinearMotion
from extremal.tasks import rendered
from extremal.tasks.edge_model import EdgeModel
from extremal.tasks.features import Features, FeatureSensor
from extremal.tasks.geometric import GeometricSensor
from extremal.tasks.rendered import RenderedSensor

SMALL = Camera(width=320, height=240, fx=400.0, fy=400.0)
VIEWS = 20
MOTION = LinearMotion(views=VIEWS, baseline=0.3, distance=0.55)
CENTRE, RADIUS = np.array([0.0, 0.0, 0.05]), 0.05  # [m] of the preset's sphere


def told(sensor: FeatureSensor, scene: Scene, camera: Camera, seed: int, pose: float, views: int) -> Features:
    rng = np.random.default_rng(seed)
    poses = MOTION.poses(scene.target, rng)
    believed = poses * pose_exp(pose * rng.standard_normal((VIEWS, 6)))
    sensor.reset(scene, camera, rng)
    features = Features.empty()
    for i in range(views):
        features = sensor.look(poses[i].as_matrix(), believed[i].as_matrix(), pose**2 * np.eye(6))
    return features


def test_the_limb_of_a_sphere() -> None:
    sensor = RenderedSensor()
    features = told(sensor, load_scene("sphere"), SMALL, 1, 0.0, VIEWS)
    frame = sensor.frame
    sensor.close()
    assert frame is not None and frame.shape == (240, 320) and frame.dtype == np.uint8
    away = features.position - CENTRE
    limb = features.extremal & (np.abs(np.linalg.norm(away, axis=1) - RADIUS) < 0.003)
    assert limb.sum() >= 8
    assert np.median(np.sum(away * features.normal, axis=1)[limb]) == pytest.approx(RADIUS, abs=1e-3)
    height = np.sum(away * features.plane, axis=1)
    true = np.sqrt(np.maximum(RADIUS**2 - height**2, 0))
    z = ((features.radius - true) / features.sigma_radius)[limb]
    assert np.mean(np.abs(z) < 1.96) > 0.8


def test_frames_do_not_depend_on_when_they_are_asked_for() -> None:
    scene, sensor = load_scene("sphere"), RenderedSensor()
    poses = MOTION.poses(scene.target, np.random.default_rng(0))
    frames: list[list[Array]] = []
    for asked in (True, False):
        sensor.reset(scene, SMALL, np.random.default_rng(1))
        assert sensor.frame is None
        seen = []
        for i in (0, 0, 1):
            sensor.look(poses[i].as_matrix(), poses[i].as_matrix(), np.zeros((6, 6)))
            if asked or i == 1:
                assert sensor.frame is not None
                seen.append(sensor.frame)
        frames.append(seen)
    sensor.close()
    np.testing.assert_array_equal(frames[0][-1], frames[1][-1])
    assert np.any(frames[0][0] != frames[0][1])  # other noise


def test_few_looks_and_no_looks() -> None:
    sensor = RenderedSensor()
    with pytest.raises(InvalidInput, match="before `reset`"):
        sensor.look(np.eye(4), np.eye(4), np.zeros((6, 6)))
    scene = load_scene("sphere")
    assert len(told(sensor, scene, SMALL, 0, 1e-3, 3)) == 0
    pose = MOTION.poses(scene.target, np.random.default_rng(0))[0]
    for _ in range(7):
        assert len(sensor.look(pose.as_matrix(), pose.as_matrix(), 1e-6 * np.eye(6))) == 0
    sensor.close()
    sensor.close()
    assert sensor.frame is None


def test_no_idle_thread_takes_the_renderers_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    """Threads of a BLAS wait for work by spinning: of each look, from frame to features, there is one."""
    threads: list[int] = []

    def counted(*arguments: Any) -> Contours:
        threads.append(blas_threads())
        return find_contours(*arguments)

    monkeypatch.setattr(rendered, "find_contours", counted)
    sensor = RenderedSensor()
    with threadpool_limits(2, user_api="blas"):
        told(sensor, load_scene("sphere"), SMALL, 1, 0.0, 3)
        assert threads == [1, 1, 1] and blas_threads() == 2
    sensor.close()


@pytest.mark.slow
def test_the_edge_model_is_that_of_the_pipeline() -> None:
    """Four of the vases that it was fitted to, looked at anew: what a change of the pipeline does to its edges shows here."""
    found, model = sensor_study(4), EdgeModel()
    for name in ("sigma_px", "fixed_sigma_px"):
        assert getattr(found, name) == pytest.approx(getattr(model, name), rel=0.3)
    assert found.bias_px < 0.5 * found.sigma_px and found.dropout < 0.03 and found.outlier < 0.03


def of_vase(scene: Scene, features: Features) -> tuple[Array, Array]:
    """Errors [m] and sigma of the vase's limbs, against the surface at the contact points."""
    vase = scene["vase"]
    n = vase.normals(features.position)
    aligned = np.sum(n * features.normal, axis=1)
    curves = np.concatenate([c.points for s in scene.objects for c in s.fixed_curves()])
    away = np.array([np.linalg.norm(curves - p, axis=1).min() for p in features.position])
    limb = (np.abs(vase.signed_distance(features.position)) < 0.006) & (np.abs(aligned) > 0.97)
    limb &= (away > 0.004) & np.isfinite(features.best_sigma)
    true = np.sign(aligned) * vase.section_radius(features.position, features.plane)
    return (features.best_radius - true)[limb], features.best_sigma[limb]


@pytest.mark.slow
@pytest.mark.parametrize("pose", [0.0, 1e-3])
def test_both_sensors_agree(pose: float) -> None:
    """Medians of |R error| within a factor of 1.5, coverage within 10 %, on the same paths of unseen scenes."""
    found: list[tuple[Array, Array]] = []
    for sensor in (RenderedSensor(), GeometricSensor()):
        parts = []
        for seed in range(50, 58):
            scene = randomised(load_scene("vase-and-box"), np.random.default_rng(seed))
            parts.append(of_vase(scene, told(sensor, scene, Camera(), seed, pose, VIEWS)))
        sensor.close()
        found.append((np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts])))
    medians = [float(np.median(np.abs(error))) for error, _ in found]
    covered = [float(np.mean(np.abs(error) < 1.96 * sigma)) for error, sigma in found]
    assert max(medians) < 1.5 * min(medians)
    assert min(covered) > 0.88 and abs(covered[0] - covered[1]) < 0.1
