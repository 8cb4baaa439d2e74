"""Folders of results that appear whole or not at all."""

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from extremal.estimator import InvalidInput


@contextmanager
def output_folder(out: Path, result: str) -> Iterator[Path]:
    """A temporary folder beside `out` that takes its place when all went well, and vanishes otherwise.

    An existing `out` is replaced only if it is empty or holds the file `result`.

    Raises InvalidInput where `out` can't be written.
    """
    if out.exists() and not (out.is_dir() and (not any(out.iterdir()) or (out / result).exists())):
        raise InvalidInput(
            f"--out {out} exists and holds no {result}; accepted: a new folder, or one to replace"
        )
    parents = [p for p in (out.parent, *out.parent.parents) if not p.exists()]
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        folder = Path(tempfile.mkdtemp(prefix=f".{out.name}-", dir=out.parent))
    except OSError as error:
        raise InvalidInput(
            f"--out {out} can't be written: {error.strerror}; accepted: a writable folder"
        ) from None
    try:
        yield folder
        folder.chmod(0o777 & ~_umask())
        if out.exists():
            old = Path(tempfile.mkdtemp(prefix=f".{out.name}-", dir=out.parent))
            os.replace(out, old / out.name)
            os.replace(folder, out)
            shutil.rmtree(old)
        else:
            os.replace(folder, out)
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        for parent in parents:  # those made above, innermost first
            with suppress(OSError):
                parent.rmdir()
        raise


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
