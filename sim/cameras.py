"""Cameras by name: an ideal one, one for machine vision, and a webcam.

| | ideal | industrial | webcam |
|---|---|---|---|
| lens | no distortion | -4 px at the corners | -21 px |
| blur [px] | 0.7 | 0.7 | 0.9 |
| full well, read noise [electrons] | - (2 grey levels) | 32691, 6.83 | 4000, 8 |
| sd of noise at 20, 200 grey levels | 2.0, 2.0 | 0.4, 1.2 | 1.2, 3.6 |
| vignetting at the corners | - | 10 % | 35 % |
| drift of exposure, of each colour | - | 0.5 %, - | 4 %, 2 % |
| gamma | 1 | 1 | 2.2 |
| exposure time [ms] | 0 | 2 | 20 |

The industrial one has the sensor Sony IMX174, of which EMVA 1288 data sheets are published; the webcam has the lens that Zhang
(2000, IEEE PAMI 22, 1330, table 1, five images) calibrated, and noise, vignetting and drift of an order that is common.
"""

from dataclasses import dataclass
from typing import Literal

from extremal.estimator.camera import Camera
from extremal.estimator.errors import InvalidInput
from extremal.sim.sensor import Sensor


@dataclass(frozen=True)
class CameraPreset:
    """A kind of camera: its geometry and blur, and its sensor."""

    name: str
    camera: Camera
    sensor: Sensor


_INDUSTRIAL = CameraPreset(
    "industrial",
    Camera(fx=804.2, fy=803.7, cx=322.8, cy=236.4, distortion=(-0.05, 0.06, 0.0004, -0.0003, 0.0), blur=0.7),
    Sensor.from_data_sheet(32691, 6.83, vignetting=0.10, exposure_drift=0.005, exposure_time=0.002),
)
_WEBCAM = CameraPreset(
    "webcam",
    Camera(
        fx=832.5,
        fy=832.53,
        cx=303.96,
        cy=206.59,
        distortion=(-0.2286, 0.1904, 0.0, 0.0, 0.0),
        blur=0.9,
        gamma=2.2,
    ),
    Sensor.from_data_sheet(
        4000, 8, vignetting=0.35, exposure_drift=0.04, white_balance_drift=0.02, exposure_time=0.02
    ),
)
CameraName = Literal["ideal", "industrial", "webcam"]
CAMERAS = {
    preset.name: preset for preset in (CameraPreset("ideal", Camera(), Sensor()), _INDUSTRIAL, _WEBCAM)
}


def get_camera(name: str) -> CameraPreset:
    """A camera by its name; InvalidInput lists the names."""
    if not isinstance(name, str) or name not in CAMERAS:
        raise InvalidInput(f"camera is {name!r}; accepted: {', '.join(CAMERAS)}")
    return CAMERAS[name]
