"""Sweeps on a Ray cluster that exists already: the same bytes, one line for what is wrong, and nothing left behind."""

import json
import os
import secrets
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import pytest
import sweep_jobs

from extremal.scripts.sweep import SweepSettings, sweep
from extremal.scripts.sweep_ray import ClusterFailed, run_on_ray

needs_ray = pytest.mark.skipif(find_spec("ray") is None, reason="Ray is not installed")
CONFIG = """
kind = "estimate"
trials = 12
[settings]
views = 25
[grid]
position_error = [1e-4, 1e-3]
"""
MAIN = "from extremal.scripts.cli import main; main()"
JOBS = """
import json, sys
import sweep_jobs
from extremal.scripts.sweep_ray import run_on_ray
found = run_on_ray(sweep_jobs.do, sys.argv[1:], 2, 5.0)
print(json.dumps({one.job: one.reason if one.result is None else one.result.decode() for one in found}))
"""
LONGEST = 300.0  # [s] for anything, on a busy machine
GONE = 20.0  # [s] in which workers of a killed driver have to be gone
RAY = ("RAY_ADDRESS", "RAY_AUTH_MODE", "RAY_AUTH_TOKEN", "RAY_AUTH_TOKEN_PATH")


@dataclass(frozen=True)
class Cluster:
    """A Ray of one node on the loopback interface: its address, token, and session of processes."""

    address: str
    token: str
    session: int

    @property
    def environment(self) -> dict[str, str]:
        return {"RAY_ADDRESS": self.address, "RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": self.token}

    @property
    def workers(self) -> list[int]:
        """Processes that run trials, or could."""
        return [pid for pid in in_session(self.session) if b"_Server" in command(pid)]


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


@pytest.fixture(scope="module")
def cluster() -> Iterator[Cluster]:
    port, token = free_port(), secrets.token_hex(32)
    own = {
        "RAY_AUTH_MODE": "token",
        "RAY_AUTH_TOKEN": token,
        "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0",
        "PYTHONPATH": str(Path(sweep_jobs.__file__).parent),
    }
    options = ["--head", "--block", "--node-ip-address=127.0.0.1", f"--port={port}", "--num-cpus=2"]
    more = ["--include-dashboard=false", "--disable-usage-stats", "--object-store-memory=100000000"]
    with tempfile.TemporaryDirectory(prefix="r") as folder:  # names of sockets have to be short
        log, start = Path(folder) / "log", [sys.executable, "-m", "ray.scripts.scripts", "start"]
        with log.open("w") as out:
            head = subprocess.Popen(
                [*start, *options, *more, f"--temp-dir={folder}/ray"],
                env={k: v for k, v in os.environ.items() if k not in RAY} | own,
                stdout=out,
                stderr=out,
                start_new_session=True,
            )
        try:
            wait_until(lambda: "Ray runtime started" in log.read_text())
            yield Cluster(f"127.0.0.1:{port}", token, head.pid)
        finally:
            head.terminate()
            head.wait(60)
            for pid in in_session(head.pid):
                os.kill(pid, signal.SIGKILL)


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "sweep.toml"
    path.write_text(CONFIG)
    return path


def started(arguments: list[str], **environment: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", *arguments],
        env={k: v for k, v in os.environ.items() if k not in RAY} | environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def swept(config: Path, out: Path, **environment: str) -> tuple[int, str]:
    """Exit status and standard error output of a sweep by Ray."""
    with started([MAIN, "sweep", str(config), "--engine", "ray", "--out", str(out)], **environment) as driver:
        error = driver.communicate(timeout=LONGEST)[1]
    return driver.returncode, error


@pytest.mark.parametrize(
    ("address", "part"),
    [("127.0.0.1:1", "refused"), ("127.0.0.1", "refused"), ("a:b:c", "Port"), ("ray://", "")],
)
def test_an_address_where_nothing_listens_is_told_at_once(
    monkeypatch: pytest.MonkeyPatch, address: str, part: str
) -> None:
    monkeypatch.setenv("RAY_ADDRESS", address)
    with pytest.raises(ClusterFailed, match=rf"RAY_ADDRESS is '{address}': .*{part}.*accepted: host:port"):
        next(run_on_ray(sweep_jobs.do, ["square 3"], 1, 60.0))


@pytest.mark.slow
@needs_ray
def test_a_cluster_gives_the_same_bytes_whatever_is_killed(
    tmp_path: Path, config: Path, cluster: Cluster
) -> None:
    sweep(SweepSettings(config, out=tmp_path / "local"))
    out = tmp_path / "ray"
    arguments = [MAIN, "sweep", str(config), "--engine", "ray", "--out", str(out)]
    with started(arguments, **cluster.environment) as driver:
        wait_until(lambda: len(list(out.glob("trials/*.json"))) >= 3)
        before = {path: path.read_bytes() for path in out.glob("trials/*.json")}
        os.kill(cluster.workers[0], signal.SIGKILL)
        driver.kill()
    wait_until(lambda: not cluster.workers, GONE)
    assert swept(config, out, **cluster.environment) == (0, "")
    assert (out / "digest.txt").read_text() == (tmp_path / "local/digest.txt").read_text()
    assert all(path.read_bytes() == content for path, content in before.items())
    wait_until(lambda: not cluster.workers, GONE)


@pytest.mark.slow
@needs_ray
@pytest.mark.parametrize(
    "token", [{}, {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": "0" * 64}], ids=["none", "wrong"]
)
def test_without_the_token_one_line_says_so(
    tmp_path: Path, config: Path, cluster: Cluster, token: dict[str, str]
) -> None:
    begin = time.monotonic()
    status, error = swept(config, tmp_path / "out", RAY_ADDRESS=cluster.address, **token)
    assert status == 2 and error.count("\n") == 1
    assert "refuses this token" in error and "RAY_AUTH_TOKEN_PATH" in error
    assert time.monotonic() - begin < 90 and not cluster.workers


@pytest.mark.slow
@needs_ray
def test_jobs_that_kill_their_worker_or_take_too_long_are_given_up(tmp_path: Path, cluster: Cluster) -> None:
    """As by local processes; the time in which a worker starts is not the job's."""
    once, slow = f"kill-once {tmp_path / 'mark'}", f"sleep {tmp_path / 'pid'}"
    jobs = ["square 3", "kill", "raise", once, slow, "square 4", "environment"]
    support = str(Path(sweep_jobs.__file__).parent)
    with started([JOBS, *jobs], PYTHONPATH=support, **cluster.environment) as driver:
        out = driver.communicate(timeout=LONGEST)[0]
    found = json.loads(out.splitlines()[-1])  # Ray tells of killed workers on its own account
    assert (found["square 3"], found["square 4"], found[once], found["environment"]) == (
        "9", "16", "second time", "1",
    )  # fmt: skip
    assert found["kill"].startswith("it failed 2 times, the last time: ActorDiedError: ")
    assert found["raise"] == "it failed 2 times, the last time: ZeroDivisionError: of no use"
    assert found[slow] == "it failed 2 times, the last time: it took more than 5 s"
    wait_until(lambda: not cluster.workers, GONE)
