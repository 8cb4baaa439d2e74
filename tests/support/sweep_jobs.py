"""Jobs that do to their worker process what a sweep has to survive; workers import this module by its name."""

import os
import signal
import time
from pathlib import Path


def nothing() -> None:
    """There is nothing to prepare."""


def die() -> None:
    """End the process, as a broken installation does."""
    os._exit(3)


def do(job: str) -> bytes:
    """What the job's first word says: "square 3", "kill", "kill-once MARK", "raise", "exit", "sleep 60", "environment"."""
    what, _, argument = job.partition(" ")
    if what == "square":
        return str(int(argument) ** 2).encode()
    if what == "kill-once":
        if Path(argument).exists():
            return b"second time"
        Path(argument).touch()
    if what in ("kill", "kill-once"):
        os.kill(os.getpid(), signal.SIGKILL)
    if what == "exit":
        os._exit(7)
    if what == "sleep":
        Path(argument).write_text(str(os.getpid()))
        time.sleep(60)
    if what == "environment":
        return os.environ["OPENBLAS_NUM_THREADS"].encode()
    raise ZeroDivisionError("of no use")
