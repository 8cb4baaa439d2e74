"""The image sensor: exposure, shot noise, read noise, saturation and 8-bit quantisation."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from extremal.estimator.camera import Array
from extremal.estimator.errors import InvalidInput


@dataclass(frozen=True)
class Sensor:
    """A monochrome 8-bit sensor; a signal of S grey levels has the variance noise^2 + shot S (+ 1/12, rounding).

    Attributes:
        noise: standard deviation of the read noise [grey levels].
        shot: grey levels per photo-electron; shot noise is Poisson's. 0: none. A full well of 10000
            electrons at 255 grey levels is 0.0255.
        exposure: factor on the signal.
    """

    noise: float = 2.0
    shot: float = 0.0
    exposure: float = 1.0

    def __post_init__(self) -> None:
        for name, value in (("noise", self.noise), ("shot noise", self.shot)):
            if not (np.isfinite(value) and 0 <= value <= 255):
                raise InvalidInput(f"sensor {name} is {value!r}; accepted: 0 to 255 grey levels")
        if not (np.isfinite(self.exposure) and 0 < self.exposure <= 1000):
            raise InvalidInput(f"exposure is {self.exposure!r}; accepted: a positive factor up to 1000")

    def read(self, frame: Array, rng: np.random.Generator) -> NDArray[np.uint8]:
        """The frame (H, W) as the sensor delivers it, from grey levels without noise (H, W) in 0..255."""
        signal = self.exposure * np.asarray(frame, np.float32)
        if self.shot > 0:
            signal = (self.shot * rng.poisson(np.maximum(signal, 0) / self.shot)).astype(np.float32)
        if self.noise > 0:
            signal = signal + self.noise * rng.standard_normal(signal.shape, np.float32)
        return np.clip(np.rint(signal), 0, 255).astype(np.uint8)
