"""Evaluations resume, count, and outlive the death of their processes."""

from pathlib import Path

import pytest

from extremal.scripts.episodes import EpisodeFailed, run_evaluation
from extremal.tasks.evaluation import Evaluation

DEADLY = """
import os
import signal
from pathlib import Path

import numpy as np

class Deadly:
    def reset(self, env, rng):
        self.shape, self.mark = env.action_space.shape, Path(__file__).with_name(f"{rng.integers(2**31)}")

    def act(self, observation):
        if not self.mark.exists() or Path(__file__).with_name("always").exists():
            self.mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return np.ones(self.shape)
"""


@pytest.fixture
def deadly(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Evaluation:
    """Two episodes of a policy that kills its process, once an episode."""
    (tmp_path / "deadly_policy.py").write_text(DEADLY)
    monkeypatch.syspath_prepend(str(tmp_path))
    return Evaluation("Inspect", "deadly_policy:Deadly", 2)


def test_evaluation_resumes_and_agrees_for_any_number_of_workers(tmp_path: Path) -> None:
    evaluation = Evaluation("Inspect", "oracle", 4)
    whole = run_evaluation(evaluation, tmp_path / "one")
    part = Evaluation("Inspect", "oracle", 2)
    run_evaluation(part, tmp_path / "two")
    kept = {path.name: path.stat().st_mtime_ns for path in (tmp_path / "two" / "episodes").iterdir()}
    assert run_evaluation(evaluation, tmp_path / "two", workers=2) == whole
    for name, when in kept.items():
        assert (tmp_path / "two" / "episodes" / name).stat().st_mtime_ns == when
    assert whole["episodes"] == 4 and set(whole["metrics"]["quality"]) >= {"median", "p05", "p95"}


def test_an_episode_is_run_again_when_its_process_dies(deadly: Evaluation, tmp_path: Path) -> None:
    found = run_evaluation(deadly, tmp_path / "many", workers=2)
    # the second time they do not die, in this process either
    assert found == run_evaluation(deadly, tmp_path / "one") and found["episodes"] == 2


@pytest.mark.slow
def test_an_episode_that_always_kills_its_process_is_named(deadly: Evaluation, tmp_path: Path) -> None:
    (tmp_path / "always").touch()
    with pytest.raises(EpisodeFailed, match=r"seed 100000[01]: it failed 2 times.*SIGKILL"):
        run_evaluation(deadly, tmp_path / "out", workers=2)
