"""Files from anywhere, read without harm: regular ones alone, of limited size; TOML that is not nested without end."""

import os
import re
import stat
import tomllib
from pathlib import Path
from typing import Any, BinaryIO

from extremal.estimator.errors import InvalidInput

MOST_PARTS = 16  # of a dotted key: what the parser takes grows with the square of their number
_PART = r"""(?:"(?:[^"\\\n]|\\.)*+"|'[^'\n]*+'|[\w-]++)"""
_DOTTED = re.compile(rf"(?<![\w\\-]){_PART}(?:[ \t]*+\.[ \t]*+{_PART}){{{MOST_PARTS}}}")


def open_regular(path: Path) -> BinaryIO:
    """Open a file for reading; a pipe, device or socket is not waited for. Raises OSError, ValueError."""
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOCTTY", 0)
    file = os.fdopen(os.open(path, flags), "rb")
    if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        file.close()
        raise OSError("it is no regular file")
    return file


def read_bytes(path: Path, largest: int) -> bytes:
    """All of a regular file of up to `largest` bytes.

    Raises:
        InvalidInput: there is none, it can't be read, or it is larger.
    """
    if not path.is_file():
        raise InvalidInput(f"{path.name!r} does not exist, or is no regular file")
    try:
        with open_regular(path) as file:
            content = file.read(largest + 1)
    except (OSError, ValueError, MemoryError) as error:
        raise InvalidInput(f"{path.name!r} cannot be read: {_one_line(error)}") from None
    if len(content) > largest:
        raise InvalidInput(f"{path.name!r} is larger than the accepted {largest} bytes")
    return content


def read_toml(path: Path, largest: int) -> dict[str, Any]:
    """The tables of a TOML file of up to `largest` bytes.

    Raises:
        InvalidInput: it can't be read, is no text in UTF-8, or is malformed or nested too deeply.
    """
    content = read_bytes(path, largest)
    try:
        text = content.decode("utf-8")
    except UnicodeError:
        raise InvalidInput("it cannot be read as text; accepted: TOML in UTF-8") from None
    deep = _DOTTED.search(text)
    if deep:
        raise InvalidInput(
            f"line {text.count(chr(10), 0, deep.start()) + 1} has the dotted key {deep.group()[:40]!r}...; "
            f"accepted: up to {MOST_PARTS} parts"
        )
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise InvalidInput("its lists or tables are nested too deeply; accepted: a few levels") from None
    except ValueError as error:  # too many digits included
        raise InvalidInput(f"malformed TOML: {_one_line(error)}") from None


def shown(value: object) -> str:
    """What an error shows of a value: its first 60 characters, in one line; Python refuses to write integers of many digits."""
    try:
        return " ".join(f"{value!r:.60}".split())
    except ValueError:
        return f"of type {type(value).__name__} with too many digits"


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())[:200]
