"""Recorded datasets hold what happened, and replay; without Minari one line says what to install."""

import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from extremal.estimator import InvalidInput
from extremal.tasks.policies.baselines import BASELINES
from extremal.tasks.recording import MinariMissing, record
from extremal.tasks.tiers import TRAIN_SEEDS

NAME = "extremal.tasks:extremal/Inspect-v0"


def test_without_minari_it_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "minari", None)
    env = gym.make(NAME, answer="policy")
    with pytest.raises(MinariMissing, match=r"pip install 'extremal\[minari\]'"):
        record(env, BASELINES["Inspect"]["random"](), [1], "inspect/random-v0", tmp_path)
    env.close()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.filterwarnings("ignore::UserWarning:minari")
def test_what_is_recorded_is_read_back_and_replays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    minari = pytest.importorskip("minari")
    pytest.importorskip("h5py")
    root, kept = tmp_path / "datasets", tmp_path / "episodes"
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(root))
    env, seeds = gym.make(NAME, answer="policy", max_steps=30), TRAIN_SEEDS[72_000:72_002]
    record(env, BASELINES["Inspect"]["parallax"](), seeds, "inspect/parallax-v0", kept, author="nobody")
    assert not list(root.glob(".*"))
    dataset = minari.load_dataset("inspect/parallax-v0")
    assert dataset.total_episodes == 2
    again = dataset.recover_environment()
    for episode, seed in zip(dataset.iterate_episodes(), seeds, strict=True):
        observation, _ = again.reset(seed=seed)
        assert len(episode.observations["pose"]) == len(episode.actions) + 1
        for i, action in enumerate(episode.actions):
            np.testing.assert_array_equal(episode.observations["features"][i], observation["features"])
            observation, reward, ended, truncated, _ = again.step(action)
            assert float(reward) == episode.rewards[i]
            assert (ended, truncated) == (episode.terminations[i], episode.truncations[i])
    with pytest.raises(InvalidInput, match="a new name"):
        record(env, BASELINES["Inspect"]["parallax"](), seeds, "inspect/parallax-v0", kept)
    again.close()
    env.close()
