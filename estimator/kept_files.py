"""Files that are kept once they are acknowledged, whichever process is killed and when."""

import os
import tempfile
from contextlib import suppress
from pathlib import Path

TEMPORARY = ".part-"  # how names of files begin that are being written


def keep_first(path: Path, content: bytes) -> bool:
    """Write a file that is not there yet: all of it or nothing, on the disk when this returns; of several writers the first
    wins.

    The content goes to a temporary name beside it, is synchronised, and linked to its own name.

    Returns whether this was the first. Raises OSError, also where the file system has no hard links.
    """
    with tempfile.NamedTemporaryFile(prefix=TEMPORARY, dir=path.parent, delete=False) as file:
        temporary = Path(file.name)
        try:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
            temporary.chmod(0o644)
            os.link(temporary, path)
            first = True
        except FileExistsError:
            first = False
        finally:
            with suppress(FileNotFoundError):
                temporary.unlink()
    synchronise(path.parent)
    return first


def synchronise(folder: Path) -> None:
    """Have the names in a folder on the disk. Raises OSError."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
