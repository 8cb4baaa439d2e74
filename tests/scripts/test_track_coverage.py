"""How much of a scene is tracked, and how much that is not there."""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from extremal.scripts.track_coverage import track_coverage

if TYPE_CHECKING:
    from conftest import Taken


def test_most_is_tracked_and_next_to_nothing_is_invented(taken: "Taken") -> None:
    coverage = track_coverage(taken.look.shape, taken.look.recording, taken.scene)
    assert coverage.complete >= 0.8
    assert coverage.complete <= coverage.any <= 1
    assert coverage.transversal >= 0.8
    assert coverage.false <= 0.02


def test_tracks_that_end_early_are_not_complete(taken: "Taken") -> None:
    shape = replace(taken.look.shape, complete=np.zeros_like(taken.look.shape.complete))
    coverage = track_coverage(shape, taken.look.recording, taken.scene)
    assert coverage.complete == coverage.transversal == 0
    assert coverage.any >= 0.8


def test_points_beside_the_edges_are_false(taken: "Taken") -> None:
    """A shift by 20 px to the side leaves few points within 1 px of another edge by chance."""
    shape = replace(taken.look.shape, pixels=np.add(taken.look.shape.pixels, [20.0, 0.0]))
    assert track_coverage(shape, taken.look.recording, taken.scene).false > 0.3
