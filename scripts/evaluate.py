"""`extremal evaluate`: a policy's success over the test episodes, with confidence intervals."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from rich.box import SIMPLE
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from extremal.estimator import InvalidInput
from extremal.sim.arm_errors import ArmName
from extremal.tasks.evaluation import Evaluation, leaderboard, run_evaluation, write_json


@dataclass(frozen=True)
class EvaluateSettings:
    """Evaluate a policy; writes evaluation.json and leaderboard.json. Started again, it goes on where it was stopped."""

    env: Literal["Inspect", "Navigate", "Grasp"] = "Navigate"
    """the task"""
    policy: str = "active"
    """random, oracle, active, parallax, absolute, blind, or module:Class of your own"""
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
    write_json(settings.out / "evaluation.json", found)
    rows = leaderboard(settings.out / "leaderboard.json", found)
    console.print(_metrics_table(found))
    console.print(_leaderboard_table(rows))
    console.print(f"wrote {settings.out}/: evaluation.json and leaderboard.json")


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


def _leaderboard_table(rows: list[dict[str, Any]]) -> Table:
    table = Table(title="leaderboard", box=SIMPLE)
    for name in ("setting", "policy", "episodes", "success", "95 %", "score"):
        table.add_column(name, no_wrap=name != "setting")
    for row in rows:
        low, high = row["success_ci95"]
        setting = " ".join(str(row[k]) for k in ("env", "tier", "sensor", "arm") if row[k])
        table.add_row(
            setting,
            row["policy"],
            str(row["episodes"]),
            f"{100 * row['success_rate']:.1f} %",
            f"{100 * low:.1f}-{100 * high:.1f} %",
            "-" if row["score"] is None else f"{row['score']:.2f}",
        )
    return table
