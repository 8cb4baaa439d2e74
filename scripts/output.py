"""Folders of results: each result appears whole or not at all."""

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from extremal.estimator import InvalidInput


@contextmanager
def output_folder(out: Path) -> Iterator[Path]:
    """A temporary folder beside `out`, whose contents take their places in `out` when all went well.

    Contents of an existing `out` are replaced where they have the same names and left alone otherwise. When the block
    raises, nothing is left behind.

    Raises InvalidInput where `out` can't be written.
    """
    parents = [p for p in (out.parent, *out.parent.parents) if not p.exists()]
    try:
        if out.exists() and not out.is_dir():
            raise NotADirectoryError(0, "it is a file")
        if out.is_dir() and not os.access(out, os.W_OK):
            raise PermissionError(0, "permission denied")
        out.parent.mkdir(parents=True, exist_ok=True)
        folder = Path(tempfile.mkdtemp(prefix=f".{out.name}-", dir=out.parent))
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise InvalidInput(f"--out {out} can't be written: {reason}; accepted: a writable folder") from None
    try:
        yield folder
        out.mkdir(exist_ok=True)
        for made in sorted(folder.iterdir(), key=lambda path: path.is_file()):  # folders first, results last
            _place(made, out / made.name)
        shutil.rmtree(folder)
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        for parent in parents:  # those made above, innermost first
            with suppress(OSError):
                parent.rmdir()
        raise


def _place(made: Path, place: Path) -> None:
    """Move a file or a folder of numbered frames; of an existing folder, only its numbered frames are replaced."""
    if made.is_file() or not place.is_dir():
        os.replace(made, place)
        return
    for old in place.glob("*.png"):
        if old.stem.isdigit():
            old.unlink()
    for item in made.iterdir():
        os.replace(item, place / item.name)
