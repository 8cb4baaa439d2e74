"""The motion to calibrate by shows the board in every view, and the arm can carry it out."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from extremal.estimator import Camera, InvalidInput
from extremal.sim import ArmKinematics
from extremal.sim.board_motion import BoardMotion

TARGET = np.array([0.0, 0.0, 0.2])


@pytest.mark.parametrize("seed", [0, 1])
def test_every_view_shows_the_board_and_can_be_reached(seed: int) -> None:
    motion = BoardMotion()
    poses = motion.poses(TARGET, np.random.default_rng(seed))
    assert len(poses) == 30
    camera = Camera()
    centre = camera.project(np.stack([poses[i].inv().apply(TARGET) for i in range(30)]))
    assert np.all(np.abs(centre - [319.5, 239.5]) < 150)
    distance = np.linalg.norm(poses.translation - TARGET, axis=1)
    assert np.all((distance > 0.79 * 0.45) & (distance < 1.21 * 0.45))
    arm = ArmKinematics.behind(motion.centre(TARGET))
    reached = arm.camera_poses(arm.joint_positions(poses))
    assert np.abs((reached * poses.inv()).as_matrix() - np.eye(4)).max() < 1e-6


def test_rotations_span_all_axes() -> None:
    poses = BoardMotion(views=30).poses(TARGET, np.random.default_rng(3))
    turns = (poses.rotation[0].inv() * poses.rotation).as_rotvec()
    spread = np.linalg.svd(turns - turns.mean(axis=0), compute_uv=False) / np.sqrt(len(turns))
    assert spread[-1] > 0.15


def test_without_spread_all_views_are_one() -> None:
    motion = BoardMotion(views=3, spread=0, roll=0, depth=0, aside=0)
    poses = motion.poses(TARGET, np.random.default_rng(0))
    assert np.allclose(poses.translation, motion.centre(TARGET))
    assert np.allclose(
        Rotation.concatenate([poses.rotation[0].inv()] * 3).as_matrix() @ poses.rotation.as_matrix(),
        np.eye(3),
    )


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("views", 2),
        ("views", 3.5),
        ("distance", 0.0),
        ("distance", np.nan),
        ("elevation", 1.2),
        ("spread", -0.1),
        ("roll", 4.0),
        ("depth", 0.6),
        ("aside", np.nan),
    ],
)
def test_bad_values_are_named(name: str, value: float) -> None:
    with pytest.raises(InvalidInput, match=name):
        BoardMotion(**{name: value})  # pyright: ignore[reportArgumentType]
