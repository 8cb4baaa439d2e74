"""Strips continued beyond their views, and what they foretell of others, against exact surfaces."""

from dataclasses import replace

import numpy as np
import pytest
from exact_contours import OBJECTS, TARGET, cameras, exact_contours, seen_from, strip_of
from scipy.spatial.transform import RigidTransform

from extremal.estimator import InvalidInput
from extremal.estimator.extrapolation import extrapolate
from extremal.estimator.strip import Strip
from extremal.estimator.strip_prediction import predict
from extremal.scenes import Surface
from extremal.sim import fixating


@pytest.fixture(scope="module", params=OBJECTS)
def exact(request: pytest.FixtureRequest) -> tuple[Surface, Strip]:
    """An object and the strip of its exact contours."""
    return OBJECTS[request.param], strip_of(OBJECTS[request.param])


@pytest.fixture(scope="module")
def sphere() -> Strip:
    """The strip of the sphere's exact contours."""
    return strip_of(OBJECTS["sphere"])


def test_sigma_grows_beyond_the_strip_and_covers(exact: tuple[Surface, Strip]) -> None:
    surface, strip = exact
    beyond = extrapolate(strip)
    last = int(np.flatnonzero(beyond.seen[0])[-1])
    assert np.all(np.diff(beyond.shape_sigma[:, last:], axis=1) > 0)
    one, three = beyond.trusted(1e-3), beyond.trusted(3e-3)
    assert np.all(one <= three) and np.all(three <= beyond.valid)
    assert np.all(one[beyond.seen]) and (one & ~beyond.seen).sum() > beyond.seen.sum() / 3
    height = beyond.points[..., 2]
    on = three & (height > 0.004) & (height < 0.116)  # where the vase has not ended
    off = np.abs(surface.signed_distance(beyond.points[on]))
    assert np.mean(off < 2 * beyond.sigma[on] + 2e-6) > 0.95
    assert len(beyond.faces(one)) < len(beyond.faces(three)) or np.array_equal(one, three)


def test_trust_ends_at_the_first_gap(sphere: Strip) -> None:
    beyond = extrapolate(sphere, 0.2)
    last = int(np.flatnonzero(beyond.seen[0])[-1])
    sigma = beyond.shape_sigma.copy()
    sigma[:, last + 2] = 1.0
    trusted = replace(beyond, shape_sigma=sigma).trusted(1e-3)
    assert trusted[:, last + 1].all() and not trusted[:, last + 2 :].any()
    assert trusted[:, 0].all()


@pytest.mark.parametrize(
    "pose",
    [
        fixating([[-0.587, 0.11, 0.185]], TARGET)[0],
        fixating([[-0.587, 0.24, 0.185]], TARGET)[0],
        fixating([[-0.55, 0.05, 0.28]], TARGET)[0],
    ],
    ids=["within", "beyond", "above"],
)
def test_predictions_of_unseen_views(exact: tuple[Surface, Strip], pose: RigidTransform) -> None:
    surface, strip = exact
    view = seen_from(pose)
    found = predict(strip, view, exact_contours(surface, view))
    assert found.valid.mean() > 0.9 and found.found.sum() > 0.85 * found.valid.sum()
    assert found.rms < 0.03
    outwards = np.sum(found.normals * (found.pixels - view.project(TARGET)), axis=1)
    assert np.mean(outwards[found.valid] > 0) > 0.9


def test_a_view_of_nothing(sphere: Strip) -> None:
    strip = sphere
    away = seen_from(fixating([[-0.587, 0.0, 0.185]], [-2.0, 0.0, 0.1])[0])
    found = predict(strip, away, exact_contours(OBJECTS["sphere"], cameras()[0]))
    assert not found.valid.any() and not found.found.any() and np.isnan(found.rms)


@pytest.mark.parametrize("angle", [0.0, -1.0, float("nan")])
def test_angles_and_sigmas_are_positive(sphere: Strip, angle: float) -> None:
    with pytest.raises(InvalidInput, match="angle"):
        extrapolate(sphere, angle)
    with pytest.raises(InvalidInput, match="sigma"):
        extrapolate(sphere, 0.1).trusted(angle)
