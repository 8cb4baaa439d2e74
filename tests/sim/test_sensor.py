"""Noise statistics, saturation and rounding of the sensor."""

import numpy as np
import pytest

from extremal.estimator import InvalidInput
from extremal.sim import Sensor

SHAPE = (400, 500)
COUNT = SHAPE[0] * SHAPE[1]


@pytest.mark.parametrize(("noise", "shot"), [(2.0, 0.0), (0.0, 0.05), (1.5, 0.0255)])
@pytest.mark.parametrize("level", [40.3, 200.0])
def test_mean_and_variance(noise: float, shot: float, level: float) -> None:
    frame = np.full(SHAPE, level, np.float32)
    image = Sensor(noise, shot).read(frame, np.random.default_rng(0)).astype(float)
    variance = noise**2 + shot * level + 1 / 12
    assert abs(image.mean() - level) < 5 * np.sqrt(variance / COUNT)
    assert abs(image.var() / variance - 1) < 6 * np.sqrt(2 / COUNT) + 0.002


def test_without_noise_it_rounds_and_saturates() -> None:
    frame = np.array([[0.0, 10.4, 10.6, 254.9, 300.0, -3.0]], np.float32)
    sensor = Sensor(noise=0)
    assert sensor.read(frame, np.random.default_rng(0)).tolist() == [[0, 10, 11, 255, 255, 0]]


def test_exposure_scales_the_signal_not_the_noise() -> None:
    frame = np.full(SHAPE, 50, np.float32)
    image = Sensor(2.0, exposure=3.0).read(frame, np.random.default_rng(0)).astype(float)
    assert abs(image.mean() - 150) < 0.05
    assert abs(image.std() - np.sqrt(4 + 1 / 12)) < 0.02


def test_pixels_are_independent() -> None:
    image = Sensor(3.0).read(np.full(SHAPE, 99.0), np.random.default_rng(2)).astype(float) - 99
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
