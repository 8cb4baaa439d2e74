"""Rendered frames against exact contours: pixel convention, silhouettes of the presets, qualities, distortion."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.special import ndtr
from silhouette import Edges, backlit, silhouette_edges

from extremal.estimator import Camera, InvalidInput, RenderingError
from extremal.scenes import Lathe, Scene, load_scene
from extremal.sim import FrameRenderer, LinearMotion, Quality
from extremal.sim.quality import QUALITIES, get_quality, psf_margin, sampling_matrix

PRESETS = ("vase-and-box", "sphere", "ellipsoid", "waisted-vase", "textured-vase", "glossy-vase")


def edges_of(scene: Scene, camera: Camera, quality: str | Quality, seed: int = 1, view: int = 1) -> Edges:
    black, model = backlit(scene)
    pose = LinearMotion(views=3).poses(scene.target, np.random.default_rng(seed))[view]
    with FrameRenderer(model, camera, quality) as renderer:
        frame = renderer.render(pose)
    return silhouette_edges(black, camera, pose, frame)


@pytest.fixture(scope="module")
def leaning() -> Scene:
    """A vase that leans by 45 degrees, so that its contour measures both image axes."""
    vase = load_scene("waisted-vase")["vase"]
    assert isinstance(vase, Lathe)
    pose = RigidTransform.from_components([0, -0.07, 0.03], Rotation.from_rotvec([-np.pi / 4, 0, 0]))
    return Scene(objects=(replace(vase, T_world_object=pose, markings=()),))


@pytest.mark.parametrize(
    "camera",
    [
        Camera(),
        pytest.param(
            Camera(width=501, height=379, fx=760.0, fy=840.0, cx=271.3, cy=170.6), marks=pytest.mark.slow
        ),
        Camera(width=640, height=481, fx=812.0, fy=700.0, cx=290.2, cy=255.9, blur=0.6),
    ],
)
def test_pixel_zero_is_the_centre_of_the_top_left_pixel(leaning: Scene, camera: Camera) -> None:
    edges = edges_of(leaning, camera, "metrology")
    assert len(edges.offsets) > 1000
    assert np.abs(edges.shift).max() < 0.003
    assert abs(edges.offsets.mean()) < 0.003


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=() if name in ("waisted-vase", "sphere") else pytest.mark.slow)
        for name in PRESETS
    ],
)
def test_silhouette_of_the_preset(name: str) -> None:
    edges = edges_of(load_scene(name), Camera(), "metrology")
    assert len(edges.offsets) > 300
    assert np.abs(edges.offsets).mean() < 0.004
    assert abs(edges.offsets.mean()) < 0.002
    assert np.abs(edges.shift).max() < 0.004


@pytest.mark.slow
@pytest.mark.parametrize("name", PRESETS)
@pytest.mark.parametrize(("quality", "limit"), [("preview", 0.07), ("standard", 0.007), ("metrology", 0.004)])
def test_silhouettes_at_both_ends_of_the_path(name: str, quality: str, limit: float) -> None:
    for view in (0, 2):
        edges = edges_of(load_scene(name), Camera(), quality, view=view)
        assert np.abs(edges.offsets).mean() < limit


@pytest.mark.slow
def test_each_quality_samples_more_finely(leaning: Scene) -> None:
    rms = {name: np.sqrt(np.mean(edges_of(leaning, Camera(), name).offsets ** 2)) for name in QUALITIES}
    assert rms["preview"] < 0.08
    assert rms["standard"] < 0.15 * rms["preview"]
    assert rms["metrology"] < 0.7 * rms["standard"]


@pytest.mark.parametrize("quality", ["standard", pytest.param("metrology", marks=pytest.mark.slow)])
def test_lens_distortion(leaning: Scene, quality: str) -> None:
    camera = Camera(fx=700.0, cx=305.0, distortion=(-0.25, 0.1, 0.002, -0.003, 0.02))
    edges = edges_of(leaning, camera, quality)
    assert len(edges.offsets) > 1000
    assert np.abs(edges.offsets).max() < 0.05
    assert np.abs(edges.offsets).mean() < 0.01
    assert np.abs(edges.shift).max() < 0.004


@pytest.mark.parametrize("blur", [0.3, 0.7, 1.5])
@pytest.mark.parametrize("scale", [1, 4])
def test_psf_is_a_gaussian_with_the_pixels_box(blur: float, scale: int) -> None:
    """A Gaussian blob, averaged over rendered pixels, against its closed form on the sensor."""
    size, margin, centre, width = 40, psf_margin(blur), 19.37, 2.0
    edges = (np.arange(scale * (size + 2 * margin) + 1)) / scale - 0.5 - margin
    fine = np.diff(ndtr((edges - centre) / width)) * scale
    total = np.hypot(width, blur)
    expected = np.diff(ndtr((np.arange(size + 1) - 0.5 - centre) / total))
    found = sampling_matrix(size, scale, blur) @ fine.astype(np.float32)
    # A Gaussian narrower than half a rendered pixel is only right in its variance.
    error = np.abs(found - expected).max() / expected.max()
    assert error < (1e-3 if scale == 1 else 1e-4)


def test_sampling_matrix_keeps_grey_levels() -> None:
    for blur in (0.0, 0.05, 0.2, 0.7, 3.0):
        for scale in (1, 3, 4):
            rows = sampling_matrix(21, scale, blur).sum(axis=1)
            np.testing.assert_allclose(rows, 1, atol=1e-6)


@pytest.mark.parametrize("passes", [1, 3, 5, 7])
def test_passes_and_msaa_samples_fill_the_pixel_evenly(passes: int) -> None:
    offsets = Quality("q", 4, passes).offsets
    np.testing.assert_allclose(offsets.sum(axis=0), 0, atol=1e-12)
    msaa = np.array([-0.375, -0.125, 0.125, 0.375])
    for axis in range(2):
        places = np.sort((offsets[:, axis, None] + msaa).ravel())
        np.testing.assert_allclose(np.diff(places), 1 / (4 * passes))


def test_black_and_white_are_exact_and_frames_repeat(leaning: Scene) -> None:
    black, model = backlit(leaning)
    pose = LinearMotion().poses(black.target, np.random.default_rng(0))[3]
    frames = []
    for _ in range(2):
        with FrameRenderer(model, Camera(), "preview") as renderer:
            frames += [renderer.render(pose), renderer.render(pose)]
    assert all(frame.tobytes() == frames[0].tobytes() for frame in frames)
    assert frames[0].dtype == np.float32 and frames[0].shape == (480, 640)
    assert frames[0].max() == pytest.approx(255, abs=1e-3)
    assert frames[0].min() == pytest.approx(0, abs=1e-3)
    # Up to the border: what lies beyond it is rendered too.
    np.testing.assert_allclose(frames[0][0], 255, atol=1e-3)
    np.testing.assert_allclose(frames[0][:, -1], 255, atol=1e-3)


def test_bad_input(leaning: Scene) -> None:
    _, model = backlit(leaning)
    pose = RigidTransform.identity()
    with pytest.raises(RenderingError, match="closed"):
        FrameRenderer(model, Camera(), "preview").render(pose)
    with FrameRenderer(model, Camera(), "preview") as renderer, pytest.raises(InvalidInput, match="finite"):
        renderer.render(RigidTransform.from_translation([np.nan, 0, 0]))
    with pytest.raises(InvalidInput, match="16384"):
        FrameRenderer(model, Camera(width=8000), "standard")
    with pytest.raises(InvalidInput, match="can't be inverted"):
        FrameRenderer(model, Camera(fx=100.0, distortion=(-2.0, 0, 0, 0, 0)), "preview")
    with pytest.raises(InvalidInput, match="preview, standard, metrology"):
        get_quality("best")
    with pytest.raises(InvalidInput, match="odd"):
        Quality("even", 4, 4)
