"""Progress bars of long work."""

from collections.abc import Callable
from functools import partial

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

Advance = Callable[[int, int], None]  # (done, total)


def progress_bars(console: Console) -> Progress:
    """Bars with counts and times, gone when all is done; a context manager."""
    columns = (TextColumn("{task.description:>12}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    return Progress(*columns, console=console, transient=True)


def bar(progress: Progress | None, name: str, total: int | None = None) -> Advance | None:
    """A further bar, as a function that moves it; None where nothing is shown."""
    if progress is None:
        return None
    advance = partial(progress.update, progress.add_task(name, total=total))
    return lambda done, total: advance(completed=done, total=total)
