"""Jobs on a Ray cluster: one of this machine alone, or the one that RAY_ADDRESS names. Needs the extra `cluster`."""

import os
import secrets
import time
from collections.abc import Generator, Iterable, Iterator
from contextlib import contextmanager
from typing import Any, Generic

from extremal.estimator.errors import ExtremalError
from extremal.scripts.sweep_attempts import SINGLE_THREAD, Attempts, Job, Outcome, Run, Task, environment

CLUSTER = "RAY_ADDRESS"


class RayMissing(ExtremalError, ImportError):
    """Ray is not installed."""


def run_on_ray(
    run: Run[Job], jobs: Iterable[Job], workers: int, timeout: float
) -> Generator[Outcome[Job], None, None]:
    """Run jobs as Ray's tasks; gives outcomes as they come.

    Without RAY_ADDRESS a Ray of its own is started, which listens on the loopback interface alone and wants a token that is drawn
    for this run. A cluster has its own; it must have the same extremal installed.

    Args:
        run: a function of a module that is installed on all nodes.
        jobs: each asked for when a worker is free.
        workers: number of tasks at a time, each on one CPU and one thread.
        timeout: [s] after which a job's worker is killed.

    Raises:
        RayMissing: Ray is not installed.
    """
    with _session(workers) as ray:
        tasks = _Tasks(ray, run, Attempts(jobs), timeout)
        while tasks.fill(workers):
            outcomes = tasks.wait()
            tasks.fill(workers)  # what is free computes while outcomes are kept
            yield from outcomes


class _Tasks(Generic[Job]):
    """What runs on Ray, and what is to run."""

    def __init__(self, ray: Any, run: Run[Job], attempts: Attempts[Job], timeout: float) -> None:
        # a failed job is not Ray's to repeat: that wouldn't be counted
        self._ray, self._remote = ray, ray.remote(max_retries=0, num_cpus=1)(run)
        self._attempts, self._timeout = attempts, timeout
        self._running: dict[Any, tuple[Task[Job], float]] = {}  # by reference: task, deadline [s]

    def fill(self, number: int) -> bool:
        """Start what can be started; gives whether anything runs."""
        while len(self._running) < number and self._attempts.more():
            task = self._attempts.next()
            self._running[self._remote.remote(task.job)] = task, time.monotonic() + self._timeout
        return bool(self._running)

    def wait(self) -> list[Outcome[Job]]:
        """Wait until a task ends or is out of time, and give what became of the jobs."""
        first = min(deadline for _, deadline in self._running.values())
        left = max(0.0, first - time.monotonic())
        done, _ = self._ray.wait(list(self._running), num_returns=1, timeout=left)
        outcomes = [outcome for reference in done for outcome in self._ended(reference)]
        now = time.monotonic()
        for reference, (task, deadline) in list(self._running.items()):
            if now > deadline:
                self._ray.cancel(reference, force=True)
                del self._running[reference]
                outcomes += self._attempts.fail(task, f"it took more than {self._timeout:g} s")
        return outcomes

    def _ended(self, reference: Any) -> list[Outcome[Job]]:
        task, _ = self._running.pop(reference)
        try:
            return [Outcome(task.job, self._ray.get(reference))]
        except self._ray.exceptions.RayTaskError as error:
            return self._attempts.fail(task, f"{type(error.cause).__name__}: {error.cause}")
        except self._ray.exceptions.RayError as error:
            return self._attempts.fail(task, f"{type(error).__name__}: {str(error).partition('.')[0]}")


@contextmanager
def _session(workers: int) -> Iterator[Any]:
    """Ray, connected."""
    own = {
        "RAY_AUTH_MODE": "token",
        "RAY_AUTH_TOKEN": secrets.token_hex(32),
        "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0",  # as on those systems: the loopback interface, not all of them
        "RAY_USAGE_STATS_ENABLED": "0",
    }
    quiet = {"RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0"}  # what it says of a coming change of its own
    options: dict[str, Any] = {"log_to_driver": False, "logging_level": "ERROR"}
    if CLUSTER not in os.environ:
        options |= {"num_cpus": workers, "include_dashboard": False}
    with environment(quiet if CLUSTER in os.environ else quiet | own):
        try:
            import ray  # pyright: ignore[reportMissingImports]  of an extra
        except ImportError:
            raise RayMissing(
                "--engine is ray, which is not installed: pip install 'extremal[cluster]'; accepted without: local"
            ) from None
        ray.init(**options, runtime_env={"env_vars": SINGLE_THREAD})
        try:
            yield ray
        finally:
            ray.shutdown()
