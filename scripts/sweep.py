"""`extremal sweep`: many trials over grids and random draws of settings, on many processes, any of which may die."""

from collections import Counter
from collections.abc import Generator, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from extremal.estimator.errors import ExtremalError, InvalidInput
from extremal.scripts.sweep_attempts import Outcome
from extremal.scripts.sweep_config import load_config
from extremal.scripts.sweep_engine import run_locally
from extremal.scripts.sweep_ray import run_on_ray
from extremal.scripts.sweep_store import DIGEST, FAILED, TABLE, Row, Store
from extremal.scripts.sweep_trials import OK, Trial, get_kind, run_trial

MOST_WORKERS = 4096


class TrialsFailed(ExtremalError, RuntimeError):
    """Trials have no result."""


@dataclass(frozen=True)
class SweepSettings:
    """Run the trials of a sweep; writes results.csv, one row a trial, and digest.txt. Started again, it goes on where it was stopped."""

    config: tyro.conf.Positional[Path]
    """TOML file: kind of trial, settings, grid and draws (docs/sweeps.md)"""
    engine: Literal["local", "ray"] = "local"
    """processes of this machine; or Ray, on this machine or on the cluster that RAY_ADDRESS names (extra `cluster`)"""
    workers: Annotated[int, tyro.conf.arg(metavar="W")] = 2
    """number of trials at a time"""
    timeout: Annotated[float, tyro.conf.arg(metavar="S")] = 3600.0
    """after which a trial's process is killed [s]"""
    out: Path = Path("out/sweep")
    """folder that is written; trials that are there already are not run again"""


def sweep(settings: SweepSettings) -> None:
    """Run what is missing, and merge all results.

    Raises:
        InvalidInput: a setting or the file is not what is accepted.
        TrialsFailed: trials were given up after two attempts; all others have their results.
    """
    if not 1 <= settings.workers <= MOST_WORKERS:
        raise InvalidInput(f"--workers is {settings.workers}; accepted: 1 to {MOST_WORKERS}")
    if not 0 < settings.timeout <= 1e6:
        raise InvalidInput(f"--timeout is {settings.timeout:g}; accepted: more than 0, to 1e6 [s]")
    config = load_config(settings.config)
    trials = config.all_trials()
    store, console = Store(settings.out), Console()
    failed = _run(settings, trials, store, console)
    rows = store.merge(trials, config.names, failed)
    for line in _summary(rows):
        console.print(line, markup=False, highlight=False)
    console.print(f"wrote {settings.out}/: {TABLE} and {DIGEST}", highlight=False)
    if failed:
        raise TrialsFailed(
            f"{len(failed)} of {len(trials)} trials have no result; the first: {next(iter(failed.values()))}; all are in "
            f"{settings.out / FAILED}; start again to try them again"
        )


def _run(settings: SweepSettings, trials: Sequence[Trial], store: Store, console: Console) -> dict[str, str]:
    """Run the trials that have no result yet; gives the reason by the key of those that were given up."""
    missing = [trial for trial in trials if not store.has(trial)]
    failed: dict[str, str] = {}
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, transient=True) as progress:
        bar = progress.add_task("trials", total=len(trials), completed=len(trials) - len(missing))
        if missing:
            with closing(_outcomes(settings, missing, store)) as outcomes:
                for outcome in outcomes:
                    if outcome.result is None:
                        failed[outcome.job.key] = outcome.reason
                    else:
                        store.keep(outcome.job, outcome.result)
                    progress.advance(bar)
    return failed


def _outcomes(
    settings: SweepSettings, missing: Sequence[Trial], store: Store
) -> Generator[Outcome[Trial], None, None]:
    # another process may be at the same sweep
    jobs = (trial for trial in missing if not store.has(trial))
    if settings.engine == "ray":
        return run_on_ray(run_trial, jobs, settings.workers, settings.timeout)
    prepare = partial(get_kind, missing[0].kind)
    return run_locally(run_trial, prepare, jobs, settings.workers, settings.timeout)


def _summary(rows: Sequence[Row]) -> list[str]:
    """How the trials went: a line for each status, with the first message of what has no estimate."""
    counts = Counter(row["status"] for row in rows)
    first: dict[str, Any] = {}
    for row in rows:
        first.setdefault(row["status"], row["message"])
    order = sorted(counts, key=lambda status: (status != OK, status))
    return [
        f"{counts[status]} trials: {status}" + (f"; the first: {first[status]}" if first[status] else "")
        for status in order
    ]
