"""Odd arguments of environments, policies, evaluations and arms: refused in one line, or a sound result; and what follows is sound."""

from collections.abc import Iterator
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from extremal.estimator.errors import InvalidInput
from extremal.sim.chain import NOMINAL
from extremal.sim.execution import Drive, execute
from extremal.sim.rig import Rig
from extremal.tasks import ENVIRONMENTS
from extremal.tasks.environment import ActiveVisionEnv
from extremal.tasks.evaluation import Evaluation
from extremal.tasks.policies.baselines import BASELINES
from extremal.tasks.policies.policy import load_policy
from extremal.tasks.tiers import get_tier
from extremal.tasks.vector import LastingVectorEnv

NAMES = [name.split("/")[1].split("-")[0] for name in ENVIRONMENTS]


def made(name: str, **arguments: Any) -> ActiveVisionEnv[Any]:
    env = gym.make(f"extremal.tasks:extremal/{name}-v0", **arguments).unwrapped
    assert isinstance(env, ActiveVisionEnv)
    return env


@pytest.fixture(scope="module", params=NAMES)
def env(request: pytest.FixtureRequest) -> Iterator[ActiveVisionEnv[Any]]:
    one = made(request.param)
    yield one
    one.close()


def refused(error: pytest.ExceptionInfo[InvalidInput]) -> bool:
    message = str(error.value)
    return "\n" not in message and "accepted" in message and len(message) < 600


def check_step(env: ActiveVisionEnv[Any], action: Any) -> None:
    observation, reward, *_, info = env.step(action)
    assert env.observation_space.contains(observation) and 0 <= reward <= 1
    assert all(np.isfinite(value) for value in info.values())


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(
    "argument", ["sensor", "obs_mode", "action_mode", "reward_mode", "tier", "arm", "max_steps"]
)
@pytest.mark.parametrize("value", [np.nan, -1, 0, 0.5, 10**40, "x", "", b"a"])
def test_arguments_of_environments(name: str, argument: str, value: Any) -> None:
    with pytest.raises(InvalidInput) as error:
        made(name, **{argument: value})
    assert refused(error)


OPTIONS = [
    *[({"edge_noise": value}, "edge_noise") for value in (np.nan, np.inf, -1, 21, 10**40, None, "x", [])],
    *[({"clutter": value}, "clutter") for value in (np.nan, -1, 7, 0.5, True, None, "x", [])],
    *[
        ({name: value}, "accepted")
        for name in ("crease", "appearance")
        for value in (np.nan, None, 1, "x", [])
    ],
    *[({name: value}, "arm") for name in ("arm_bias", "arm_noise") for value in (np.nan, None, 1, "x")],
    *[({"families": value}, "accepted") for value in ((), "x", [None], [1], ["x"], np.zeros(2), {})],
    ({"nothing": 1}, "nothing"),
    ({"name": "x"}, "name"),
]


def test_options_of_a_reset(env: ActiveVisionEnv[Any]) -> None:
    env.reset(seed=1)
    before = env.tier, env.setup, env.T_actual.copy()
    for options, part in OPTIONS:
        with pytest.raises(InvalidInput, match=part) as error:
            env.reset(seed=1, options=options)
        assert refused(error)
    assert (env.tier, env.setup) == before[:2]
    np.testing.assert_array_equal(env.T_actual, before[2])
    check_step(env, np.zeros(env.action_space.shape or ()))


def test_actions(env: ActiveVisionEnv[Any]) -> None:
    env.reset(seed=1)
    size = len(env.action_space.sample())
    for value in (np.nan, np.inf, -np.inf):
        one = np.zeros(size)
        one[-1] = value
        for action in (np.full(size, value), one, [value] * size):
            with pytest.raises(InvalidInput, match="finite") as error:
                env.step(action)
            assert refused(error)
    for action in (0.0, [], np.zeros(size + 1), np.zeros((1, size)), np.zeros((size, 0)), None):
        with pytest.raises(InvalidInput) as error:
            env.step(action)
        assert refused(error)
    assert env.steps == 0
    zero = np.zeros(size)
    zero[6:] = -1.0  # no answer, no grasp
    for value in (1e300, -1e300, 1e-320, 2.0):
        check_step(env, np.where(zero, zero, value))


def test_before_the_first_reset() -> None:
    for name in NAMES:
        one = made(name)
        with pytest.raises(InvalidInput, match="not reset"):
            one.step(one.action_space.sample())


@pytest.mark.parametrize(("field", "values"), [
    ("env", ("x", "", None, 1)), ("sensor", ("x", None, np.nan)), ("arm", ("x", "", 1)), ("tier", ("x", "", None, 1)),
    ("policy", ("x", "", ":", "nothing")),
    ("episodes", (0, -1, 1001, 10**40)), ("seed", (-1, 1000, 10**40)),
])  # fmt: skip
def test_arguments_of_evaluations(field: str, values: tuple[Any, ...]) -> None:
    for value in values:
        with pytest.raises(InvalidInput) as error:
            Evaluation(**({"env": "Navigate", "policy": "random", "episodes": 1} | {field: value}))
        assert refused(error)


def test_policies_and_tiers_that_there_are_not() -> None:
    for name in NAMES:
        with pytest.raises(InvalidInput, match=r"accepted: .*active"):
            load_policy("x", BASELINES[name])
    for tier in ("", "standard", None, np.nan):
        with pytest.raises(InvalidInput, match="standard-v0"):
            get_tier(tier)  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("number", [np.nan, np.inf, -1, 0, 0.5, 1025, 10**40, True, None, "x", []])
def test_numbers_of_environments_in_a_vector(number: Any) -> None:
    with pytest.raises(InvalidInput, match="num_envs"):
        LastingVectorEnv("extremal.tasks:extremal/Navigate-v0", number)


@pytest.mark.parametrize("seconds", [np.nan, np.inf, -1.0, 0.0])
def test_seconds_of_a_vector(seconds: float) -> None:
    with pytest.raises(InvalidInput, match="seconds"):
        LastingVectorEnv("extremal.tasks:extremal/Navigate-v0", 1, seconds=seconds)


# The arm.

HOME = np.zeros((2, 6))
BASE = RigidTransform.identity()


@pytest.mark.parametrize("commanded", [
    HOME[:0], HOME[:1], HOME[0], HOME[:, :5], HOME[None], np.array(0.0), HOME + np.nan, HOME + np.inf, HOME + 6.3, HOME - 1e300,
])  # fmt: skip
def test_positions_that_no_arm_reaches(commanded: np.ndarray) -> None:
    for drive in (Drive(), Drive(settle=0)):
        with pytest.raises(InvalidInput, match="joint positions") as error:
            execute(commanded, NOMINAL, BASE, drive)
        assert refused(error)


@pytest.mark.parametrize("base", [
    RigidTransform.from_translation([np.nan, 0.0, 0.0]), RigidTransform.from_translation(np.zeros((2, 3))),
])  # fmt: skip
def test_a_base_is_one_finite_pose(base: RigidTransform) -> None:
    with pytest.raises(InvalidInput, match="T_world_base"):
        execute(HOME, NOMINAL, base)
    with pytest.raises(InvalidInput, match="T_world_base"):
        Rig.individual("typical", "ideal", 0).prior(HOME, base)


def test_an_arm_that_is_not_moved_on_the_fly() -> None:
    found = execute(HOME[[0, 0, 0]], NOMINAL, BASE, Drive(settle=0))
    assert np.all(np.diff(found.shots) > 0) and np.abs(found.joint_positions).max() < 1e-6
    for view, parts in ((-1, 3), (3, 3), (0, 0)):
        with pytest.raises(InvalidInput, match="views 0 to 2"):
            found.exposure(view, parts)


@pytest.mark.parametrize("seed", [-1, 0.5, np.nan, None, "x", True])
def test_numbers_of_individual_arms(seed: Any) -> None:
    with pytest.raises(InvalidInput, match="seed"):
        Rig.individual("typical", "ideal", seed)


@pytest.mark.parametrize("readings", [HOME[0], HOME[:, :5], HOME[None], HOME + np.nan, HOME + np.inf])
def test_readings_of_encoders(readings: np.ndarray) -> None:
    with pytest.raises(InvalidInput, match="readings"):
        Rig.individual("typical", "ideal", 0).prior(readings, BASE)
