"""A trial that looks: rendered frames to curvature, beside the truth, as `extremal look` does it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from extremal.scenes import load_scene, randomised
from extremal.scripts.look import LookSettings, take_look
from extremal.scripts.scoring import Scored
from extremal.scripts.sweep_trials import Value

WITHHELD = ("seed", "rerun", "out")
FILES = ("scene", "calibration")


@dataclass(frozen=True)
class Settings(LookSettings):
    """What `extremal look` takes, and: `vary`, whether every trial has a random variation of the scene."""

    vary: bool = False


def run(settings: Settings, seed: int) -> Mapping[str, Value]:
    """Over the points of one look: medians of |R error| and sigma on extremal boundaries [m], shares of errors within 1.96 sigma
    on both kinds, share of right labels, numbers of points."""
    scene = load_scene(settings.scene)
    if settings.vary:
        scene = randomised(scene, np.random.default_rng([seed, 4]))
    calibration = Path(settings.calibration) if settings.calibration else None  # a text in TOML
    look = take_look(scene, replace(settings, seed=seed, calibration=calibration), workers=1)
    return _results(look.scored)


def _results(scored: Scored) -> dict[str, Value]:
    error = np.abs(scored.column("radius_m") - scored.column("true_radius_m"))
    sigma, truth = scored.column("sigma_radius_m"), scored.column("true_label")
    inside, right = error < 1.96 * sigma, scored.column("label") == truth
    extremal, fixed = truth == "extremal", truth == "fixed"
    return {
        "points": len(error),
        "extremal_points": int(extremal.sum()),
        "fixed_points": int(fixed.sum()),
        "extremal_error_m": _of(np.nanmedian, error[extremal]),
        "extremal_sigma_m": _of(np.nanmedian, sigma[extremal]),
        "extremal_covered": _of(np.mean, inside[extremal]),
        "fixed_covered": _of(np.mean, inside[fixed]),
        "label_right": _of(np.mean, right[extremal | fixed]),
    }


def _of(statistic: Callable[[np.ndarray], np.floating], values: np.ndarray) -> float | None:
    return float(statistic(values)) if np.isfinite(values).any() else None
