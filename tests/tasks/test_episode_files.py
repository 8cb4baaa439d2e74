"""Recorded episodes are kept once acknowledged, are read back as they were, and a folder holds one kind of them."""

from collections.abc import Mapping
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import recorded_env

from extremal.estimator.errors import InvalidInput
from extremal.tasks.episode_files import EpisodeFolder
from extremal.tasks.policies.policy import RandomPolicy
from extremal.tasks.recording import record_episodes

KILLS = 100


def test_an_episode_is_read_back_as_it_was(tmp_path: Path) -> None:
    env, policy = recorded_env.Walk(), RandomPolicy()
    assert list(record_episodes(env, policy, [4, 9], tmp_path)) == [4, 9]
    episode = EpisodeFolder(tmp_path, env, policy).load(9)
    observation, _ = env.reset(seed=9)
    steps = len(episode.actions)
    assert set(episode.observations) == {"place", "picture"} and not episode.is_success[0]
    for i in range(steps):
        assert_equal(observation, {name: values[i] for name, values in episode.observations.items()})
        observation, reward, ended, truncated, info = env.step(episode.actions[i])
        assert (reward, ended, truncated) == (
            episode.rewards[i],
            episode.terminations[i],
            episode.truncations[i],
        )
        assert info["is_success"] == episode.is_success[i + 1]
    assert_equal(observation, {name: values[steps] for name, values in episode.observations.items()})
    assert episode.truncations[-1] or episode.terminations[-1]


def assert_equal(one: Mapping[str, Any], two: Mapping[str, Any]) -> None:
    for name, values in one.items():
        np.testing.assert_array_equal(values, two[name])
        assert values.dtype == two[name].dtype


def test_what_is_kept_is_not_run_again(tmp_path: Path) -> None:
    env = recorded_env.Walk()
    list(record_episodes(env, RandomPolicy(), [1, 2], tmp_path))
    before = env.episodes
    assert list(record_episodes(env, RandomPolicy(), [1, 2, 3], tmp_path)) == [1, 2, 3]
    assert env.episodes == before + 1


def test_a_folder_holds_one_policy_in_one_environment(tmp_path: Path) -> None:
    class Other(RandomPolicy):
        """Another policy."""

    env: gym.Env[Any, Any] = recorded_env.Walk()
    list(record_episodes(env, RandomPolicy(), [1], tmp_path))
    with pytest.raises(InvalidInput, match="another environment or policy"):
        list(record_episodes(env, Other(), [1], tmp_path))
    folder = EpisodeFolder(tmp_path, env, RandomPolicy())
    with pytest.raises(InvalidInput, match="an episode that was kept"):
        folder.load(2)
    (tmp_path / "3.npz").write_bytes((tmp_path / "1.npz").read_bytes()[:100])
    with pytest.raises(InvalidInput, match="an episode that was kept"):
        folder.load(3)


@pytest.mark.slow
def test_kills_of_the_recorder_lose_nothing_that_was_acknowledged(tmp_path: Path) -> None:
    context, rng = get_context("forkserver"), np.random.default_rng(3)
    context.set_forkserver_preload(["extremal.tasks.recording"])
    acknowledged: set[int] = set()
    for _ in range(KILLS):
        here, there = context.Pipe()
        process = context.Process(target=recorded_env.run, args=(tmp_path, there), daemon=True)
        process.start()
        there.close()
        assert here.poll(60)  # it is at work
        process.join(rng.uniform(0, 0.1))
        assert process.is_alive()
        process.kill()
        acknowledged |= received(here)
        process.join()
    assert len(acknowledged) > KILLS
    folder = EpisodeFolder(tmp_path, recorded_env.Walk(), RandomPolicy())
    for path in tmp_path.glob("*.npz"):  # whole, whether it was acknowledged or not
        assert len(folder.load(int(path.stem)).actions) > 0
    assert acknowledged <= {int(path.stem) for path in tmp_path.glob("*.npz")}


def received(here: Connection) -> set[int]:
    found = set[int]()
    try:
        while True:
            found.add(here.recv())
    except EOFError:
        return found
