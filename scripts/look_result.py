"""What one look at a scene gave."""

from dataclasses import dataclass
from typing import Any

from extremal.estimator import PosePrior, Shape
from extremal.scripts.scoring import Scored
from extremal.sim import Recording


@dataclass(frozen=True, eq=False)
class Look:
    """One look at a scene: what was recorded, what was known of the poses, what was estimated, how it compares, how long it
    took [s]; `settings` are those of result.json."""

    settings: dict[str, Any]
    recording: Recording
    prior: PosePrior
    shape: Shape
    scored: Scored
    timing: dict[str, float]
