"""Jobs of a sweep, each tried until it has a result or has failed too often."""

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Generic, TypeVar

from extremal.estimator.errors import ExtremalError

MOST_ATTEMPTS = 2
SINGLE_THREAD = {  # what the environment of a process says that computes on one thread
    name: "1"
    for name in (
        "OPENBLAS_NUM_THREADS",
        "OMP_NUM_THREADS",
        "MKL_NUM_THREADS",
        "OPENCV_FOR_THREADS_NUM",
        "LP_NUM_THREADS",
    )
}
Job = TypeVar("Job")
Run = Callable[[Job], bytes]


class WorkersFailed(ExtremalError, RuntimeError):
    """Worker processes can't be started."""


@dataclass(frozen=True)
class Outcome(Generic[Job]):
    """How a job ended: its result; or None, and why it was given up."""

    job: Job
    result: bytes | None
    reason: str = ""


@dataclass
class Task(Generic[Job]):
    """A job, and how often it has failed: raised, killed its worker, or ran out of time."""

    job: Job
    failures: int = 0


class Attempts(Generic[Job]):
    """What is still to be done, failed jobs first. `jobs` are asked for one by one, when they are needed."""

    def __init__(self, jobs: Iterable[Job]) -> None:
        self._jobs, self._next = iter(jobs), deque[Task[Job]]()

    def more(self) -> bool:
        """Whether there is a next task now; one that is running may come back."""
        if not self._next:
            self._next.extend(Task(job) for job in [next(self._jobs, None)] if job is not None)
        return bool(self._next)

    def next(self) -> Task[Job]:
        """The next task; there has to be one."""
        return self._next.popleft()

    def fail(self, task: Task[Job], reason: str) -> list[Outcome[Job]]:
        """Have a task run again; or give it up, which is its outcome."""
        task.failures += 1
        if task.failures < MOST_ATTEMPTS:
            self._next.appendleft(task)
            return []
        return [Outcome(task.job, None, f"it failed {MOST_ATTEMPTS} times, the last time: {reason}")]


@contextmanager
def environment(values: Mapping[str, str]) -> Iterator[None]:
    """Environment variables for processes that are started meanwhile."""
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
