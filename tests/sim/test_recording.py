"""Recordings: commanded, actual and believed poses, determinism, any number of workers, clear errors."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from extremal.estimator import Camera, InvalidInput
from extremal.scenes import Scene, load_scene
from extremal.sim import LinearMotion, PoseErrors, Recording, Sensor, record

CAMERA = Camera(width=160, height=120, fx=200.0, fy=200.0)
MOTION = LinearMotion(views=4)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("vase-and-box")


def take(scene: Scene, seed: int = 0, workers: int | None = 1, **changes: object) -> Recording:
    values = {"quality": "preview", "sensor": Sensor(), "pose_errors": PoseErrors(1e-3, 1e-3)} | changes
    return record(scene, CAMERA, MOTION, rng=np.random.default_rng(seed), workers=workers, **values)  # type: ignore[arg-type]


def content(recording: Recording) -> bytes:
    parts = [v.image.tobytes() + v.T_world_camera.as_matrix().tobytes() for v in recording.views]
    return b"".join(parts) + recording.joint_positions.tobytes()


def test_same_seed_same_bytes(scene: Scene) -> None:
    first, second, other = (content(take(scene, seed)) for seed in (3, 3, 4))
    assert first == second
    assert first != other


def test_any_number_of_workers_gives_the_same_bytes(scene: Scene) -> None:
    calls: list[tuple[int, int]] = []
    parallel = take(scene, 3, 2, progress=lambda done, total: calls.append((done, total)))
    assert content(parallel) == content(take(scene, 3, 1))
    assert calls == [(i, 4) for i in range(5)]


def test_commanded_actual_and_believed(scene: Scene) -> None:
    exact = take(scene, pose_errors=PoseErrors())
    wrong = take(scene, pose_errors=PoseErrors(position=2e-3, joint_bias=1e-3))
    for i in range(4):
        difference = exact.commanded[i].inv() * exact.actual[i]
        assert np.abs(difference.as_exp_coords()).max() < 1e-9
        believed = exact.views[i].T_world_camera.inv() * exact.actual[i]
        assert np.abs(believed.as_exp_coords()).max() < 1e-12
        # Errors change what is believed, neither where the camera was nor what it saw.
        np.testing.assert_array_equal(wrong.actual[i].as_matrix(), exact.actual[i].as_matrix())
        np.testing.assert_array_equal(wrong.views[i].image, exact.views[i].image)
        gap = np.linalg.norm(wrong.views[i].centre - wrong.actual[i].translation)
        assert 1e-4 < gap < 2e-2
        np.testing.assert_allclose(np.diag(wrong.views[i].pose_covariance), [4e-6] * 3 + [0] * 3)


def test_noise_is_added_to_the_frame(scene: Scene) -> None:
    clean, noisy = (take(scene, sensor=Sensor(noise=n)) for n in (0.0, 3.0))
    for a, b in zip(clean.views, noisy.views, strict=True):
        difference = b.image.astype(float) - a.image
        assert abs(difference.std() - np.sqrt(9 + 1 / 6)) < 0.1
    first, second = (
        b.image.astype(float) - a.image for a, b in zip(clean.views[:2], noisy.views[:2], strict=True)
    )
    assert abs(np.corrcoef(first.ravel(), second.ravel())[0, 1]) < 5 / np.sqrt(first.size)


def test_target_outside_the_field_of_view(scene: Scene) -> None:
    camera = replace(CAMERA, cx=500.0)
    with pytest.raises(InvalidInput, match="outside the field of view"):
        record(scene, camera, MOTION, "preview", Sensor(), PoseErrors(), np.random.default_rng(0))


def test_camera_inside_an_object(scene: Scene) -> None:
    motion = LinearMotion(views=3, baseline=0.1, distance=0.01)
    with pytest.raises(InvalidInput, match="inside"):
        record(scene, CAMERA, motion, "preview", Sensor(), PoseErrors(), np.random.default_rng(0))


def test_workers_are_counted_from_one(scene: Scene) -> None:
    with pytest.raises(InvalidInput, match="workers is 0"):
        take(scene, workers=0)


def test_a_script_without_main_guard_is_told(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(
        "from extremal.estimator import Camera\n"
        "from extremal.scenes import load_scene\n"
        "from extremal.sim import LinearMotion, record\n"
        "record(load_scene('sphere'), Camera(), LinearMotion(views=3), 'preview', workers=2)\n"
    )
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, check=False, timeout=90)
    assert done.returncode == 1
    # the last line of the traceback; Python's resource tracker, a process of its own, may add a warning after it
    (told,) = (line for line in done.stderr.splitlines() if line.startswith("extremal.estimator.errors."))
    assert "RenderingError" in told and 'under `if __name__ == "__main__":`' in told
