"""The image sensor: vignetting, exposure and its drift, shot and read noise, saturation, gamma and 8 bits.

The linear model of EMVA Standard 1288 (release 4.0 Linear, 2021): mu electrons give K mu grey levels with the variance
K^2 (sigma_d^2 + mu) + 1/12. K, the gain, is `shot`; K sigma_d is `noise`; the dark level is subtracted already.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from extremal.estimator.camera import Array, Camera
from extremal.estimator.errors import InvalidInput

DRIFT_STEP = 0.1  # standard deviation of the drift from one frame to the next, of its range to either side


@dataclass(frozen=True)
class Sensor:
    """An 8-bit sensor; light of S grey levels has the variance noise^2 + shot S, and 1/12 (rounding) after gamma.

    Attributes:
        noise: standard deviation of the read noise [grey levels].
        shot: grey levels per photo-electron; shot noise is Poisson's. 0: none. A full well of 10000
            electrons at 255 grey levels is 0.0255.
        exposure: factor on the signal.
        vignetting: fraction of the light that is lost in that corner of the image which is farthest from the principal
            point; elsewhere it goes with the square of the distance from there, the first term of the even
            polynomials of Goldman (2010, IEEE PAMI 32, 2276).
        exposure_drift: largest relative deviation of a frame's exposure.
        white_balance_drift: the same of each of its R, G and B gains on top.
        exposure_time: during which the shutter is open [s].
    """

    noise: float = 2.0
    shot: float = 0.0
    exposure: float = 1.0
    vignetting: float = 0.0
    exposure_drift: float = 0.0
    white_balance_drift: float = 0.0
    exposure_time: float = 0.0

    def __post_init__(self) -> None:
        for name, value in (("noise", self.noise), ("shot noise", self.shot)):
            if not (np.isfinite(value) and 0 <= value <= 255):
                raise InvalidInput(f"sensor {name} is {value!r}; accepted: 0 to 255 grey levels")
        if not (np.isfinite(self.exposure) and 0 < self.exposure <= 1000):
            raise InvalidInput(f"exposure is {self.exposure!r}; accepted: a positive factor up to 1000")
        for name in ("vignetting", "exposure_drift", "white_balance_drift"):
            value = getattr(self, name)
            if not (np.isfinite(value) and 0 <= value <= 0.9):
                raise InvalidInput(f"sensor {name} is {value!r}; accepted: a fraction from 0 to 0.9")
        if not (np.isfinite(self.exposure_time) and 0 <= self.exposure_time <= 10):
            raise InvalidInput(f"exposure time is {self.exposure_time!r}; accepted: 0 to 10 s")

    @classmethod
    def from_data_sheet(cls, full_well: float, read_noise: float, **others: float) -> "Sensor":
        """A sensor whose full well [electrons] gives 255 grey levels, with its read noise [electrons], and other attributes."""
        if not (np.isfinite(full_well) and full_well >= 1):
            raise InvalidInput(f"sensor full well is {full_well!r}; accepted: at least 1 electron")
        return cls(noise=255 / full_well * read_noise, shot=255 / full_well, **others)

    def gains(self, views: int, rng: np.random.Generator) -> Array:
        """Relative gains (views, 3) of R, G and B in each frame: a slow random walk between walls that reflect it.

        It starts anywhere between them, so that all frames are alike; the exposure is common to all three. Always draws
        as much from `rng`.
        """
        walk = rng.uniform(-1, 1, 4) + np.cumsum(DRIFT_STEP * rng.standard_normal((views, 4)), axis=0)
        reflected = 1 - np.abs((walk + 1) % 4 - 2)  # in -1..1
        exposure = 1 + self.exposure_drift * reflected[:, :1]
        return exposure * (1 + self.white_balance_drift * reflected[:, 1:])

    def read(self, frame: Array, camera: Camera, rng: np.random.Generator) -> NDArray[np.uint8]:
        """The frame (height, width) as the sensor delivers it, from light without noise in 0..255 grey levels.

        Raises:
            InvalidInput: the frame has not the camera's size.
        """
        if np.shape(frame) != (camera.height, camera.width):
            raise InvalidInput(f"frame is {np.shape(frame)}; accepted: {(camera.height, camera.width)}")
        signal = self.exposure * np.asarray(frame, np.float32)
        if self.vignetting > 0:
            signal *= self._illumination(camera)
        if self.shot > 0:
            signal = (self.shot * rng.poisson(np.maximum(signal, 0) / self.shot)).astype(np.float32)
        if self.noise > 0:
            signal += self.noise * rng.standard_normal(signal.shape, np.float32)
        return camera.encode(signal)

    def _illumination(self, camera: Camera) -> NDArray[np.float32]:
        """Relative illumination (height, width) of the image: 1 at the principal point."""
        x2 = (np.arange(camera.width) - camera.cx) ** 2
        y2 = (np.arange(camera.height) - camera.cy)[:, None] ** 2
        return (1 - self.vignetting * (x2 + y2) / (x2.max() + y2.max())).astype(np.float32)
