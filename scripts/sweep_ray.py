"""Jobs on a Ray cluster: one of this machine alone, or the one that RAY_ADDRESS names. Needs the extra `cluster`."""

import os
import secrets
import socket
import sys
import time
from collections.abc import Generator, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
from importlib.metadata import version
from ipaddress import ip_address
from typing import Any, Generic
from urllib.parse import urlsplit

from extremal.estimator.errors import ExtremalError
from extremal.scripts.sweep_attempts import SINGLE_THREAD, Attempts, Job, Outcome, Run, Task, environment

CLUSTER = "RAY_ADDRESS"
PATIENCE = 10.0  # [s] for a cluster to answer
LONGEST_START = 300.0  # [s] until one worker at least must be ready
LONGEST_REASON = 300  # characters
CLIENT = "ray://"  # Ray's client, which needs no node on this machine
ALIKE = "nodes with the same versions of extremal, Ray and Python"
MOST_STARTS = 10  # of workers in a row that die before they are ready
QUIET = {"RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0"}  # what it says of a coming change of its own
ONCE = {"RAY_NUM_REDIS_GET_RETRIES": "1"}  # tries to connect: a wrong token gets no better
LOOPBACK = {  # as on those systems: the loopback interface, which Ray would take for the machine's outer one
    "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0",
    "RAY_USAGE_STATS_ENABLED": "0",
}


class RayMissing(ExtremalError, ImportError):
    """Ray is not installed."""


class ClusterFailed(ExtremalError, RuntimeError):
    """A Ray cluster that can't be reached, refuses to work, or is not what is needed."""


def run_on_ray(
    run: Run[Job], jobs: Iterable[Job], workers: int, timeout: float
) -> Generator[Outcome[Job], None, None]:
    """Run jobs on Ray's actors; gives outcomes as they come.

    Without RAY_ADDRESS a Ray of its own is started, which listens on the loopback interface alone and wants a token that is drawn
    for this run. A cluster has its own; its nodes must have the same version of extremal.

    Args:
        run: a function of a module that is installed on all nodes.
        jobs: each asked for when a worker is free.
        workers: number of jobs at a time, each on one CPU and one thread.
        timeout: [s] after which a job's worker is killed; its start is not part of it.

    Raises:
        RayMissing: Ray is not installed.
        ClusterFailed: RAY_ADDRESS names no cluster that can be used, or that cluster is gone.
    """
    with _session(workers) as ray:
        crew = _Crew(ray, run, Attempts(jobs), timeout)
        try:
            while crew.at_work():
                crew.fill(workers)
                outcomes = crew.wait()
                crew.fill(workers)  # what is free computes while outcomes are kept
                yield from outcomes
        except ConnectionError as error:  # of Ray's client
            raise ClusterFailed(
                f"the Ray cluster is gone: {_line(error)}; accepted: one that runs until all is done; start again to go on"
            ) from None


class _Server(Generic[Job]):
    """What a worker is: an actor."""

    def prepare(self, needed: str, run: Run[Job]) -> None:
        """Be ready for jobs. With another version of extremal there would be other results."""
        found = version("extremal")
        if found != needed:
            raise ClusterFailed(f"extremal {found} instead of {needed}")
        self._run = run

    def do(self, job: Job) -> bytes:
        return self._run(job)


@dataclass(frozen=True, eq=False)
class _Call(Generic[Job]):
    """What a worker was asked for, until when [s]; without a task: to prepare itself."""

    actor: Any
    task: Task[Job] | None
    deadline: float


class _Crew(Generic[Job]):
    """Workers, and what they are to do."""

    def __init__(self, ray: Any, run: Run[Job], attempts: Attempts[Job], timeout: float) -> None:
        self._ray, self._run, self._attempts, self._timeout = ray, run, attempts, timeout
        # what fails is not Ray's to repeat: that wouldn't be counted
        self._new = ray.remote(num_cpus=1, max_restarts=0, max_task_retries=0)(_Server).remote
        self._calls: dict[Any, _Call[Job]] = {}  # by reference to what will come of it
        self._idle: list[Any] = []
        self._died = 0  # in a row, before they were ready

    def at_work(self) -> bool:
        return any(call.task for call in self._calls.values()) or self._attempts.more()

    def fill(self, number: int) -> None:
        """Replace workers that are gone, and give jobs to those that are free."""
        while self._idle and self._attempts.more():
            self._give(self._idle.pop())
        while len(self._calls) + len(self._idle) < number and self._attempts.more():
            actor = self._new()
            reference = actor.prepare.remote(version("extremal"), self._run)
            self._calls[reference] = _Call(actor, None, time.monotonic() + LONGEST_START)

    def wait(self) -> list[Outcome[Job]]:
        """Wait until something happens, and give what became of jobs. A worker has its next job by then."""
        first = min(call.deadline for call in self._calls.values())
        left = max(0.0, first - time.monotonic())
        done, _ = self._ray.wait(list(self._calls), num_returns=1, timeout=left)
        outcomes = [outcome for reference in done for outcome in self._ended(reference)]
        now = time.monotonic()
        for reference, call in list(self._calls.items()):
            if now > call.deadline:
                outcomes += self._late(reference)
        return outcomes

    def _give(self, actor: Any) -> None:
        task = self._attempts.next()
        self._calls[actor.do.remote(task.job)] = _Call(actor, task, time.monotonic() + self._timeout)

    def _ended(self, reference: Any) -> list[Outcome[Job]]:
        call = self._calls.pop(reference)
        try:
            found = self._ray.get(reference)
        except self._ray.exceptions.RayTaskError as error:
            if call.task is None:
                raise ClusterFailed(f"no worker can start: {_line(error.cause)}; accepted: {ALIKE}") from None
            self._idle.append(call.actor)
            return self._attempts.fail(call.task, f"{type(error.cause).__name__}: {_line(error.cause)}")
        except self._ray.exceptions.RayError as error:
            return self._lost(call, f"{type(error).__name__}: {_line(error)}")
        self._idle.append(call.actor)
        self._died = 0
        return [Outcome(call.task.job, found)] if call.task else []

    def _lost(self, call: _Call[Job], reason: str) -> list[Outcome[Job]]:
        if call.task:
            return self._attempts.fail(call.task, reason)
        self._died += 1
        if self._died >= MOST_STARTS:
            raise ClusterFailed(
                f"{self._died} workers in a row died before they were ready: {reason}; accepted: {ALIKE}"
            )
        return []

    def _late(self, reference: Any) -> list[Outcome[Job]]:
        call = self._calls[reference]
        if call.task:
            del self._calls[reference]
            self._ray.kill(call.actor)
            return self._attempts.fail(call.task, f"it took more than {self._timeout:g} s")
        if not any(call.task for call in self._calls.values()):
            raise ClusterFailed(
                f"no worker has started within {LONGEST_START:g} s; accepted: a cluster with a free CPU"
            )
        self._calls[reference] = replace(call, deadline=time.monotonic() + LONGEST_START)
        return []


def _line(error: Exception | None) -> str:
    """What an error says, without the traceback from elsewhere that Ray adds to it."""
    return next(iter(str(error).splitlines()), "")[:LONGEST_REASON]


@contextmanager
def _session(workers: int) -> Iterator[Any]:
    """Ray, connected."""
    address = os.environ.get(CLUSTER, "")
    own = address in ("", "local")
    with environment(QUIET | (_private() if own else _reaching(address))):
        try:
            import ray  # pyright: ignore[reportMissingImports]  of an extra
        except ImportError:
            raise RayMissing(
                "--engine is ray, which is not installed: pip install 'extremal[cluster]'; accepted without: local"
            ) from None
        # without an address Ray would take part in whatever cluster it finds on this machine
        where = (
            {"address": "local", "num_cpus": workers, "include_dashboard": False}
            if own
            else {"address": address}
        )
        _connect(ray, where)
        try:
            yield ray
        finally:
            ray.shutdown()


def _private() -> dict[str, str]:
    """The environment for a Ray of our own: of this machine, and of whoever has the token."""
    return LOOPBACK | {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": _token()}


@cache
def _token() -> str:
    """A token of this process, which Ray reads but once."""
    return secrets.token_hex(32)


def _reaching(address: str) -> dict[str, str]:
    """The environment for a cluster, which is known to listen: Ray itself would try for a quarter of an hour.

    Raises:
        ClusterFailed: nothing listens there.
    """
    parts = urlsplit(address if "://" in address else f"//{address}")
    if parts.netloc == "auto":  # a cluster of this machine, which Ray looks for
        return ONCE
    try:
        host, port = parts.hostname or "", parts.port or 0
        with socket.create_connection((host, port), timeout=PATIENCE) as connection:
            is_near = ip_address(connection.getpeername()[0]).is_loopback
    except (OSError, ValueError) as error:
        raise ClusterFailed(
            f"{CLUSTER} is {address!r}: {error}; accepted: host:port of a Ray cluster that runs"
        ) from None
    return ONCE | (LOOPBACK if is_near else {})


def _connect(ray: Any, where: dict[str, Any]) -> None:
    try:
        with _unheard():
            ray.init(
                **where, log_to_driver=False, logging_level="ERROR", runtime_env={"env_vars": SINGLE_THREAD}
            )
    except (ConnectionError, RuntimeError, ValueError, ray.exceptions.RayError) as error:
        ray.shutdown()
        if "AuthenticationError" in f"{error!r} {error.__cause__!r}":
            raise ClusterFailed(
                f"the Ray cluster at {where['address']} refuses this token, or the lack of one; accepted: RAY_AUTH_MODE=token "
                "with the cluster's own in RAY_AUTH_TOKEN, or its file in RAY_AUTH_TOKEN_PATH"
            ) from None
        needed = (
            "the port of its server for clients, its token, ray[client] there and here"
            if where["address"].startswith(CLIENT)
            else "a cluster with a node on this machine"
        )
        raise ClusterFailed(
            f"Ray can't be used at {where['address']}: {error}; accepted: {needed}, {ALIKE}"
        ) from None


@contextmanager
def _unheard() -> Iterator[None]:
    """Without what libraries say on the standard error output: of what goes wrong Ray raises errors as well."""
    sys.stderr.flush()
    heard = os.dup(2)
    try:
        with open(os.devnull, "w") as nowhere:
            os.dup2(nowhere.fileno(), 2)
        yield
    finally:
        os.dup2(heard, 2)
        os.close(heard)
