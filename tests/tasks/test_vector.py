"""Workers that are killed, stopped, or raise: noticed in time, reported, rebuilt, and none is left behind."""

import os
import re
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from extremal.estimator.errors import InvalidInput
from extremal.tasks.vector import LastingVectorEnv, WorkerLost

NAME, SECONDS = "extremal.tasks:extremal/Navigate-v0", 3.0
LONGEST = 120.0  # [s] no measure of speed: what a hang would exceed on a busy machine, too


@pytest.fixture(scope="module")
def envs() -> Iterator[LastingVectorEnv]:
    made = LastingVectorEnv(NAME, 2, seconds=60.0)
    made.reset(seed=0)  # a first one may have to compile
    yield made
    made.close()


def pids(envs: LastingVectorEnv) -> list[int]:
    return [process.pid or 0 for process in envs._workers.processes]


def gone(pid: int) -> bool:
    status = Path(f"/proc/{pid}/stat")
    return not status.exists() or status.read_text().split()[2] == "Z"


@pytest.mark.parametrize(
    ("sent", "message"),
    [
        (signal.SIGKILL, "worker 1 was killed by signal 9"),
        (signal.SIGSTOP, "worker 1 did not answer within 3 s"),
    ],
)
def test_a_lost_worker_is_reported_and_replaced(
    envs: LastingVectorEnv, sent: signal.Signals, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, _ = envs.reset(seed=5)
    old = pids(envs)
    monkeypatch.setattr(envs, "_seconds", SECONDS)
    os.kill(old[1], sent)
    actions = np.zeros(envs.action_space.shape or (), np.float32)
    start = time.monotonic()
    with pytest.raises(WorkerLost, match=re.escape(message)):
        for _ in range(3):
            envs.step(actions)
    assert time.monotonic() - start < LONGEST
    assert all(gone(pid) for pid in old)
    monkeypatch.undo()  # new processes are slow at first
    again, _ = envs.reset(seed=5)
    for key in first:
        assert np.array_equal(first[key], again[key])
    envs.step(actions)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*ERROR:UserWarning")  # gymnasium says first what the error says
def test_an_error_of_an_environment_is_its_own(envs: LastingVectorEnv) -> None:
    """What an environment refuses is no lost worker; one goes on afterwards."""
    envs.reset(seed=0)
    actions = np.zeros(envs.action_space.shape or (), np.float32)
    actions[1] = np.nan
    with pytest.raises(InvalidInput, match="finite"):
        envs.step(actions)
    envs.reset(seed=0)
    envs.step(np.nan_to_num(actions))


def test_observations_are_those_of_single_environments(envs: LastingVectorEnv) -> None:
    many, _ = envs.reset(seed=8)
    for i in range(2):
        one = gym.make(NAME)
        alone, _ = one.reset(seed=8 + i)
        one.close()
        for key in alone:
            assert np.array_equal(many[key][i], alone[key])


@pytest.mark.parametrize(("number", "seconds"), [(0, 1.0), (True, 1.0), (2, 0.0), (2, float("nan"))])
def test_bad_numbers_are_named(number: int, seconds: float) -> None:
    with pytest.raises(InvalidInput, match="accepted"):
        LastingVectorEnv(NAME, number, seconds)
