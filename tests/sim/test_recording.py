"""Recordings: commanded, actual and believed poses, determinism, any number of workers, clear errors."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform, Rotation

from extremal.estimator import Camera, InvalidInput
from extremal.scenes import Scene, load_scene
from extremal.sim import ARMS, NOMINAL, ArmErrors, Drive, LinearMotion, Recording, Sensor, record

CAMERA = Camera(width=160, height=120, fx=200.0, fy=200.0)
MOTION = LinearMotion(views=4)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("vase-and-box")


@pytest.fixture(scope="module")
def exact(scene: Scene) -> Recording:
    """By an arm and a sensor without errors."""
    return take(scene, errors=ArmErrors(), sensor=Sensor(0.0))


def take(scene: Scene, seed: int = 0, workers: int | None = 1, **changes: object) -> Recording:
    values = {"quality": "preview", "sensor": Sensor(), "errors": ARMS["typical"]} | changes
    return record(scene, CAMERA, MOTION, rng=np.random.default_rng(seed), workers=workers, **values)  # type: ignore[arg-type]


def content(recording: Recording) -> bytes:
    parts = [v.image.tobytes() + v.T_world_camera.as_matrix().tobytes() for v in recording.views]
    return b"".join(parts) + recording.readings.tobytes()


def test_same_seed_same_bytes(scene: Scene) -> None:
    first, second, other = (content(take(scene, seed)) for seed in (3, 3, 4))
    assert first == second
    assert first != other


def test_any_number_of_workers_gives_the_same_bytes(scene: Scene) -> None:
    calls: list[tuple[int, int]] = []
    parallel = take(scene, 3, 2, progress=lambda done, total: calls.append((done, total)))
    assert content(parallel) == content(take(scene, 3, 1))
    assert calls == [(i, 4) for i in range(5)]


def off(first: RigidTransform, second: RigidTransform) -> np.ndarray:
    """(6,) = (translation [m], rotation vector [rad]) from one pose to another."""
    return np.roll((first.inv() * second).as_exp_coords(), 3)


def test_an_exact_arm_goes_where_it_is_commanded(exact: Recording) -> None:
    assert exact.prior.exact
    for i, view in enumerate(exact.views):
        assert np.abs(off(exact.commanded[i], exact.actual[i])).max() < 1e-9
        assert np.abs(off(view.T_world_camera, exact.actual[i])).max() < 1e-12
        assert not view.pose_covariance.any()


def test_commanded_actual_and_believed_are_three_things(scene: Scene) -> None:
    errors = ArmErrors(encoder_noise=1e-4, joint_offset=1e-3)
    wrong = take(scene, errors=errors)
    noise = []
    for i, view in enumerate(wrong.views):
        # the camera is where the joints' zeros put it, and seems to be where the noisy readings say
        assert 2e-4 < np.linalg.norm(off(wrong.commanded[i], wrong.actual[i])[:3]) < 5e-3
        assert 2e-4 < np.linalg.norm(off(view.T_world_camera, wrong.actual[i])[:3]) < 5e-3
        noise.append(np.linalg.norm(off(wrong.commanded[i], view.T_world_camera)[:3]))
        believed = wrong.T_world_base * NOMINAL.camera_poses(wrong.readings[i : i + 1])
        assert np.abs(off(view.T_world_camera, believed[0])).max() < 1e-12
        np.testing.assert_allclose(view.pose_covariance, wrong.prior.root[i] @ wrong.prior.root[i].T)
    assert 1e-5 < max(noise) < 3e-4
    assert wrong.prior.common.shape == (4, 6, 5)
    np.testing.assert_array_equal(
        wrong.prior.T_world_camera[2].as_matrix(), wrong.views[2].T_world_camera.as_matrix()
    )


def test_repeatability_moves_the_camera_and_not_what_is_believed(scene: Scene) -> None:
    wrong = take(scene, errors=ArmErrors(position=2e-3))
    errors = []
    for i, view in enumerate(wrong.views):
        assert np.abs(off(wrong.commanded[i], view.T_world_camera)).max() < 1e-9
        errors.append(off(view.T_world_camera, wrong.actual[i]))
        np.testing.assert_allclose(view.pose_covariance, np.diag([4e-6] * 3 + [0] * 3), atol=1e-18)
    errors = np.array(errors)
    assert np.abs(errors[:, 3:]).max() < 1e-12
    assert 0.5 < np.sqrt(np.mean(errors[:, :3] ** 2)) / 2e-3 < 1.5


def test_the_arm_is_the_one_that_is_given(scene: Scene) -> None:
    """An individual in all its recordings; frames are taken by it, whatever is believed of it."""
    arm = ARMS["typical"].draw(np.random.default_rng(11))
    known = take(scene, errors=ArmErrors(), geometry=arm, believed=arm)
    unknown = take(scene, errors=ArmErrors(), geometry=arm)
    for i in range(4):
        assert np.abs(off(known.commanded[i], known.actual[i])).max() < 1e-9
        assert np.abs(off(known.views[i].T_world_camera, known.actual[i])).max() < 1e-12
        error = off(unknown.views[i].T_world_camera, unknown.actual[i])
        assert 1e-4 < np.linalg.norm(error[:3]) < 1e-2
        expected = NOMINAL.camera_poses(unknown.readings)[i].inv() * arm.camera_poses(unknown.readings)[i]
        np.testing.assert_allclose(error, np.roll(expected.as_exp_coords(), 3), atol=1e-9)


def test_an_individual_is_drawn_where_none_is_given(scene: Scene) -> None:
    drawn = take(scene, errors=ArmErrors(joint_offset=1e-3))
    error = off(drawn.views[0].T_world_camera, drawn.actual[0])
    assert 1e-4 < np.linalg.norm(error[3:]) < 1e-2


def test_the_camera_believed_is_not_the_one_that_sees(scene: Scene, exact: Recording) -> None:
    believed = replace(CAMERA, fx=202.0, cx=80.0)
    other = take(scene, errors=ArmErrors(), sensor=Sensor(0.0), believed_camera=believed)
    assert other.camera == CAMERA and all(v.camera == believed for v in other.views)
    for a, b in zip(exact.views, other.views, strict=True):
        np.testing.assert_array_equal(a.image, b.image)


def test_physics_settles_to_the_same_frames(scene: Scene, exact: Recording) -> None:
    driven = take(scene, errors=ArmErrors(), sensor=Sensor(0.0, exposure_time=0.01), drive=Drive())
    for i in range(4):
        assert np.abs(off(exact.actual[i], driven.actual[i])).max() < 1e-6
        difference = exact.views[i].image.astype(float) - driven.views[i].image
        assert np.abs(difference).mean() < 0.01
    assert np.abs(driven.readings - exact.readings).max() < 1e-6


class Sideways:
    """A motion of its own kind: along world y, always looking along +x."""

    def centre(self, target: ArrayLike) -> np.ndarray:
        return np.asarray(target, float) - [0.6, 0, 0]

    def poses(self, target: ArrayLike, rng: np.random.Generator) -> RigidTransform:
        centres = self.centre(target) + np.outer([-0.05, 0, 0.05], [0, 1, 0])
        axes = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
        return RigidTransform.from_components(centres, Rotation.from_matrix(axes))


def test_on_the_fly_the_frames_are_blurred_along_the_motion(scene: Scene) -> None:
    """Squared differences between neighbouring pixels fall along the motion, by as much as its length says."""
    sharp, blurred = (
        record(
            scene,
            CAMERA,
            Sideways(),
            "preview",
            Sensor(0.0, exposure_time=t),
            workers=1,
            drive=Drive(settle=0.0),
        )
        for t in (0.0, 0.08)
    )
    assert np.abs(off(sharp.actual[1], blurred.actual[1])).max() < 1e-5
    images = [r.views[1].image.astype(float) for r in (sharp, blurred)]
    along, across = (
        np.sum(np.diff(images[1], axis=k) ** 2) / np.sum(np.diff(images[0], axis=k) ** 2) for k in (1, 0)
    )
    assert along < 0.65 and across > along + 0.2


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
        record(scene, camera, MOTION, "preview", Sensor(), ArmErrors(), np.random.default_rng(0))


def test_camera_inside_an_object(scene: Scene) -> None:
    motion = LinearMotion(views=3, baseline=0.1, distance=0.01)
    with pytest.raises(InvalidInput, match="inside"):
        record(scene, CAMERA, motion, "preview", Sensor(), ArmErrors(), np.random.default_rng(0))


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
