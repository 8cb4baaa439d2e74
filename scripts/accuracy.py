"""`extremal accuracy`: how near to the truth and to the bound the estimates are; makes the tables of docs/accuracy.md."""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, get_args

from rich.console import Console
from rich.progress import Progress

from extremal.estimator import InvalidInput
from extremal.scenes import load_scene
from extremal.scripts.discrimination_study import discrimination_study, limit_table
from extremal.scripts.edge_study import edge_study, edge_table
from extremal.scripts.egomotion_study import egomotion_study, egomotion_table
from extremal.scripts.general_study import general_study, general_table
from extremal.scripts.joint_study import joint_study, study_table
from extremal.scripts.look_study import look_study, look_table, ray_accuracy, ray_table
from extremal.scripts.output import output_folder
from extremal.scripts.rendered_study import rendered_study, rendered_table
from extremal.scripts.report import Report, pipe_table
from extremal.scripts.spatial_study import spatial_study

Study = Literal["rays", "looks", "edges", "planar", "space", "rendered", "general", "limits", "egomotion"]
EDGE_FRAMES = 5  # more change nothing
POINTS = 10  # of an object, in the study of general motion


@dataclass(frozen=True)
class AccuracySettings:
    """Measure accuracy on rays, tangent planes and rendered frames; writes report.html, accuracy.md and accuracy.json.

    rays: circles from exact rays. looks: rendered frames, exact poses. edges: localisation alone. planar, space: joint
    estimation with pose errors of 1 mm and 1 mrad against other methods and the Cramer-Rao bound. rendered: the same on
    rendered frames. general: general motion to second order. limits: the smallest R told from a fixed feature. egomotion: what
    renderer, edges, intrinsics and poses of three arms cost.
    """

    studies: tuple[Study, ...] = get_args(Study)
    """which to run"""
    scene: str = "vase-and-box"
    """a preset's name, or a TOML file, of which random variations are looked at (looks)"""
    seeds: int = 20
    """number of random vases (looks, rendered, egomotion)"""
    trials: int = 1000
    """number of trials a row (planar, space, rendered, general, limits)"""
    out: Path = Path("out/accuracy")
    """folder that is written; what was there of the same names is replaced"""


def accuracy(settings: AccuracySettings) -> None:
    """Run the studies and write their tables."""
    for name, value, most in (("seeds", settings.seeds, 10_000), ("trials", settings.trials, 1_000_000)):
        if not 1 <= value <= most:
            raise InvalidInput(f"--{name} is {value}; accepted: 1 to {most}")
    load_scene(settings.scene)
    console = Console(markup=False)
    content, tables = {}, []
    with output_folder(settings.out) as folder, Progress(console=console, transient=True) as progress:
        for study in dict.fromkeys(settings.studies):
            task = progress.add_task(study, total=None)

            def advance(done: int, total: int, task: Any = task) -> None:
                progress.update(task, completed=done, total=total)

            rows, table = _run(study, settings, advance)
            progress.update(task, total=1, completed=1)
            content[study] = rows
            tables.append(f"## {study}\n\n{table}")
        (folder / "accuracy.json").write_text(json.dumps(content, indent=1) + "\n")
        (folder / "accuracy.md").write_text("\n\n".join(tables) + "\n")
        _report(settings, tables).save(folder / "report.html")
    console.print("\n\n".join(tables), soft_wrap=True, markup=False)
    console.print(f"wrote {settings.out}/: report.html, accuracy.md and accuracy.json")


def _report(settings: AccuracySettings, tables: Sequence[str]) -> Report:
    """The tables, each of them "## study", a blank line, and a table in Markdown."""
    report = Report("extremal accuracy", f"{settings.seeds} random vases, {settings.trials} trials a row")
    for text in tables:
        title, _, table = text.partition("\n\n")
        report.section(title.removeprefix("## ")).table(pipe_table(table))
    return report.section("How it was made").settings(asdict(settings))


def _run(study: Study, settings: AccuracySettings, progress: Callable[[int, int], None]) -> tuple[Any, str]:
    """Rows of one study, as JSON takes them, and their table."""
    trials, seeds = settings.trials, settings.seeds
    each = -(-trials // seeds)
    if study == "rays":
        rays = ray_accuracy()
        return rays, ray_table(rays)
    rows: Sequence[Any]
    if study == "looks":
        rows = look_study(settings.scene, seeds, progress)
        table = look_table(rows)
    elif study == "edges":
        rows = edge_study(min(seeds, EDGE_FRAMES))
        table = edge_table(rows)
    elif study == "planar":
        rows = joint_study(trials, progress)
        table = study_table(rows)
    elif study == "space":
        rows = spatial_study(trials, progress)
        table = study_table(rows)
    elif study == "rendered":
        rows = rendered_study(seeds, each, progress)
        table = rendered_table(rows)
    elif study == "general":
        rows = general_study(max(1, trials // POINTS), POINTS)
        table = general_table(rows)
    elif study == "limits":
        rows = discrimination_study(trials)
        table = limit_table(rows)
    else:
        rows = egomotion_study(seeds, progress)
        table = egomotion_table(rows)
    return [asdict(row) for row in rows], table
