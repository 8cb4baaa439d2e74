"""Jobs on worker processes of this machine, any of which may die at any time.

A worker that dies is noticed at once and replaced, and its job is run again; a job that fails twice is given up. Workers end when
the process that has made them is gone, however it went.
"""

import os
import signal
import threading
import time
from collections.abc import Callable, Generator, Iterable, Iterator
from multiprocessing import get_context, parent_process
from multiprocessing.connection import Connection, wait
from typing import Any, Generic

from extremal.scripts.sweep_attempts import (
    SINGLE_THREAD,
    Attempts,
    Job,
    Outcome,
    Run,
    Task,
    WorkersFailed,
    environment,
)

MOST_STARTS = 10  # of workers in a row that die before they are ready
PATIENCE = 5.0  # [s] for a worker without a job to end by itself
READY = None


def run_locally(
    run: Run[Job], prepare: Callable[[], object], jobs: Iterable[Job], workers: int, timeout: float
) -> Generator[Outcome[Job], None, None]:
    """Run jobs on worker processes (spawned), each computing on one thread; gives outcomes as they come.

    Args:
        run: a function of a module, as `prepare`, so that workers find them.
        prepare: called once by every worker, before its first job.
        jobs: each asked for when a worker is free.
        workers: number of processes.
        timeout: [s] after which a job's worker is killed.

    Raises:
        WorkersFailed: one worker after the other dies before it is ready.
    """
    crew = _Crew(run, prepare, Attempts(jobs), timeout)
    try:
        while crew.at_work():
            crew.fill(workers)
            crew.wait()
            yield from crew.outcomes()
    finally:
        crew.end()


class _Crew(Generic[Job]):
    """The workers, and what they are to do."""

    def __init__(
        self, run: Run[Job], prepare: Callable[[], object], attempts: Attempts[Job], timeout: float
    ) -> None:
        self._run, self._prepare, self._attempts, self._timeout = run, prepare, attempts, timeout
        self._workers: list[_Worker[Job]] = []
        self._died = 0  # in a row, before they were ready

    def at_work(self) -> bool:
        return any(worker.task for worker in self._workers) or self._attempts.more()

    def fill(self, number: int) -> None:
        """Replace workers that are gone, and give jobs to those that are free."""
        while len(self._workers) < number:
            self._workers.append(_Worker(self._run, self._prepare))
        for worker in self._workers:
            self._occupy(worker)

    def wait(self) -> None:
        """Until a worker says something, is dead, or out of time."""
        deadlines = [worker.deadline for worker in self._workers if worker.task]
        left = max(0.0, min(deadlines) - time.monotonic()) if deadlines else None
        wait([end for worker in self._workers for end in worker.ends], left)

    def outcomes(self) -> Iterator[Outcome[Job]]:
        """What became of jobs since the last call. A worker has its next job before its outcome is given."""
        for worker in list(self._workers):
            said = worker.message()
            if said:
                yield from self._heard(worker, *said)
            elif not worker.alive() or (worker.task and time.monotonic() > worker.deadline):
                yield from self._lost(worker)

    def end(self) -> None:
        for worker in self._workers:
            worker.end()

    def _occupy(self, worker: "_Worker[Job]") -> None:
        if worker.ready and worker.task is None and self._attempts.more():
            worker.give(self._attempts.next(), self._timeout)

    def _heard(self, worker: "_Worker[Job]", well: bool, content: Any) -> list[Outcome[Job]]:
        if content is READY:
            worker.ready, self._died = True, 0
            return []
        task, worker.task = worker.task, None
        assert task is not None
        outcomes = [Outcome(task.job, content)] if well else self._attempts.fail(task, content)
        self._occupy(worker)
        return outcomes

    def _lost(self, worker: "_Worker[Job]") -> list[Outcome[Job]]:
        in_time = not worker.alive()
        worker.end()
        self._workers.remove(worker)
        reason = worker.last_words if in_time else f"it took more than {self._timeout:g} s"
        if not worker.ready:
            self._died += 1
            if self._died >= MOST_STARTS:
                raise WorkersFailed(
                    f"{self._died} worker processes in a row died before they were ready: {reason}; accepted: an "
                    "installation in which a new process can import extremal"
                )
        return self._attempts.fail(worker.task, reason) if worker.task else []


class _Worker(Generic[Job]):
    """A process, and what it is doing."""

    def __init__(self, run: Run[Job], prepare: Callable[[], object]) -> None:
        context = get_context("spawn")
        self._connection, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(run, prepare, theirs), daemon=True)
        with environment(SINGLE_THREAD):
            self._process.start()
        theirs.close()
        self.ready = False
        self.task: Task[Job] | None = None
        self.deadline = 0.0  # [s] on the monotonic clock

    @property
    def ends(self) -> tuple[Any, ...]:
        """What becomes readable when it says something, and when it dies."""
        return self._connection, self._process.sentinel

    @property
    def last_words(self) -> str:
        """How a dead process ended."""
        code = self._process.exitcode or 0
        return (
            f"killed by {signal.Signals(-code).name}" if code < 0 else f"its process ended with status {code}"
        )

    def alive(self) -> bool:
        return self._process.is_alive()

    def give(self, task: Task[Job], timeout: float) -> None:
        self.task, self.deadline = task, time.monotonic() + timeout
        try:
            self._connection.send(task.job)
        except (BrokenPipeError, ConnectionResetError):  # it has just died; that is found at the next look
            self._process.join()

    def message(self) -> tuple[bool, Any] | None:
        """What it said: whether all is well, and READY, a result or what went wrong. None: nothing whole."""
        try:
            return self._connection.recv() if self._connection.poll() else None
        except (EOFError, ConnectionResetError):  # it died, maybe within a word
            self._process.join()
            return None

    def end(self) -> None:
        """End the process: one that is idle by itself, another by force."""
        self._connection.close()
        if self.ready and self.task is None:
            self._process.join(PATIENCE)
        self._process.kill()
        self._process.join()


def _serve(run: Run[Job], prepare: Callable[[], object], connection: Connection) -> None:
    """What a worker does: run what comes, until nothing can come any more."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # an interrupt of the whole group is the parent's to handle
    threading.Thread(target=_end_with_parent, daemon=True).start()
    prepare()
    connection.send((True, READY))
    while True:
        try:
            job = connection.recv()
        except EOFError:
            return
        try:
            message = True, run(job)
        except Exception as error:  # noqa: BLE001  whatever it is, it is told
            message = False, f"{type(error).__name__}: {error}"
        connection.send(message)


def _end_with_parent() -> None:
    """End this process when its parent is gone, whatever it is computing."""
    parent = parent_process()
    assert parent is not None
    wait([parent.sentinel])
    os._exit(1)
