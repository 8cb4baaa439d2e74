"""Errors of edges in images, as the vision pipeline makes them: for sensors that render no images."""

import math
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from extremal.estimator.camera import Array
from extremal.estimator.errors import InvalidInput
from extremal.tasks.compiled import compiled


@dataclass(frozen=True)
class EdgeModel:
    """Errors of tracked points of true edges across the edge, independent from track to track.

        error(view) = noise + bias(view), or that of a false edge; or the edge is not found at all

    Noise is drawn anew in every view. The bias is what models of shading leave: normal, and alike in views that lie close
    together, with the correlation exp(-turn / bias_turn) after the line of sight has turned.

    The defaults are what `scripts/sensor_study.py` fits to frames of quality `preview` (640 x 480, 2 grey levels of noise) of
    20 random vases and boxes, an ellipsoid and a sphere, 25 irregular steps over 0.3 m at 0.55 m: nearest edgels of the pipeline
    against exact contacts of tracks, false edges and dropouts counted, noise and bias of the median track by the covariance
    between its views. Most of the noise is the coarse sampling of that quality.

    Attributes:
        sigma_px: standard deviation of the noise of limbs, fixed_sigma_px: of fixed edges [px]. bias_px: of the bias [px]. bias_turn: [rad].
        dropout: probability that an edge is not found in a view. outlier: that another edge is taken for it.
        outlier_px: standard deviation of the offset of such an edge [px].
    """

    sigma_px: float = 0.026
    bias_px: float = 0.009
    bias_turn: float = 0.2
    dropout: float = 0.012
    outlier: float = 0.017
    outlier_px: float = 0.54
    fixed_sigma_px: float = 0.066

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            most, least = (1.0 if field.name in ("dropout", "outlier") else 100.0), 0.0
            if field.name in ("sigma_px", "fixed_sigma_px", "bias_turn"):
                least = 1e-6
            if not least <= value <= most:
                raise InvalidInput(f"{field.name} of edges is {value!r}; accepted: {least:g} to {most:g}")

    @property
    def either_px(self) -> float:
        """Standard deviation [px] of the noise of an edge that may be a limb or fixed, which no sensor knows."""
        return math.hypot(self.sigma_px, self.fixed_sigma_px) / math.sqrt(2)

    def first_bias(self, tracks: int, rng: np.random.Generator) -> Array:
        """Biases (tracks,) [px] of tracks that start."""
        return self.bias_px * rng.standard_normal(tracks)

    def next_bias(self, bias: Array, turn: float, rng: np.random.Generator) -> Array:
        """Biases (n,) [px] after the line of sight has turned [rad]."""
        kept = math.exp(-turn / self.bias_turn)
        return kept * bias + (self.bias_px * math.sqrt(1 - kept * kept)) * rng.standard_normal(len(bias))

    def noise(self, fixed: NDArray[np.bool_]) -> Array:
        """Standard deviations (n,) [px] of edges that are `fixed` or not."""
        return np.where(fixed, self.fixed_sigma_px, self.sigma_px)

    def draw(self, bias: Array, noise: Array, rng: np.random.Generator) -> tuple[Array, NDArray[np.bool_]]:
        """Errors (n,) [px] of one view, of biases and sigma of the noise (n,) [px], and whether (n,) the edges are found. Always draws as much from `rng`."""
        normal, chance = rng.standard_normal((2, len(bias))), rng.random((2, len(bias)))
        return _drawn(bias, noise, normal, chance, self.outlier, self.outlier_px, self.dropout)


@compiled
def _drawn(
    bias: Array, noise: Array, normal: Array, chance: Array, outlier: float, outlier_px: float, dropout: float
) -> tuple[Array, NDArray[np.bool_]]:
    """What `EdgeModel.draw` makes of normal and uniform numbers (2, n)."""
    error, found = np.empty(len(bias)), np.empty(len(bias), np.bool_)
    for i in range(len(bias)):
        error[i] = outlier_px * normal[1, i] if chance[0, i] < outlier else bias[i] + noise[i] * normal[0, i]
        found[i] = chance[1, i] >= dropout
    return error, found


PREVIEW = EdgeModel()
