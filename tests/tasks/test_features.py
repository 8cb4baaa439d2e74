"""The value type of features, and the rules by which sets of tracks take turns."""

from dataclasses import replace

import numpy as np
import pytest

from extremal.estimator import InvalidInput
from extremal.estimator.camera import Array
from extremal.tasks.features import Features, Radii, labelled
from extremal.tasks.track_sets import FARTHEST_TURN, PoseRoots, TrackSets, first_baseline, travel_of


def some(n: int, visible: float = 1.0) -> Features:
    """n features around the origin, of which a share is visible."""
    radius, sigma = np.linspace(-0.03, 0.03, n), np.full(n, 0.005)
    radii, at = Radii(radius, sigma), (np.zeros((n, 3)), np.zeros((n, 3, 3)))
    normal, count = np.tile([1.0, 0, 0], (n, 1)), np.arange(n)
    seen = np.arange(n) < visible * n
    return labelled(
        radii, None, *at, normal, normal, np.zeros(n, bool), count // 2, np.zeros((n, 2)), seen, count
    )


def test_radii_are_positive_about_the_normals() -> None:
    told = some(7)
    assert np.all(told.radius >= 0) and np.all(told.best_radius >= 0)
    np.testing.assert_array_equal(np.sign(told.normal[:, 0]), [-1, -1, -1, 1, 1, 1, 1])
    np.testing.assert_array_equal(told.extremal, np.abs(np.linspace(-0.03, 0.03, 7)) > 1.96 * 0.005)
    np.testing.assert_allclose(told.significance, told.radius / 0.005)
    assert np.all(np.isinf(told.sigma_relative)) and np.all(np.isnan(told.relative_radius))


def test_relative_radii_decide_where_there_are_references() -> None:
    n = 3
    free, at = Radii(np.array([0.02, 0.02, 0.02]), np.full(n, 0.02)), (np.zeros((n, 3)), np.zeros((n, 3, 3)))
    held = replace(free, radius=np.array([-0.03, 0.0, 0.03]), sigma=np.full(n, 0.001))
    normal, no = np.tile([1.0, 0, 0], (n, 1)), np.zeros(n, bool)
    told = labelled(free, held, *at, normal, normal, no, np.arange(n), np.zeros((n, 2)), ~no, np.ones(n, int))
    np.testing.assert_array_equal(told.extremal, [True, False, True])
    np.testing.assert_allclose(told.best_radius, [0.03, 0, 0.03])
    np.testing.assert_allclose(told.radius, [-0.02, 0.02, 0.02])  # about the normal that is believed


def test_refused() -> None:
    with pytest.raises(InvalidInput, match="position of features"):
        replace(some(3), position=np.zeros((2, 3)))
    with pytest.raises(InvalidInput, match="sigma_radius"):
        replace(some(3), sigma_radius=np.array([1.0, np.nan, 1.0]))
    with pytest.raises(InvalidInput, match="pose covariance"):
        PoseRoots().of(np.full((6, 6), np.nan))


def test_together() -> None:
    both = some(4).and_then(some(6).left())
    assert len(both) == 10 and both.visible.sum() == 4
    assert len(np.unique(both.contour)) == 5
    assert len(Features.empty().and_then(some(4))) == len(some(4).and_then(Features.empty())) == 4


class Scripted:
    """Tracks that start with the third look, and lose sight when told so."""

    share = 1.0

    def __init__(self) -> None:
        self.looks = 0

    @property
    def started(self) -> bool:
        return self.looks >= 3

    def take_in(self, look: int) -> None:
        self.looks += 1

    def features(self) -> Features:
        return some(8, self.share)


def circling(turn: float, looks: int, start: float = 0.0) -> Array:
    angle = start + np.linspace(0, turn, looks)
    return np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)


def test_sets_take_turns_as_the_camera_goes_round() -> None:
    sets = TrackSets(Scripted, 1e-3)
    sizes = [len(sets.take_in(0, c)) for c in circling(0.98 * FARTHEST_TURN, 20)]
    assert sizes[:2] == [0, 0] and set(sizes[2:]) == {8}
    sizes = [len(sets.take_in(0, c)) for c in circling(0.2, 6, FARTHEST_TURN)]
    assert sizes[:2] == [8, 8] and sizes[-1] == 16  # the old ones stay
    assert sets.features.visible.sum() == 8


def test_sets_take_turns_when_sight_is_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    sets = TrackSets(Scripted, 1e-3)
    for c in circling(0.1, 5):
        sets.take_in(0, c)
    monkeypatch.setattr(Scripted, "share", 0.1)
    sizes = [len(sets.take_in(0, c)) for c in circling(0.1, 4, 0.2)]
    assert sizes == [8, 8, 16, 16]


def test_a_set_without_tracks_takes_no_place(monkeypatch: pytest.MonkeyPatch) -> None:
    sets = TrackSets(Scripted, 1e-3)
    for c in circling(0.1, 5):
        sets.take_in(0, c)
    old = Scripted.features
    monkeypatch.setattr(
        Scripted, "features", lambda self: some(8, 0.1) if self.looks > 5 else Features.empty()
    )
    sizes = [len(sets.take_in(0, c)) for c in circling(0.1, 7, 0.2)]
    assert sizes == [8] * 7
    monkeypatch.setattr(Scripted, "features", old)
    sizes = [len(sets.take_in(0, c)) for c in circling(0.1, 3, 0.4)]
    assert sizes[-1] == 16


def test_looks_from_the_same_place_are_left_out() -> None:
    sets = TrackSets(Scripted, 0.01)
    here = np.array([1.0, 0, 0])
    assert sets.is_new(here)
    sets.take_in(0, here)
    assert not sets.is_new(here + 0.005) and sets.is_new(here + 0.01)


def test_baselines_and_travel() -> None:
    assert first_baseline(np.zeros((6, 6))) == first_baseline(1e-6 * np.eye(6)) * 0 + 0.02
    assert first_baseline(9e-6 * np.eye(6)) == pytest.approx(0.045)
    line = np.outer(np.linspace(0, 1, 5), [0, -1.0, 0])
    np.testing.assert_allclose(travel_of(line), [0, -1, 0], atol=1e-12)
