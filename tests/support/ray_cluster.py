"""Nodes of a Ray on the loopback interface, started and ended by tests, and the processes that belong to them."""

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile
from typing import TextIO

import sweep_jobs

LONGEST = 300.0  # [s] for anything, on a busy machine
HEAD, SECOND = "127.0.0.2", "127.0.0.3"  # loopback: for 127.0.0.1 Ray would take the outer interface
RAY = ("RAY_ADDRESS", "RAY_AUTH_MODE", "RAY_AUTH_TOKEN", "RAY_AUTH_TOKEN_PATH")


@dataclass(frozen=True)
class Cluster:
    """A Ray of one node on the loopback interface: its addresses, for nodes and for clients, token, and session of processes."""

    address: str
    client_address: str
    token: str
    session: int

    @property
    def environment(self) -> dict[str, str]:
        return {"RAY_ADDRESS": self.address, "RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": self.token}

    @property
    def workers(self) -> list[int]:
        """Processes that run trials, or could."""
        return workers_of(self.session)

    @contextmanager
    def second_node(self, folder: Path, path: str = "") -> Iterator[int]:
        """With one more node, of one CPU."""
        with node(
            folder, SECOND, self.token, f"--address={self.address}", "--num-cpus=1", path=path
        ) as session:
            yield session


def workers_of(session: int) -> list[int]:
    """Processes of a node that run trials, or could."""
    return [pid for pid in in_session(session) if b"_Server" in command(pid)]


def without_ray() -> dict[str, str]:
    """This environment, but for what it says of a cluster."""
    return {k: v for k, v in os.environ.items() if k not in RAY}


def command(pid: int) -> bytes:
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    except (FileNotFoundError, ProcessLookupError):
        return b""


def in_session(session: int) -> list[int]:
    """Processes of a session that are alive."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, _, its = stat.read_text().rpartition(")")[2].split()[:4]
        except (FileNotFoundError, ProcessLookupError):
            continue
        if int(its) == session and state != "Z":
            found.append(int(stat.parent.name))
    return found


def free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


def wait_until(condition: Callable[[], bool], seconds: float = LONGEST) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def said(log: TextIO) -> str:
    """What another process has written by now."""
    return os.pread(log.fileno(), 100_000, 0).decode()


@contextmanager
def node(folder: Path, ip: str, token: str, *options: str, path: str = "") -> Iterator[int]:
    """A node of a Ray on the loopback interface, whose workers search `path` first; gives its session of processes."""
    own = {
        "RAY_AUTH_MODE": "token",
        "RAY_AUTH_TOKEN": token,
        "PYTHONPATH": os.pathsep.join(filter(None, [path, str(Path(sweep_jobs.__file__).parent)])),
    }
    more = ["--block", f"--node-ip-address={ip}", "--disable-usage-stats", "--object-store-memory=100000000"]
    start = [sys.executable, "-m", "ray.scripts.scripts", "start", *options, *more]
    with TemporaryFile("w+", dir=folder) as log:
        process = subprocess.Popen(
            start, env=without_ray() | own, stdout=log, stderr=log, start_new_session=True
        )
        try:
            wait_until(lambda: "Ray runtime started" in said(log) or process.poll() is not None)
            assert process.poll() is None, said(log)
            yield process.pid
        finally:
            process.terminate()
            process.wait(60)
            for pid in in_session(process.pid):
                os.kill(pid, signal.SIGKILL)
