"""Sensors by name."""

from dataclasses import replace

from extremal.estimator.errors import InvalidInput
from extremal.sim import Sensor
from extremal.tasks.edge_model import EdgeModel
from extremal.tasks.features import FeatureSensor
from extremal.tasks.geometric import GeometricSensor
from extremal.tasks.rendered import RenderedSensor

SENSORS = ("geometric", "rendered")
LEAST = 1e-4  # [px] of edge noise


def make_sensor(name: str, edge_noise: float = 1.0) -> FeatureSensor:
    """A sensor whose noise is `edge_noise` times the usual; InvalidInput for an unknown name."""
    if name == "geometric":
        usual = EdgeModel()
        noise = {
            name: max(edge_noise * getattr(usual, name), LEAST)
            for name in ("sigma_px", "fixed_sigma_px", "bias_px")
        }
        return GeometricSensor(replace(usual, **noise))
    if name == "rendered":
        return RenderedSensor(sensor=Sensor(edge_noise * Sensor().noise))
    raise InvalidInput(f"sensor is {name!r}; accepted: {', '.join(SENSORS)}")
