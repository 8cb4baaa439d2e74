"""Machine code for the loops of a step: a few dozen tracks are too few for numpy's calls to pay.

It is made once, when the first environment is used (a minute or two), and kept beside the modules. numba looks for changes of
the file of a function alone, not of what it calls in others: here all is made anew when any of it has changed.
"""

import hashlib
import sys
from collections.abc import Callable
from pathlib import Path
from typing import ParamSpec, TypeVar

from numba import njit

from extremal.estimator.files import write_whole

P = ParamSpec("P")
R = TypeVar("R")

_FOLDER = Path(__file__).parent
_KEPT = _FOLDER / "__pycache__"
_MADE_FROM = _KEPT / "compiled.sha256"


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """The function as machine code, kept on disk between runs; to rounding the same on every machine (no fastmath).

    Divisions by zero give infinite numbers or NaN, as numpy's do: to look out for them would take a tenth of a step.
    """
    return njit(cache=True, error_model="numpy")(function)


def _sources() -> str:
    """SHA-256 of all modules that hold compiled functions."""
    texts = [path.read_bytes() for path in sorted(_FOLDER.glob("*.py"))]
    return hashlib.sha256(b"".join(text for text in texts if b"@compiled" in text)).hexdigest()


def _renew() -> None:
    """Remove machine code of other sources; where nothing can be written, numba keeps it elsewhere."""
    now = _sources()
    try:
        if _MADE_FROM.exists() and _MADE_FROM.read_text() == now:
            return
        _KEPT.mkdir(exist_ok=True)
        for path in (*_KEPT.glob("*.nbi"), *_KEPT.glob("*.nbc")):
            path.unlink(missing_ok=True)
        write_whole(_MADE_FROM, now)
    except OSError:
        return
    print("extremal: compiling the loops of the tasks, once: a minute or two", file=sys.stderr)


_renew()
