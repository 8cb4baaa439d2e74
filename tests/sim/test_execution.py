"""Motion under physics: where the arm comes to rest, how it follows, limits, motion blur, clear errors."""

import re
import time
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import RigidTransform, Rotation

from extremal.estimator import Camera, ExtremalError, InvalidInput
from extremal.sim import NOMINAL, ArmErrors, ArmKinematics, ArmNotSettled, Drive, LinearMotion, fixating
from extremal.sim.execution import Execution, execute
from extremal.sim.exposure import MOVES, image_motion, sub_exposures

TARGET = np.array([0.0, 0.0, 0.1])
MOTION = LinearMotion()
ARM = ArmKinematics.behind(MOTION.centre(TARGET))
COMMANDED = ARM.joint_positions(MOTION.poses(TARGET, np.random.default_rng(0)))
FLYING = Drive(settle=0.0)


def run(drive: Drive, exposure_time: float = 0.01, commanded: np.ndarray = COMMANDED) -> Execution:
    return execute(commanded, NOMINAL, ARM.T_world_base, drive, exposure_time)


def camera_shift(q: np.ndarray, other: np.ndarray) -> float:
    """Largest distance [m] between camera centres at joint positions (V, 6)."""
    a, b = (NOMINAL.camera_poses(x).translation for x in (q, other))
    return float(np.linalg.norm(a - b, axis=1).max())


@pytest.fixture(scope="module")
def settled() -> Execution:
    return run(Drive())


@pytest.fixture(scope="module")
def flying() -> Execution:
    return run(FLYING)


def test_the_arm_comes_to_rest_where_it_was_commanded(settled: Execution) -> None:
    assert settled.shots.shape == (15,) and np.all(np.diff(settled.shots) > settled.exposure_time)
    assert np.abs(settled.joint_positions - COMMANDED).max() < 1e-6
    assert camera_shift(settled.joint_positions, COMMANDED) < 1e-6
    speed = settled.path(settled.shots, 1)
    assert np.abs(speed).max() < Drive().rest


@pytest.mark.parametrize("rotation", [[0, 0, 0], [np.pi, 0, 0], [0.5, 0.8, 0]])
def test_gravity_is_compensated_however_the_base_is_mounted(rotation: list[float]) -> None:
    base = RigidTransform.from_rotation(Rotation.from_rotvec(rotation))
    held = execute(COMMANDED[[0, 0]], NOMINAL, base, Drive(), 0.1)
    assert np.abs(held.joint_positions - COMMANDED[0]).max() < 1e-9


def test_on_the_fly_the_arm_follows_without_stopping(flying: Execution) -> None:
    """What is left of the lag is the arm's inertia; without feed-forward it would be kd / kp qdot, 13 mrad here."""
    assert np.abs(flying.joint_positions - COMMANDED).max() < 4e-4
    assert camera_shift(flying.joint_positions, COMMANDED) < 2e-4
    speed = np.abs(flying.path(flying.shots[1:-1], 1)).max(axis=1)
    assert speed.min() > 0.05


@pytest.mark.parametrize("settle", [0.0, 2.0])
@pytest.mark.parametrize(("speed", "acceleration"), [(0.3, 5.0), (3.0, 1.0)])
def test_limits_are_kept(settle: float, speed: float, acceleration: float) -> None:
    path = run(Drive(speed, acceleration, settle), commanded=COMMANDED[::7]).path
    assert np.abs(path(path.x, 1)).max() < 1.02 * speed
    # where the reference starts to accelerate at once the arm's own dynamics show
    assert np.quantile(np.abs(path(path.x, 2)).max(axis=1), 0.99) < 1.1 * acceleration


def test_same_input_same_bytes(settled: Execution) -> None:
    again = run(Drive())
    assert again.joint_positions.tobytes() == settled.joint_positions.tobytes()
    assert again.path.c.tobytes() == settled.path.c.tobytes()


def test_another_arm_reads_the_same_angles() -> None:
    """Joint positions are the encoders': a wrong zero shows in the camera's pose, not in the readings."""
    arm = ArmErrors(joint_offset=0.02, link_length=0.002).draw(np.random.default_rng(0))
    found = execute(COMMANDED, arm, ARM.T_world_base).joint_positions
    assert np.abs(found - COMMANDED).max() < 1e-6
    assert (
        np.linalg.norm(
            (arm.camera_poses(found).translation - NOMINAL.camera_poses(found).translation), axis=1
        ).min()
        > 1e-3
    )


def test_fifteen_views_take_no_three_seconds() -> None:
    started = time.process_time()
    run(Drive())
    assert time.process_time() - started < 3


def test_an_arm_that_does_not_come_to_rest_is_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(
        ArmNotSettled, match=r"still moves at .* rad/s after 0.01 s; accepted: below 1e-05 rad/s"
    ) as caught:
        run(Drive(settle=0.01))
    assert isinstance(caught.value, ExtremalError)
    assert not list(tmp_path.iterdir())  # MuJoCo's log


def test_positions_that_stand_still_can_be_passed() -> None:
    found = run(FLYING, commanded=np.repeat(COMMANDED[:3], 2, axis=0))
    assert np.abs(found.joint_positions - np.repeat(COMMANDED[:3], 2, axis=0)).max() < 2e-3
    assert np.all(np.diff(found.shots) >= 0.01)


def test_exposures_do_not_overlap() -> None:
    assert np.diff(run(FLYING, 0.5).shots).min() >= 0.5 - 1e-9


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"speed": 0.0}, "speed of the joints is 0.0; accepted"),
        ({"speed": float("nan")}, "speed of the joints is nan"),
        ({"acceleration": -1.0}, "acceleration of the joints is -1.0"),
        ({"rest": 0.0}, "rest of the joints is 0.0"),
        ({"settle": -1.0}, "settle is -1.0; accepted: 0 to 60 s"),
    ],
)
def test_bad_drives_are_named(values: dict[str, float], message: str) -> None:
    with pytest.raises(InvalidInput, match=message):
        Drive(**values)


NO_NUMBERS = ("1.0", "", b"1", None, [], [1.0], {}, True, np.True_, 1j, np.complex64(1), np.ones(1), 10**5000)


@pytest.mark.parametrize("value", NO_NUMBERS, ids=lambda value: type(value).__name__)
def test_what_is_no_number_is_named(value: Any) -> None:
    named = "too many digits" if isinstance(value, int) and value > 1 else re.escape(repr(value))
    for name in ("speed", "acceleration", "settle", "rest"):
        with pytest.raises(InvalidInput, match=rf"^{name} .*is .*{named}; accepted: "):
            Drive(**{name: value})
    with pytest.raises(InvalidInput, match=rf"exposure time is .*{named}; accepted: 0 to 10 s"):
        run(Drive(), value)


@pytest.mark.parametrize("number", [1, np.float64(1), np.float32(1), np.int64(1)])
def test_numbers_of_numpy_are_numbers(number: Any) -> None:
    made = Drive(number, number, number, number)
    assert made == Drive(1.0, 1.0, 1.0, 1.0)
    found, expected = (
        run(drive, commanded=COMMANDED[:2]).joint_positions for drive in (made, Drive(1.0, 1.0, 1.0, 1.0))
    )
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize(
    "commanded",
    [
        None,
        "x",
        b"",
        {},
        [[None] * 6] * 2,
        [["0"] * 6] * 2,  # numpy would read them
        np.full((2, 6), "x"),
        np.zeros((2, 6), complex),
        np.zeros((2, 6), bool),
        np.zeros((2, 6), "datetime64[s]"),
        [[0.0] * 6, [0.0] * 5],
        [[10**400] * 6] * 2,
    ],
)
def test_positions_that_are_no_numbers_are_named(commanded: Any) -> None:
    with pytest.raises(
        InvalidInput, match=r"commanded joint positions are .*; accepted: .*\(V, 6\)"
    ) as error:
        run(Drive(), commanded=commanded)
    assert "\n" not in str(error.value) and len(str(error.value)) < 200


def test_positions_may_be_lists_of_whole_numbers() -> None:
    found = run(Drive(), commanded=cast(Any, [[0, -1, 1, 0, 0, 0], [0, -1, 1, 0, 0, 1]]))
    assert np.abs(found.joint_positions[-1] - [0, -1, 1, 0, 0, 1]).max() < 1e-6


def test_bad_input() -> None:
    with pytest.raises(InvalidInput, match=r"exposure time is -1\.0"):
        run(Drive(), -1.0)
    with pytest.raises(InvalidInput, match="commanded joint positions are"):
        run(Drive(), commanded=np.full((3, 6), np.nan))
    with pytest.raises(InvalidInput, match="commanded joint positions are"):
        run(Drive(), commanded=COMMANDED[:1])


def place(joints: np.ndarray) -> RigidTransform:
    return ARM.T_world_base * NOMINAL.camera_poses(joints)


def test_a_camera_at_rest_needs_one_exposure(settled: Execution) -> None:
    poses = sub_exposures(settled, 7, place, Camera(), TARGET)
    assert len(poses) == 1
    np.testing.assert_allclose(
        poses[0].as_matrix(), place(settled.joint_positions[7:8])[0].as_matrix(), atol=1e-7
    )


def test_sub_exposures_follow_the_path() -> None:
    flying = run(FLYING, 0.1)
    poses = sub_exposures(flying, 7, place, Camera(), TARGET)
    assert len(poses) > 10
    assert image_motion(poses, Camera(), TARGET) / (len(poses) - 1) < MOVES
    for i in range(len(poses) - 1):
        assert image_motion(poses[i : i + 2], Camera(), TARGET) < 1.2 * MOVES  # speed varies along the path
    # their mean is the pose at mid exposure, to second order
    middle = place(flying.joint_positions[7:8])[0]
    length = np.linalg.norm(poses[-1].translation - poses[0].translation)
    assert np.linalg.norm(poses.translation.mean(axis=0) - middle.translation) < 0.03 * length
    # as far apart as the exposure is long
    speed = (
        np.linalg.norm(
            np.diff(place(flying.path(flying.shots[7] + np.array([-1e-4, 1e-4]))).translation, axis=0)
        )
        / 2e-4
    )
    assert abs(length / (speed * 0.1 * (1 - 1 / len(poses))) - 1) < 0.05


def test_image_motion_of_a_sideways_step() -> None:
    """A point at depth z moves by f step / z: most of what is followed at 0.6 times the target's distance, at a corner."""
    camera, step = Camera(), 1e-3
    start = fixating([[-0.6, 0.0, 0.1]], TARGET)[0]
    poses = RigidTransform.concatenate(
        [start * RigidTransform.from_translation([s, 0, 0]) for s in (0, step / 2, step)]
    )
    x, y = (camera.width - 1) / 2 / camera.fx, (camera.height - 1) / 2 / camera.fy
    depth = 0.6 * 0.6 / np.sqrt(1 + x**2 + y**2)
    assert image_motion(poses, camera, TARGET) == pytest.approx(camera.fx * step / depth, rel=1e-6)


def test_an_image_that_moves_too_far_is_an_error() -> None:
    times = np.linspace(0, 1, 5)
    path = CubicSpline(times, COMMANDED[0] + times[:, None] * (COMMANDED[-1] - COMMANDED[0]))
    swept = Execution(path, np.array([0.5]), 0.9)
    with pytest.raises(InvalidInput, match=r"the image of view 0 moves by \d+ px .* accepted: up to 100 px"):
        sub_exposures(swept, 0, place, Camera(), TARGET)
