"""`extremal report`: plots of a sweep with confidence intervals."""

import csv
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from matplotlib.axes import Axes
from numpy.typing import NDArray
from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table
from scipy.stats import binom

from extremal.estimator.errors import InvalidInput
from extremal.scripts.report import Report
from extremal.scripts.sweep_store import TABLE
from extremal.scripts.sweep_trials import OK
from extremal.tasks.metrics import wilson_interval

REPORT = "report.html"
FIXED_COLUMNS = ("key", "repetition", "status", "message", "seconds")
TRUTHS = {"True": 1.0, "False": 0.0}
MOST_LINES, MOST_VALUES, BINS = 6, 12, 8
COLOURS = ("#1f77b4", "#ff7f0e", "#2ca02c", "#d62728", "#9467bd", "#8c564b")


@dataclass(frozen=True)
class ReportSettings:
    """Plot a sweep's results.csv; writes report.html beside it."""

    folder: tyro.conf.Positional[Path]
    """of the sweep"""
    metrics: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME")] = ()
    """columns to plot; by default all results that are numbers, or true or false"""
    by: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME")] = ()
    """columns to plot them by; by default all settings that differ between trials"""


@dataclass(frozen=True, eq=False)
class Summary:
    """A statistic with its 95 % interval, and of how many trials it is."""

    value: float
    low: float
    high: float
    number: int


def report(settings: ReportSettings) -> None:
    """Write the report. Raises InvalidInput where there is no table, or no such column."""
    table = Results.read(settings.folder / TABLE)
    metrics = table.chosen(settings.metrics, table.metrics, "--metrics")
    by = table.chosen(settings.by, table.swept, "--by")
    summary = _summary_table(table, metrics)
    made = Report("extremal report", f"{settings.folder.name}: {len(table.rows)} trials")
    made.facts({status: str(number) for status, number in table.statuses.items()}).table(summary)
    for metric in metrics:
        made.section(metric)
        for name in by:
            what = (
                "rate, Wilson's interval" if table.is_rate(metric) else "median, interval by order statistics"
            )
            caption = f"{metric} by {name}: {what}, 95 %; over everything else that differs."
            made.figure(partial(_draw, table=table, metric=metric, by=name, over=by), caption)
    made.section("How it was made").settings(table.constant)
    made.save(settings.folder / REPORT)
    console = Console()
    console.print(summary)
    console.print(f"wrote {settings.folder / REPORT}", highlight=False)


@dataclass(frozen=True, eq=False)
class Results:
    """The rows of a sweep, as texts by column. Settings come before `repetition`, results after `message`."""

    rows: list[dict[str, str]]

    @staticmethod
    def read(path: Path) -> "Results":
        try:
            with path.open(encoding="utf-8", newline="") as file:
                rows = list(csv.DictReader(file))
        except (OSError, UnicodeDecodeError, csv.Error) as error:
            raise InvalidInput(
                f"{path} can't be read: {error}; accepted: the folder of a sweep that has ended"
            ) from None
        if not rows or not set(FIXED_COLUMNS) <= set(rows[0]) or any(None in (*r, *r.values()) for r in rows):
            raise InvalidInput(
                f"{path} is no table of a sweep; accepted: the folder of a sweep that has ended"
            )
        return Results(rows)

    @property
    def columns(self) -> list[str]:
        return list(self.rows[0])

    @property
    def statuses(self) -> dict[str, int]:
        return dict(Counter(row["status"] for row in self.rows).most_common())

    @property
    def metrics(self) -> list[str]:
        names = self.columns[self.columns.index("message") + 1 :]
        return [n for n in names if n not in FIXED_COLUMNS and self.numbers(n) is not None]

    @property
    def _settings(self) -> list[str]:
        return self.columns[1 : self.columns.index("repetition")]

    @property
    def swept(self) -> list[str]:
        return [name for name in self._settings if len(self.values(name)) > 1]

    @property
    def constant(self) -> dict[str, str]:
        return {name: self.rows[0][name] for name in self._settings if len(self.values(name)) == 1}

    def values(self, name: str) -> list[str]:
        """Different texts in a column, in order."""
        return list(dict.fromkeys(row[name] for row in self.rows))

    def is_rate(self, name: str) -> bool:
        return set(self.values(name)) - {""} <= set(TRUTHS)

    def numbers(self, name: str) -> NDArray[np.floating] | None:
        """A column (n,) as numbers, NaN where it is empty; None where it holds texts, or nothing."""
        try:
            found = [TRUTHS[t] if t in TRUTHS else float(t or "nan") for t in (r[name] for r in self.rows)]
        except ValueError:
            return None
        return np.array(found) if np.isfinite(found).any() else None

    def texts(self, name: str) -> NDArray[np.str_]:
        return np.array([row[name] for row in self.rows])

    def chosen(self, names: Sequence[str], usual: list[str], option: str) -> list[str]:
        known = [name for name in self.columns if name not in FIXED_COLUMNS]
        for name in names:
            if name not in known or (option == "--metrics" and self.numbers(name) is None):
                raise InvalidInput(f"{option} is {name!r}; accepted: {', '.join(known)}")
        return list(names) or usual


def median_interval(values: NDArray[np.floating], confidence: float = 0.95) -> tuple[float, float]:
    """Interval of the median by order statistics, whatever the distribution (David and Nagaraja 2003, sec. 7.1); infinite
    where there are too few values.

    Args:
        values: (n,) finite.
        confidence: it is covered with this probability, or a higher one.
    """
    n, ordered = len(values), np.sort(values)
    first = (
        int(binom.ppf((1 - confidence) / 2, n, 0.5)) - 1
    )  # P(fewer than first + 1 below the median) < (1 - c) / 2
    if n == 0 or first < 0:
        return -np.inf, np.inf
    return float(ordered[first]), float(ordered[n - 1 - first])


def summarised(values: NDArray[np.floating], rate: bool) -> Summary:
    """The rate of what is true, or the median, of the values that are known."""
    known = values[np.isfinite(values)]
    if len(known) == 0:
        return Summary(np.nan, np.nan, np.nan, 0)
    if rate:
        return Summary(float(known.mean()), *wilson_interval(int(known.sum()), len(known)), len(known))
    return Summary(float(np.median(known)), *median_interval(known), len(known))


def _groups(table: Results, name: str) -> list[tuple[float | str, NDArray[np.bool_]]]:
    """Where (n,) a column has each of its values; numbers in order, and many of them in bins of equal numbers of trials."""
    numbers, texts = table.numbers(name), table.texts(name)
    if numbers is None or not np.isfinite(numbers).all():
        return [(text or "-", texts == text) for text in table.values(name)]
    values = np.unique(numbers)
    if len(values) <= MOST_VALUES:
        return [(float(value), numbers == value) for value in values]
    edges = np.unique(np.quantile(numbers, np.linspace(0, 1, BINS + 1)))
    bins = np.clip(np.searchsorted(edges, numbers, side="right") - 1, 0, len(edges) - 2)
    return [(float(np.median(numbers[bins == i])), bins == i) for i in np.unique(bins)]


def _draw(axes: Axes, table: Results, metric: str, by: str, over: Sequence[str]) -> None:
    numbers, rate = table.numbers(metric), table.is_rate(metric)
    assert numbers is not None
    lines = _lines(table, [name for name in over if name != by])
    groups = _groups(table, by)
    numeric = all(isinstance(value, float) for value, _ in groups)
    scale = 100.0 if rate else 1.0
    for i, (label, line) in enumerate(lines):
        found = [summarised(numbers[line & rows], rate) for _, rows in groups]
        x = (
            np.array([value for value, _ in groups], float)
            if numeric
            else np.arange(len(groups), dtype=float)
        )
        y = scale * np.array([s.value for s in found])
        ends = scale * np.array([[s.low, s.high] for s in found]).T
        bars = np.where(np.isfinite(ends), np.abs(ends - y), 0.0)
        shift = 0.0 if numeric else 0.08 * (i - (len(lines) - 1) / 2)
        axes.errorbar(
            x + shift, y, yerr=bars, fmt="o-" if numeric else "o", color=COLOURS[i], capsize=3,
            markersize=4, linewidth=1, label=label,
        )  # fmt: skip
    if not numeric:
        axes.set_xticks(np.arange(len(groups)), [str(value) for value, _ in groups], rotation=20, ha="right")
    elif _spans_decades(np.array([value for value, _ in groups], float)):
        axes.set_xscale("log")
    if len(lines) > 1:
        axes.legend(fontsize=8)
    axes.set(xlabel=by, ylabel=f"{metric} [%]" if rate else metric)
    axes.grid(alpha=0.25)


def _lines(table: Results, names: Sequence[str]) -> list[tuple[str | None, NDArray[np.bool_]]]:
    """One line for each value of the first column that has few; or one of all trials."""
    for name in names:
        values = table.values(name)
        if len(values) <= MOST_LINES:
            return [(f"{name} = {value}", table.texts(name) == value) for value in values]
    return [(None, np.ones(len(table.rows), bool))]


def _spans_decades(x: NDArray[np.floating]) -> bool:
    return bool(x.min() > 0 and x.max() >= 10 * x.min())


def _summary_table(table: Results, metrics: Sequence[str]) -> Table:
    shown = Table(title="all trials: rates and medians", box=SIMPLE)
    for name in ("result", "trials", "value", "95 %"):
        shown.add_column(name, justify="left" if name == "result" else "right", no_wrap=True)
    for metric in metrics:
        numbers = table.numbers(metric)
        assert numbers is not None
        s = summarised(numbers, table.is_rate(metric))
        shown.add_row(metric, str(s.number), f"{s.value:.4g}", f"{s.low:.4g} to {s.high:.4g}")
    shown.caption = f"{table.statuses.get(OK, 0)} of {len(table.rows)} trials have results"
    return shown
