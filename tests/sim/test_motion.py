"""The linear motion: ends, irregular steps, fixation, validation."""

import numpy as np
import pytest

from extremal.estimator import Camera, InvalidInput
from extremal.sim import LinearMotion, fixating

TARGET = np.array([0.1, -0.05, 0.12])


def test_centres_lie_on_the_segment() -> None:
    motion = LinearMotion(views=15, baseline=0.4, distance=0.6, elevation=0.2)
    centres = motion.poses(TARGET, np.random.default_rng(0)).translation
    middle = TARGET + 0.6 * np.array([-np.cos(0.2), 0, np.sin(0.2)])
    np.testing.assert_allclose(centres[:, [0, 2]] - middle[[0, 2]], 0, atol=1e-15)
    np.testing.assert_allclose(centres[[0, -1], 1] - TARGET[1], [-0.2, 0.2])
    step = 0.4 / 14
    irregular = centres[:, 1] - np.linspace(-0.2, 0.2, 15) - TARGET[1]
    assert np.all(np.abs(irregular) <= 0.35 * step + 1e-12)
    assert np.std(irregular[1:-1]) > 0.1 * step
    assert np.all(np.diff(centres[:, 1]) > 0)


def test_regular_steps_on_demand() -> None:
    y = LinearMotion(views=5, irregularity=0).poses(TARGET, np.random.default_rng(0)).translation[:, 1]
    np.testing.assert_allclose(np.diff(y), 0.1)


def test_cameras_fixate_the_target_without_roll() -> None:
    poses = LinearMotion(baseline=0.8, distance=0.5).poses(TARGET, np.random.default_rng(1))
    camera = Camera(cx=300.0, cy=200.0)
    for i in range(len(poses)):
        np.testing.assert_allclose(camera.project(poses[i].inv().apply(TARGET)), [300, 200], atol=1e-9)
        axes = poses[i].rotation.as_matrix()
        assert axes[2, 0] == pytest.approx(0, abs=1e-12)  # x is horizontal
        assert axes[2, 1] < 0  # y points down
        assert axes[1, 0] < 0  # looking along +x, the right is -y


def test_same_generator_same_path() -> None:
    a, b = (LinearMotion().poses(TARGET, np.random.default_rng(5)).as_matrix() for _ in range(2))
    assert a.tobytes() == b.tobytes()


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"views": 1}, "views is 1; accepted"),
        ({"views": 2}, "fewer than three"),
        ({"baseline": 0.0}, "baseline is 0.0; accepted: a positive"),
        ({"baseline": float("nan")}, "baseline is nan"),
        ({"distance": -1.0}, "distance is -1.0"),
        ({"elevation": 2.0}, "elevation is 2.0"),
        ({"irregularity": 0.5}, "irregularity is 0.5"),
    ],
)
def test_bad_values_are_named(values: dict[str, float], message: str) -> None:
    with pytest.raises(InvalidInput, match=message):
        LinearMotion(**values)  # type: ignore[arg-type]


def test_a_camera_straight_above_the_target_is_refused() -> None:
    with pytest.raises(InvalidInput, match="upright"):
        fixating(TARGET[None] + [0, 0, 1], TARGET)
    with pytest.raises(InvalidInput, match="upright"):
        fixating([[np.nan, 0, 0]], TARGET)
    with pytest.raises(InvalidInput, match="upright"), np.errstate(over="ignore"):
        fixating([[1e300, 0.0, 0.0]], np.zeros(3))
