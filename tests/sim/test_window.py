"""Lens distortion of a rendered image: every point goes where the camera model says, to far below what edges are read to."""

import numpy as np
import pytest

from extremal.sim.cameras import get_camera
from extremal.sim.quality import psf_margin
from extremal.sim.window import Window


@pytest.mark.parametrize(("name", "scale"), [("industrial", 1), ("webcam", 1), ("industrial", 4)])
def test_points_go_where_the_camera_puts_them(name: str, scale: int) -> None:
    """An image whose grey levels are its coordinates reads them out, 1e-3 px exactly in rings as much as anywhere:
    OpenCV's remap rounds places to 1/32 px, in steps that do not average where the distortion changes slowly."""
    camera = get_camera(name).camera
    window = Window.around(camera, scale)
    height, width = window.shape
    rows, columns = np.mgrid[:height, :width].astype(np.float32)
    # sensor pixels of the pinhole image; rows of images start at the bottom
    u = (columns + 0.5) / scale - 0.5 + window.left
    v = (height - 1 - rows + 0.5) / scale - 0.5 + window.top
    seen = np.stack([window.distort(u), window.distort(v)], axis=-1)
    margin = psf_margin(camera.blur)
    y, x = ((np.arange(n) + 0.5) / scale - 0.5 - margin for n in seen.shape[:2])
    chosen = np.ix_(np.arange(5, len(y) - 5, 7), np.arange(5, len(x) - 5, 7))
    sensor = np.stack(np.meshgrid(x, y[::-1]), axis=-1)[chosen]
    expected = camera.normalise(sensor) * (camera.fx, camera.fy) + (camera.cx, camera.cy)
    # float32 coordinates of up to 4 x 700
    np.testing.assert_allclose(seen[chosen], expected, atol=1e-3 / scale + 2e-4)


def test_a_fine_pattern_keeps_its_contrast_and_phase() -> None:
    """A wave of 8 rendered pixels a period, much finer than edges are."""
    camera = get_camera("webcam").camera
    window = Window.around(camera, 2)
    wave = 2 * np.pi / 8 * np.arange(window.shape[1])
    image = np.tile(np.cos(wave), (window.shape[0], 1)).astype(np.float32)
    columns = window._maps[0].astype(float)
    inner = slice(20, -20)
    error = (window.distort(image) - np.cos(2 * np.pi / 8 * columns))[inner, inner]
    assert np.sqrt(np.mean(error**2)) < 5e-3
