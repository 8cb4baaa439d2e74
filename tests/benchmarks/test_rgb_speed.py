"""How fast images are as observations, beside MuJoCo's bare renderer: numbers for the record, none of them passes or fails a test."""

import time
from collections.abc import Callable

import gymnasium as gym
import mujoco
import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture
from scipy.spatial.transform import RigidTransform

from extremal.estimator.camera import Array
from extremal.sim.axes import swap_camera_axes
from extremal.sim.rendering import EYE
from extremal.tasks.environment import RGB
from extremal.tasks.eye import Eye

pytestmark = pytest.mark.slow

FRAMES = 60


def seconds(frame: Callable[[], object]) -> float:
    started = time.perf_counter()
    frame()
    return time.perf_counter() - started


def in_turns(eye: Eye, pose: RigidTransform) -> Array:
    """Times (FRAMES, 2) [s] of an image as it is observed, and of the same by `mujoco.Renderer` alone."""
    assert eye._drawing is not None
    model = eye._drawing.model
    model.vis.global_.offwidth = model.vis.global_.offheight = RGB
    data, there = mujoco.MjData(model), swap_camera_axes(pose)
    data.mocap_pos[0] = there.translation
    data.mocap_quat[0] = there.rotation.as_quat(scalar_first=True)
    mujoco.mj_forward(model, data)
    bare = mujoco.Renderer(model, RGB, RGB)

    def barely() -> Array:
        bare.update_scene(data, EYE)
        return bare.render()

    assert np.array_equal(eye.image(pose), barely())
    spent = [(seconds(lambda: eye.image(pose).copy()), seconds(barely)) for _ in range(FRAMES)]
    bare.close()
    return np.array(spent)


def test_rgb_beside_the_bare_renderer(benchmark: BenchmarkFixture) -> None:
    """To be at least 0.85 times the rate of `mujoco.Renderer` on the same model, in turns on the same cores."""
    env = gym.make("extremal.tasks:extremal/Navigate-v0", obs_mode="rgb")
    env.reset(seed=0)
    scene, camera, pose = (getattr(env.unwrapped, name) for name in ("scene", "camera", "actual"))
    env.close()
    with Eye(scene, camera, RGB, RGB) as eye:
        ours, bare = np.median(in_turns(eye, pose), axis=0)
        benchmark.pedantic(lambda: eye.image(pose), rounds=1)
    benchmark.extra_info["frames_per_second"] = float(1 / ours)
    benchmark.extra_info["of_the_bare_renderer"] = float(1 / bare)
    benchmark.extra_info["ratio"] = float(bare / ours)
