"""Parts of frames, and skies that are drawn as a far wall: the same pixels as whole frames under a sky box."""

import mujoco
import numpy as np
import pytest

from extremal.estimator import Camera, InvalidInput
from extremal.scenes import Scene, load_scene
from extremal.sim import FrameRenderer, LinearMotion, scene_model
from extremal.sim.backdrop import Backdrop
from extremal.sim.window import cropped

CAMERA = Camera(width=320, height=240, fx=400.0, fy=400.0, cx=150.3)
DISTORTED = Camera(width=320, height=240, fx=400.0, fy=400.0, distortion=(-0.1, 0.02, 0.001, 0.0, 0.0))


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("vase-and-box")


@pytest.mark.parametrize("camera", [CAMERA, DISTORTED], ids=["pinhole", "distorted"])
@pytest.mark.parametrize("part", [(0, 0, 320, 240), (64, 48, 128, 96), (208, 0, 112, 240)])
def test_a_part_of_a_frame(scene: Scene, camera: Camera, part: tuple[int, int, int, int]) -> None:
    pose = LinearMotion(views=3).poses(scene.target, np.random.default_rng(1))[1]
    left, top, width, height = part
    with FrameRenderer(scene_model(scene.to_spec()), camera, "preview") as renderer:
        whole = renderer.render(pose)[top : top + height, left : left + width]
        found = renderer.render(pose, part=cropped(camera, *part))
    assert found.shape == whole.shape
    # vertices are snapped to 1/256 px, which single precision decides otherwise for a few; splines of the distortion differ
    off = np.abs(found - whole)
    assert off.mean() < 0.02 and np.mean(off > 1) < 0.002 and off.max() < 20


def test_a_part_is_not_larger_than_the_whole(scene: Scene) -> None:
    pose = LinearMotion(views=3).poses(scene.target, np.random.default_rng(1))[1]
    with (
        FrameRenderer(scene_model(scene.to_spec()), CAMERA, "preview") as renderer,
        pytest.raises(InvalidInput, match="a part of 640 x 480"),
    ):
        renderer.render(pose, part=Camera())


@pytest.mark.parametrize("preset", ["vase-and-box", "textured-vase", "glossy-vase"])
def test_a_wall_looks_like_the_sky_box(preset: str, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = load_scene(preset)
    poses = LinearMotion(views=4).poses(scene.target, np.random.default_rng(2))
    frames = []
    for wall in (True, False):
        if not wall:
            monkeypatch.setattr(Backdrop, "of", lambda model: None)
        with FrameRenderer(scene_model(scene.to_spec()), CAMERA, "preview") as renderer:
            frames.append([renderer.render(pose) for pose in poses])
    np.testing.assert_array_equal(frames[0], frames[1])


def test_skies_of_several_colours_stay_boxes(scene: Scene) -> None:
    spec = scene.to_spec()
    assert Backdrop.of(scene_model(spec)) is not None
    spec = scene.to_spec()
    sky = spec.texture("sky")
    sky.builtin, sky.rgb2 = mujoco.mjtBuiltin.mjBUILTIN_GRADIENT, [0.1, 0.2, 0.3]
    assert Backdrop.of(scene_model(spec)) is None
    assert Backdrop.of(mujoco.MjModel.from_xml_string("<mujoco/>")) is None
