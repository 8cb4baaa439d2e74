"""`extremal evaluate`: a policy's success over the test episodes, with confidence intervals."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tyro
from matplotlib.axes import Axes
from rich.box import SIMPLE
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from extremal.estimator import InvalidInput
from extremal.estimator.files import write_whole
from extremal.scripts.episodes import run_evaluation
from extremal.scripts.report import Report
from extremal.sim.arm_errors import ArmName
from extremal.tasks.evaluation import Evaluation
from extremal.tasks.leaderboard import METRICS, SETTING, leaderboard


@dataclass(frozen=True)
class EvaluateSettings:
    """Evaluate a policy; writes report.html, evaluation.json and leaderboard.json. Started again, it goes on where it was stopped."""

    env: Literal["Inspect", "Navigate", "Grasp"] = "Navigate"
    """the task"""
    policy: str = "active"
    """random, oracle, active, parallax, absolute, blind, one that a package registers, or module:Class of your own"""
    episodes: Annotated[int, tyro.conf.arg(metavar="N")] = 20
    """number of episodes"""
    workers: Annotated[int, tyro.conf.arg(metavar="W")] = 2
    """number of processes"""
    sensor: Literal["geometric", "rendered"] = "geometric"
    """exact contours with a model of edge errors, or frames through the vision pipeline"""
    tier: str = "standard-v0"
    """what episodes are drawn from"""
    arm: ArmName | None = None
    """replaces the tier's calibration"""
    seed: int = 0
    """number of the first test episode"""
    out: Path = Path("out/evaluation")
    """folder that is written; episodes that are there already are not run again"""


def evaluate(settings: EvaluateSettings) -> None:
    """Run the episodes and write the summary."""
    if not 1 <= settings.workers <= 256:
        raise InvalidInput(f"--workers is {settings.workers}; accepted: 1 to 256")
    evaluation = Evaluation(
        settings.env,
        settings.policy,
        settings.episodes,
        settings.sensor,
        settings.tier,
        settings.arm,
        settings.seed,
    )
    console = Console()
    columns = (TextColumn("{task.description:>10}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task("episodes", total=settings.episodes)
        found = run_evaluation(
            evaluation,
            settings.out,
            settings.workers,
            lambda done, total: progress.update(task, completed=done, total=total),
        )
    write_whole(settings.out / "evaluation.json", json.dumps(found, indent=1))
    rows = leaderboard(settings.out / "leaderboard.json", found)
    metrics = _metrics_table(found)
    _report(settings, rows, metrics, _leaderboard_table(rows, METRICS)).save(settings.out / "report.html")
    console.print(metrics)
    console.print(_leaderboard_table(rows, ()))  # a terminal is too narrow for medians as well
    console.print(f"wrote {settings.out}/: report.html, evaluation.json and leaderboard.json")


def _report(settings: EvaluateSettings, rows: list[dict[str, Any]], metrics: Table, board: Table) -> Report:
    title = f"{settings.episodes} episodes of {settings.env}, policy {settings.policy}"
    report = Report("extremal evaluate", title).text(str(metrics.caption))
    report.figure(
        lambda axes: _draw_leaderboard(axes, rows),
        "Success of all policies so far, with 95 % intervals (Wilson).",
    )
    report.table(metrics).table(board)
    return report.section("How it was made").settings(asdict(settings))


def _draw_leaderboard(axes: Axes, rows: list[dict[str, Any]]) -> None:
    rates = np.array([[row["success_rate"], *row["success_ci95"]] for row in rows]).T * 100
    at = np.arange(len(rows))
    bars = np.maximum(np.abs(rates[1:] - rates[0]), 0)
    axes.errorbar(rates[0], at, xerr=bars, fmt="o", color="#1f77b4", capsize=3)
    axes.set_yticks(at, [f"{row['env']}, {row['policy']}" for row in rows])
    axes.set(xlabel="success [%]", xlim=(-3, 103), ylim=(len(rows) - 0.5, -0.5))
    axes.grid(alpha=0.25)


def _metrics_table(found: dict[str, Any]) -> Table:
    low, high = found["success_ci95"]
    table = Table(title=f"{found['env']}, {found['policy']}: {found['episodes']} episodes", box=SIMPLE)
    for name in ("metric", "median", "5 %", "95 %"):
        table.add_column(name, justify="left" if name == "metric" else "right", no_wrap=True)
    for name, values in found["metrics"].items():
        cells = (values[k] for k in ("median", "p05", "p95"))
        table.add_row(name, *("-" if cell is None else f"{cell:.3g}" for cell in cells))
    table.caption = f"success {100 * found['success_rate']:.1f} % ({100 * low:.1f} to {100 * high:.1f} %)"
    return table


def _leaderboard_table(rows: list[dict[str, Any]], names: Sequence[str]) -> Table:
    """All policies so far, with the medians of the metrics of these names."""
    table = Table(title="leaderboard", box=SIMPLE, caption="score: 0 random, 1 oracle")
    metrics = [name for name in names if any(row["median"].get(name) is not None for row in rows)]
    for name in ("setting", "policy", "episodes", "success", "95 %", "score", "95 %", *metrics):
        table.add_column(name.replace("_", " "), no_wrap=name not in ("setting", *metrics))
    for row in rows:
        medians = (row["median"].get(name) for name in metrics)
        table.add_row(
            " ".join(str(row[k]) for k in SETTING if row[k]),
            row["policy"],
            str(row["episodes"]),
            f"{100 * row['success_rate']:.1f} %",
            "{:.1f}-{:.1f} %".format(*(100 * bound for bound in row["success_ci95"])),
            "-" if row["score"] is None else f"{row['score']:.2f}",
            "-" if row["score_ci95"] is None else "{:.2f} to {:.2f}".format(*row["score_ci95"]),
            *("-" if median is None else f"{median:.3g}" for median in medians),
        )
    return table
