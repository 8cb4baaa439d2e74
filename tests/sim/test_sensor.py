"""Noise statistics, saturation and rounding of the sensor."""

import numpy as np
import pytest

from extremal.estimator import Camera, InvalidInput
from extremal.sim import Sensor

SHAPE = (400, 500)
CAMERA = Camera(500, 400)
COUNT = SHAPE[0] * SHAPE[1]


@pytest.mark.parametrize(("noise", "shot"), [(2.0, 0.0), (0.0, 0.05), (1.5, 0.0255)])
@pytest.mark.parametrize("level", [40.3, 200.0])
def test_mean_and_variance(noise: float, shot: float, level: float) -> None:
    frame = np.full(SHAPE, level, np.float32)
    image = Sensor(noise, shot).read(frame, CAMERA, np.random.default_rng(0)).astype(float)
    variance = noise**2 + shot * level + 1 / 12
    assert abs(image.mean() - level) < 5 * np.sqrt(variance / COUNT)
    assert abs(image.var() / variance - 1) < 6 * np.sqrt(2 / COUNT) + 0.002


def test_without_noise_it_rounds_and_saturates() -> None:
    frame = np.tile(np.array([0.0, 10.4, 10.6, 254.9, 300.0, -3.0, 7.0, 8.0], np.float32), (8, 1))
    sensor = Sensor(noise=0)
    assert sensor.read(frame, Camera(8, 8), np.random.default_rng(0))[3].tolist() == [
        0,
        10,
        11,
        255,
        255,
        0,
        7,
        8,
    ]


def test_exposure_scales_the_signal_not_the_noise() -> None:
    frame = np.full(SHAPE, 50, np.float32)
    image = Sensor(2.0, exposure=3.0).read(frame, CAMERA, np.random.default_rng(0)).astype(float)
    assert abs(image.mean() - 150) < 0.05
    assert abs(image.std() - np.sqrt(4 + 1 / 12)) < 0.02


def test_pixels_are_independent() -> None:
    image = Sensor(3.0).read(np.full(SHAPE, 99.0), CAMERA, np.random.default_rng(2)).astype(float) - 99
    for a, b in ((image[1:], image[:-1]), (image[:, 1:], image[:, :-1])):
        assert abs(np.mean(a * b)) / 9 < 5 / np.sqrt(COUNT)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"noise": -1.0}, "noise is -1.0"),
        ({"noise": float("nan")}, "noise is nan"),
        ({"shot": 1e9}, "shot noise"),
        ({"exposure": 0.0}, "exposure is 0.0"),
    ],
)
def test_bad_values_are_named(values: dict[str, float], message: str) -> None:
    with pytest.raises(InvalidInput, match=message):
        Sensor(**values)


def test_gamma_is_undone_by_the_camera_that_knows_it() -> None:
    camera = Camera(500, 400, gamma=2.2)
    light = np.full(SHAPE, 60.0)
    image = Sensor(1.0).read(light, camera, np.random.default_rng(3))
    assert image.mean() == pytest.approx(255 * (60 / 255) ** (1 / 2.2), abs=0.5)
    assert camera.linear(image).mean() == pytest.approx(60.0, abs=0.05)


def test_vignetting_darkens_the_farthest_corner() -> None:
    image = Sensor(0.0, vignetting=0.4).read(np.full(SHAPE, 200.0), CAMERA, np.random.default_rng(0))
    assert image[0, 0] == 120 and image[200, 250] == 200


def test_drift_is_slow_and_stays_within_its_range() -> None:
    sensor = Sensor(exposure_drift=0.05, white_balance_drift=0.02)
    gains = sensor.gains(500, np.random.default_rng(4))
    assert gains.shape == (500, 3)
    assert np.all(np.abs(gains - 1) <= 1.05 * 1.02 - 1 + 1e-12)
    assert np.abs(np.diff(gains, axis=0)).max() < 0.05
    assert gains.std(axis=0).min() > 0.01
    assert np.all(Sensor().gains(5, np.random.default_rng(4)) == 1)


def test_a_frame_of_another_size_is_refused() -> None:
    with pytest.raises(InvalidInput, match=r"frame is \(3, 4\)"):
        Sensor().read(np.zeros((3, 4)), CAMERA, np.random.default_rng(0))
