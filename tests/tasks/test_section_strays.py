"""Matches of other contours, against the normal errors that they are told from; and what is added for circles that do not fit."""

import numpy as np
import pytest

from extremal.estimator.camera import Array
from extremal.estimator.poses import pose_exp
from extremal.estimator.sequential import _slid
from extremal.tasks.edge_contrasts import EdgeContrasts
from extremal.tasks.edge_model import PREVIEW
from extremal.tasks.features import Features
from extremal.tasks.section_misfit import LEAST_LOOKS, PIECES, repeated
from extremal.tasks.section_strays import strays
from extremal.tasks.section_tracks import SectionTracks

CONTOUR = np.repeat(np.arange(5), [8, 8, 8, 8, 6])
M = len(CONTOUR)


class Look:
    """Matches of one look under the errors of a pose, a few pixels large, and of what is not known of the sections."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.X, self.O = rng.normal(size=(M, 3)), 30 * rng.normal(size=(M, 6))
        root = 0.4 * rng.normal(size=(3 * M, 3 * M)) / np.sqrt(M)
        self.covariance = (root @ root.T).reshape(M, 3, M, 3)
        theta = (root @ rng.standard_normal(3 * M)).reshape(M, 3)
        self.r = np.sum(self.X * theta, axis=1) + self.O @ rng.standard_normal(6) + rng.standard_normal(M)

    def strays(self, r: Array) -> np.ndarray:
        return strays(self.X, self.O, r, self.covariance, np.ones(M), np.full(M, 0.5), CONTOUR)


def test_matches_that_are_right_stay() -> None:
    looks = 200
    out = sum(int(look.strays(look.r).sum()) for look in map(Look, range(looks)))
    assert out < 2e-3 * M * looks


def test_single_matches_and_whole_contours_go() -> None:
    """One that is off by 14 standard deviations of an edge, and a contour of which all are off alike: one by one, they agree."""
    for seed in range(40):
        look = Look(seed)
        for wrong in (np.arange(M) == seed % M, seed % 4 == CONTOUR):
            out = look.strays(look.r + 14 * wrong)
            assert np.all(out[wrong])
            assert np.sum(out & ~wrong) <= 2


def test_contours_that_are_off_by_little_go_where_single_matches_stay() -> None:
    """Alike by 3 standard deviations of an edge, where what is known of sections and poses leaves as little open."""
    found = np.zeros((40, 2), bool)
    for seed in range(40):
        look = Look(seed)
        look.covariance = 0.01 * look.covariance
        off = 3.0 * (seed % 4 == CONTOUR)
        noise = np.random.default_rng([7, seed]).standard_normal(M)
        wrong = np.flatnonzero(off)
        found[seed, 0] = np.all(look.strays(noise + off)[wrong])
        found[seed, 1] = look.strays(noise + off * (np.arange(M) == wrong[0]))[wrong[0]]
    assert found[:, 0].mean() > 0.9 and found[:, 1].mean() < 0.5


def test_half_of_the_matches_stay_whatever_they_say() -> None:
    look = Look(0)
    out = look.strays(look.r + 100 * np.random.default_rng(1).normal(size=M))
    assert 0 < out.sum() <= 0.5 * M + 8  # by whole contours


def test_fixed_edges_keep_their_contrast() -> None:
    """Other ones are not taken in, until the edge is back; of limbs, and where light changes slowly, all is; NaN is not seen."""
    known = EdgeContrasts(4)
    fixed = np.array([True, True, True, False])
    usual = np.array([50.0, -30.0, 80.0, 60.0])
    assert not known.changed(np.where(np.arange(4) == 2, np.nan, usual), fixed).any()
    for k in range(10):
        seen = usual * [1.0, 1.0 + 0.02 * k, 1.0, 1.5]
        np.testing.assert_array_equal(
            known.changed(seen * [1.3, 1, 1, 1], fixed), [True, False, False, False]
        )
    assert not known.changed(usual * [1.0, 1.18, 1.0, 1.5], fixed).any()
    np.testing.assert_array_equal(known.changed(-usual, fixed), [True, True, True, False])


def test_misfits_and_errors_that_repeat() -> None:
    """Of normal errors next to nothing is added; a misfit is added as often as it repeats; false edges count for little."""
    rng, looks, n, sigma = np.random.default_rng(2), 60, 300, 1e-4
    sigmas = np.full((looks, n), sigma)
    sigmas[::7] = np.inf
    seen = looks - len(range(0, looks, 7))
    first, last = np.zeros(n), np.full(n, 0.3)
    noise = sigma * rng.standard_normal((looks, n))
    none = repeated(0.0, 0.1, first, last, noise, sigmas)
    assert np.sqrt(np.mean(none**2)) < 0.8 * sigma * np.sqrt(seen / PIECES)
    false = np.where(rng.random((looks, n)) < 0.05, 50 * sigma, 0.0)
    assert np.median(repeated(0.0, 0.1, first, last, noise + false, sigmas)) < 0.8 * sigma * np.sqrt(
        seen / PIECES
    )
    bent = 5 * sigma * rng.standard_normal((looks, n))
    found = repeated(0.0, 0.1, first, last, bent, sigmas)
    assert np.median(found) == pytest.approx(np.sqrt(24) * sigma * np.sqrt(seen / PIECES), rel=0.1)
    few = repeated(2e-5, 0.1, first, last, bent[: LEAST_LOOKS - 1], np.full((LEAST_LOOKS - 1, n), sigma))
    np.testing.assert_allclose(few, 2e-5 * np.sqrt((LEAST_LOOKS - 1) / 4), rtol=1e-12)  # an arc of 3 turns


def test_curved_contours_slide() -> None:
    """A plane that meets a circle of radius 20 px a distance d along its tangent from where it is believed to, by Monte Carlo."""
    d = 2.0 * np.random.default_rng(3).standard_normal(200_000)
    miss = 20.0 - np.sqrt(20.0**2 - d**2)
    found = _slid(np.array([1 / 20.0, -1 / 20.0, 0.0]), np.full(3, 2.0))
    assert found[0] == found[1] == pytest.approx(np.sqrt(np.mean(miss**2)), rel=0.05) and found[2] == 0


def test_sections_that_were_of_another_contour_at_first_begin_anew() -> None:
    """Upright edges seen by a camera whose poses are off by 1 mm and 1 mrad; four of them were 6 mm aside in the first looks."""
    rng, looks, aside, focal = np.random.default_rng(6), 40, 6, 800.0
    contour = np.repeat(np.arange(4), 4)
    P = np.stack([[-0.1, -0.03, 0.05, 0.1], [0.5, 0.45, 0.55, 0.6], np.zeros(4)], axis=1)[contour]
    P[:, 2] = np.tile([-0.06, -0.02, 0.02, 0.06], 4)
    up, away = np.array([0.0, 0.0, 1.0]), P / np.linalg.norm(P, axis=1, keepdims=True)
    level = away - (away @ up)[:, None] * up
    T0 = level / np.linalg.norm(level, axis=1, keepdims=True)
    frame = np.stack([np.cross(T0, up), T0, np.cross(np.cross(T0, up), T0)], axis=1)
    tracks = SectionTracks(
        P, frame, contour, np.linalg.norm(P, axis=1), focal, PREVIEW, noisy_slant=True, may_stray=True
    )
    root, refused, features = 1e-3 * np.eye(6), np.zeros(looks, int), Features.empty()
    for v in range(looks):
        pose = np.eye(4)
        pose[0, 3] = np.linspace(-0.1, 0.1, looks)[v]
        seen = P + (0.006 * (contour == 2) * (v < aside))[:, None] * [1.0, 0.0, 0.0]
        planes = np.cross(seen - pose[:3, 3], up)
        planes += 5e-5 * rng.standard_normal((16, 1)) * np.cross(up, planes)
        planes /= np.linalg.norm(planes, axis=1, keepdims=True)
        believed = pose @ pose_exp(1e-3 * rng.standard_normal(6)).as_matrix()
        strayed = tracks.take_in(believed, root, planes, np.full(16, 1e-4))
        refused[v] = np.sum(strayed[contour == 2])
        features = tracks.features(np.zeros((16, 2)))
    assert refused.sum() > 4 and np.all(refused[aside + 8 :] == 0)
    assert features.visible.all()
    there = features.position - P
    assert np.abs(there @ [1.0, 0.0, 0.0]).max() < 0.002
    assert np.all(features.views[contour == 2] <= looks - aside) and np.all(features.views[contour == 0] > 30)
