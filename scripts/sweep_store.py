"""Results of a sweep on the disk: a file a trial, written once, and the table that they are merged into."""

import csv
import hashlib
import io
import json
import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from extremal.estimator.errors import InvalidInput
from extremal.estimator.files import write_whole
from extremal.estimator.kept_files import TEMPORARY, keep_first
from extremal.scripts.sweep_trials import Trial

STALE = 3600.0  # [s] after which a temporary file is a killed process's
QUARANTINED = "quarantined"
ABOUT, FAILED, TABLE, DIGEST = "sweep.json", "quarantined.json", "results.csv", "digest.txt"
TIMINGS = ("seconds",)
Row = dict[str, Any]


class Store:
    """The folder of a sweep. Any number of processes may use it at a time.

    Attributes:
        folder: with `trials/<key>.json`, and when all have run the table.
    """

    def __init__(self, folder: Path) -> None:
        """Open or make the folder; raises InvalidInput where it can't be written, or other code has made it."""
        self.folder, self._kept = folder, folder / "trials"
        try:
            self._kept.mkdir(parents=True, exist_ok=True)
            own = json.dumps({"version": version("extremal")}).encode()
            keep_first(folder / ABOUT, own)
            found = (folder / ABOUT).read_bytes()
        except OSError as error:
            reason = (error.strerror or str(error)).lower()
            raise InvalidInput(
                f"--out {folder} can't be written: {reason}; accepted: a writable folder"
            ) from None
        if found != own:
            raise InvalidInput(
                f"--out {folder} holds {found.decode()}; accepted: a new folder, or one of {own.decode()}"
            )
        self._remove_stale()

    def has(self, trial: Trial) -> bool:
        """Whether the trial's result is kept."""
        return self._path(trial).exists()

    def keep(self, trial: Trial, result: bytes) -> None:
        """Keep a result; when this returns, it stays whatever is killed. The first one of a trial wins."""
        keep_first(self._path(trial), result)

    def merge(self, trials: Sequence[Trial], names: Sequence[str], failed: Mapping[str, str]) -> list[Row]:
        """Write the table, its digest and what is in quarantine, and give the rows.

        Args:
            trials: all of the sweep; each has a result, or a reason in `failed`, by its key.
            names: of the settings that have a column.
        """
        rows = _rows([(trial, self._read(trial)) for trial in trials], names)
        text = csv_text(rows)
        write_whole(self.folder / TABLE, text)
        write_whole(self.folder / DIGEST, digest(rows) + "\n")
        self._write_failed(trials, failed)
        write_parquet(rows, self.folder / "results.parquet")
        return rows

    def _write_failed(self, trials: Sequence[Trial], failed: Mapping[str, str]) -> None:
        path = self.folder / FAILED
        listed = [
            {"key": t.key, "settings": dict(t.settings), "repetition": t.repetition, "reason": failed[t.key]}
            for t in trials
            if t.key in failed
        ]
        if listed:
            write_whole(path, json.dumps(listed, indent=1) + "\n")
        else:
            path.unlink(missing_ok=True)

    def _read(self, trial: Trial) -> Row:
        try:
            return json.loads(self._path(trial).read_bytes())
        except FileNotFoundError:
            return {"status": QUARANTINED, "message": "", "result": {}, "seconds": None}

    def _path(self, trial: Trial) -> Path:
        return self._kept / f"{trial.key}.json"

    def _remove_stale(self) -> None:
        for path in [*self._kept.glob(f"{TEMPORARY}*"), *self.folder.glob(f"{TEMPORARY}*")]:
            with suppress(FileNotFoundError):
                if path.stat().st_mtime < time.time() - STALE:
                    path.unlink()


def _rows(found: Iterable[tuple[Trial, Row]], names: Sequence[str]) -> list[Row]:
    """A row a trial, all with the same columns: key, settings, repetition, status, message, results by their names, timings."""
    found = list(found)
    results = sorted({name for _, content in found for name in content["result"]})
    return [
        {"key": trial.key}
        | {name: trial.settings.get(name) for name in names}
        | {"repetition": trial.repetition, "status": content["status"], "message": content["message"]}
        | {name: content["result"].get(name) for name in results}
        | {"seconds": content["seconds"]}
        for trial, content in found
    ]


def csv_text(rows: Sequence[Row]) -> str:
    """The rows as CSV with a header; empty: there is none."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def digest(rows: Sequence[Row]) -> str:
    """SHA-256 (hexadecimal) of the table's lines, without header and timings, sorted."""
    less = [{name: value for name, value in row.items() if name not in TIMINGS} for row in rows]
    _, *lines = csv_text(less).splitlines()
    return hashlib.sha256("".join(f"{line}\n" for line in sorted(lines)).encode()).hexdigest()


def write_parquet(rows: Sequence[Row], path: Path) -> bool:
    """The table as Parquet, where pyarrow or polars is installed; gives whether one is."""
    part = path.with_name(f"{TEMPORARY}{path.name}")
    if find_spec("pyarrow"):
        import pyarrow as pa  # pyright: ignore[reportMissingImports]
        import pyarrow.parquet as pq  # pyright: ignore[reportMissingImports]

        pq.write_table(pa.Table.from_pylist(list(rows)), part)
    elif find_spec("polars"):
        import polars as pl  # pyright: ignore[reportMissingImports]  one of the two is enough

        pl.DataFrame(list(rows), infer_schema_length=None).write_parquet(part)
    else:
        return False
    part.replace(path)
    return True
