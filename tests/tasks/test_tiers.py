"""Tiers: names, seed splits, options, and what their calibration presets combine."""

import re
from typing import Any

import numpy as np
import pytest

from extremal.estimator.errors import InvalidInput
from extremal.tasks.tiers import TEST_SEEDS, TIERS, TRAIN_SEEDS, get_tier

STANDARD = TIERS["standard-v0"]


def test_tiers_are_named_and_versioned_and_seed_splits_are_disjoint() -> None:
    assert all(name == tier.name and re.fullmatch(r"[a-z-]+-v\d+", name) for name, tier in TIERS.items())
    assert not set(TRAIN_SEEDS) & set(TEST_SEEDS)
    assert len(TEST_SEEDS) >= 300 and min(TRAIN_SEEDS[0], TEST_SEEDS[0]) >= 0
    assert get_tier("noisy-v0") is TIERS["noisy-v0"]
    with pytest.raises(InvalidInput, match=r"'easy'.*standard-v0.*cluttered-v0"):
        get_tier("easy")


def test_options_replace_fields_by_name() -> None:
    tier = STANDARD.with_options({"clutter": 2, "families": "cone", "arm_bias": "poor"})
    assert (tier.clutter, tier.families, tier.arm_bias, tier.arm_noise) == (2, ("cone",), "poor", "typical")
    assert tier.name.startswith("standard-v0+") and STANDARD.with_options({}) is STANDARD
    assert STANDARD.with_options(None) is STANDARD


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"colour": 1}, "'colour'; accepted: families, arm_bias"),
        ({"name": "x"}, "'name'; accepted"),
        ({"families": ("cone", "pot")}, "'pot'; accepted: barrel"),
        ({"families": ()}, "families is"),
        ({"arm_bias": "good"}, "'good'; accepted: ideal"),
        ({"arm_noise": None}, "accepted: ideal"),
        ({"edge_noise": -1}, "edge_noise is -1"),
        ({"edge_noise": np.nan}, "edge_noise is nan"),
        ({"edge_noise": "high"}, "edge_noise is 'high'"),
        ({"crease": "maybe"}, "crease is 'maybe'; accepted: present, absent, decoy"),
        ({"appearance": "shiny"}, "appearance is 'shiny'; accepted: textureless"),
        ({"clutter": 2.5}, "clutter is 2.5"),
        ({"clutter": 100}, "clutter is 100"),
        ({"clutter": True}, "clutter is True"),
        ({"crease": "decoy", "families": "ellipsoid"}, "with a decoy"),
    ],
)
def test_options_that_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidInput, match=re.escape(message)):
        STANDARD.with_options(options)
