"""Episodes of an evaluation on any number of processes, each kept as soon as it has ended."""

import json
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

from extremal.estimator.errors import ExtremalError
from extremal.estimator.files import write_whole
from extremal.scripts.sweep_engine import run_locally
from extremal.tasks.evaluation import Evaluation, run_episode, summary

LONGEST = 3600.0  # [s] that an episode may take


class EpisodeFailed(ExtremalError, RuntimeError):
    """An episode that can't be run to its end."""


def run_evaluation(
    evaluation: Evaluation,
    folder: Path,
    workers: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, Any]:
    """Run what is missing of the episodes, and summarise all. Results are the same for any number of workers.

    An episode whose process dies is run again by another; started anew, an evaluation goes on where it was stopped.

    Args:
        folder: where each episode's result is kept.
        workers: processes (spawned); 1: this one.
        progress: called with the number of episodes that have ended, and of all.

    Raises:
        EpisodeFailed: one failed twice; those that have ended are kept.
    """
    kept = folder / "episodes"
    kept.mkdir(parents=True, exist_ok=True)
    paths = {seed: kept / f"{evaluation.key}-{seed}.json" for seed in evaluation.seeds}
    missing = [seed for seed, path in paths.items() if not path.exists()]
    done = len(paths) - len(missing)
    report = progress or (lambda done, total: None)
    report(done, len(paths))
    for seed, result in _results(evaluation, missing, workers):
        write_whole(paths[seed], result)
        done += 1
        report(done, len(paths))
    return summary(evaluation, [json.loads(path.read_text()) for path in paths.values()])


def _results(evaluation: Evaluation, seeds: list[int], workers: int) -> Iterator[tuple[int, str]]:
    run = partial(_run, evaluation)
    if workers <= 1 or len(seeds) <= 1:
        yield from ((seed, run(seed).decode()) for seed in seeds)
        return
    for outcome in run_locally(run, _prepare, seeds, min(workers, len(seeds)), LONGEST):
        if outcome.result is None:
            raise EpisodeFailed(f"the episode of seed {outcome.job}: {outcome.reason}")
        yield outcome.job, outcome.result.decode()


def _prepare() -> None:
    """What a process needs is imported with this module."""


def _run(evaluation: Evaluation, seed: int) -> bytes:
    return json.dumps(run_episode(evaluation, seed), indent=1).encode()
