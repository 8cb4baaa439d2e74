"""Named cameras, drift and motion blur as they reach the rendered frame."""

import numpy as np
import pytest

from extremal.estimator import InvalidInput
from extremal.scenes import load_scene
from extremal.sim import FrameRenderer, LinearMotion, scene_model
from extremal.sim.cameras import CAMERAS, get_camera
from extremal.sim.frames import render_frames
from extremal.sim.quality import get_quality


def test_names_are_listed() -> None:
    assert set(CAMERAS) == {"ideal", "industrial", "webcam"}
    assert not get_camera("ideal").camera.is_distorted
    with pytest.raises(InvalidInput, match="ideal, industrial, webcam"):
        get_camera("kodak")


@pytest.mark.parametrize("name", list(CAMERAS))
def test_distortion_can_be_inverted_all_over_the_image(name: str) -> None:
    camera = get_camera(name).camera
    x, y = np.meshgrid(np.linspace(0, camera.width - 1, 40), np.linspace(0, camera.height - 1, 30))
    pixels = np.stack([x, y], axis=-1)
    assert np.abs(camera.distort(camera.normalise(pixels)) - pixels).max() < 1e-6


@pytest.mark.slow
def test_gains_and_motion_blur_are_averages_of_frames() -> None:
    scene = load_scene("vase-and-box")
    model, camera = scene_model(scene.to_spec()), get_camera("ideal").camera
    poses = LinearMotion(views=3, baseline=0.004).poses(scene.target, np.random.default_rng(0))
    with FrameRenderer(model, camera, "preview") as renderer:
        single = [renderer.render(poses[i]) for i in range(3)]
        blurred = renderer.render(poses)
        channels = [renderer.render(poses[1], np.where(np.arange(3) == c, 1.0, 1e-9)) for c in range(3)]
        tinted = renderer.render(poses[1], (1.1, 1.0, 0.8))
        with pytest.raises(InvalidInput, match="gains"):
            renderer.render(poses[1], (1.0, np.nan, 1.0))
    assert np.abs(blurred - np.mean(single, axis=0)).max() < 1e-3
    assert np.abs(tinted - (1.1 * channels[0] + channels[1] + 0.8 * channels[2])).max() < 1e-3
    gains = np.array([[1.1, 1.0, 0.8], [1.0, 1.0, 1.0]])
    frames = render_frames(model, camera, get_quality("preview"), [poses[1], poses], 1, gains=gains)
    assert np.array_equal(frames[0], tinted) and np.array_equal(frames[1], blurred)
    with pytest.raises(InvalidInput, match=r"gains are \(2, 3\)"):
        render_frames(model, camera, get_quality("preview"), poses, 1, gains=gains)
