"""Sweeps on a Ray cluster that exists already: the same bytes, one line for what is wrong, and nothing left behind."""

import json
import os
import secrets
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest.mock import MagicMock

import pytest
import sweep_jobs
from ray_cluster import HEAD, LONGEST, Cluster, free_port, node, wait_until, without_ray, workers_of

from extremal.scripts.sweep import SweepSettings, sweep
from extremal.scripts.sweep_config import load_config
from extremal.scripts.sweep_ray import ClusterFailed, run_on_ray
from extremal.scripts.sweep_trials import run_trial

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
GONE = 20.0  # [s] in which workers of a killed driver have to be gone


@pytest.fixture(scope="module")
def cluster() -> Iterator[Cluster]:
    port, client_port, token = free_port(), free_port(), secrets.token_hex(32)
    with TemporaryDirectory(prefix="r") as folder:  # names of sockets have to be short
        options = ["--head", f"--port={port}", "--num-cpus=2", f"--temp-dir={folder}/ray"]
        more = ["--include-dashboard=false"]
        if find_spec("grpc"):  # else Ray takes no such option
            more.append(f"--ray-client-server-port={client_port}")
        with node(Path(folder), HEAD, token, *options, *more) as session:
            yield Cluster(f"{HEAD}:{port}", f"ray://{HEAD}:{client_port}", token, session)


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "sweep.toml"
    path.write_text(CONFIG)
    return path


@contextmanager
def started(
    arguments: list[str], environment: dict[str, str], cwd: Path | None = None
) -> Iterator[subprocess.Popen[str]]:
    """A process in a folder, which Ray lets workers of this machine search as well; it ends with the context."""
    with subprocess.Popen(
        [sys.executable, "-c", *arguments],
        cwd=cwd,
        env=without_ray() | environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def swept(config: Path, out: Path, *more: str, main: str = MAIN, **environment: str) -> tuple[int, str]:
    """Exit status and standard error output of a sweep by Ray."""
    arguments = [main, "sweep", str(config), "--engine", "ray", "--out", str(out), *more]
    with started(arguments, environment, config.parent) as driver:
        error = driver.communicate(timeout=LONGEST)[1]
    return driver.returncode, error


def digest(out: Path) -> str:
    return (out / "digest.txt").read_text()


def in_one_line(error: str) -> bool:
    return error.startswith("extremal: error: ") and error.count("\n") == 1 and "accepted: " in error


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


def test_a_cluster_that_is_lost_by_its_client_is_told_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    """As Ray's client has it: an error of its connection, whose message may go on for lines."""
    ray = MagicMock()
    ray.wait.side_effect = ConnectionError("no connection\nand more")
    monkeypatch.setattr("extremal.scripts.sweep_ray._session", lambda workers: nullcontext(ray))
    with pytest.raises(ClusterFailed, match=r"gone: no connection; accepted: .*start again"):
        next(run_on_ray(sweep_jobs.do, ["square 3"], 1, 60.0))


@pytest.mark.slow
@needs_ray
def test_a_cluster_gives_the_same_bytes_whatever_is_killed(
    tmp_path: Path, config: Path, cluster: Cluster
) -> None:
    sweep(SweepSettings(config, out=tmp_path / "local"))
    out = tmp_path / "ray"
    arguments = [MAIN, "sweep", str(config), "--engine", "ray", "--out", str(out)]
    with started(arguments, cluster.environment) as driver:
        wait_until(lambda: len(list(out.glob("trials/*.json"))) >= 3)
        before = {path: path.read_bytes() for path in out.glob("trials/*.json")}
        os.kill(cluster.workers[0], signal.SIGKILL)
        driver.kill()
    wait_until(lambda: not cluster.workers, GONE)
    assert swept(config, out, **cluster.environment) == (0, "")
    assert digest(out) == digest(tmp_path / "local")
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
    assert status == 2 and in_one_line(error)
    assert "refuses this token" in error and "RAY_AUTH_TOKEN_PATH" in error
    assert time.monotonic() - begin < 90 and not cluster.workers


@pytest.mark.slow
@needs_ray
def test_jobs_that_kill_their_worker_or_take_too_long_are_given_up(tmp_path: Path, cluster: Cluster) -> None:
    """As by local processes; the time in which a worker starts is not the job's."""
    once, slow = f"kill-once {tmp_path / 'mark'}", f"sleep {tmp_path / 'pid'}"
    jobs = ["square 3", "kill", "raise", once, slow, "square 4", "environment"]
    support = str(Path(sweep_jobs.__file__).parent)
    with started([JOBS, *jobs], cluster.environment | {"PYTHONPATH": support}) as driver:
        out = driver.communicate(timeout=LONGEST)[0]
    found = json.loads(out.splitlines()[-1])  # Ray tells of killed workers on its own account
    assert (found["square 3"], found["square 4"], found[once], found["environment"]) == (
        "9", "16", "second time", "1",
    )  # fmt: skip
    assert found["kill"].startswith("it failed 2 times, the last time: ActorDiedError: ")
    assert found["raise"] == "it failed 2 times, the last time: ZeroDivisionError: of no use"
    assert found[slow] == "it failed 2 times, the last time: it took more than 5 s"
    wait_until(lambda: not cluster.workers, GONE)


@pytest.mark.slow
@needs_ray
def test_two_nodes_give_the_same_bytes(tmp_path: Path, config: Path, cluster: Cluster) -> None:
    """Three workers: the first node has room for two. Enough trials for the other one to be started before they are done."""
    config.write_text(CONFIG.replace("trials = 12", "trials = 400"))
    sweep(SweepSettings(config, out=tmp_path / "local"))
    out = tmp_path / "ray"
    arguments = [MAIN, "sweep", str(config), "--engine", "ray", "--workers", "3", "--out", str(out)]
    with (
        cluster.second_node(tmp_path) as second,
        started(arguments, cluster.environment) as driver,
    ):
        wait_until(lambda: bool(cluster.workers and workers_of(second)) or driver.poll() is not None)
        assert driver.poll() is None
        assert driver.communicate(timeout=LONGEST)[1] == "" and driver.returncode == 0
    assert digest(out) == digest(tmp_path / "local")


@pytest.mark.slow
@needs_ray
def test_a_client_of_the_cluster_gives_the_same_bytes_or_is_told_what_is_missing(
    tmp_path: Path, config: Path, cluster: Cluster
) -> None:
    """By ray://, for which Ray needs gRPC."""
    out, environment = tmp_path / "ray", cluster.environment | {"RAY_ADDRESS": cluster.client_address}
    if not find_spec("grpc"):
        environment["RAY_ADDRESS"] = (
            f"ray://{cluster.address}"  # no server for clients runs, but something listens
        )
        status, error = swept(config, out, **environment)
        assert status == 2 and in_one_line(error) and "ray[client]" in error
        return
    sweep(SweepSettings(config, out=tmp_path / "local"))
    assert swept(config, out, **environment) == (0, "")
    assert digest(out) == digest(tmp_path / "local")
    status, error = swept(config, tmp_path / "no", RAY_ADDRESS=cluster.client_address)
    assert status == 2 and in_one_line(error) and "token" in error
    wait_until(lambda: not cluster.workers, GONE)


@pytest.mark.slow
@needs_ray
def test_a_node_with_another_version_is_refused(tmp_path: Path, config: Path, cluster: Cluster) -> None:
    """In one line; no table is made, and what the other node has computed by then is whole and right."""
    config.write_text(
        CONFIG.replace("trials = 12", "trials = 1500")
    )  # enough until the third worker is ready
    out, elsewhere = tmp_path / "out", tmp_path / "elsewhere"
    about = elsewhere / "extremal-98.7.dist-info/METADATA"
    about.parent.mkdir(parents=True)
    about.write_text("Metadata-Version: 2.1\nName: extremal\nVersion: 98.7\n")
    with cluster.second_node(tmp_path, str(elsewhere)) as second:
        status, error = swept(config, out, "--workers", "3", **cluster.environment)
        assert status == 2 and in_one_line(error)
        assert f"extremal 98.7 instead of {version('extremal')}" in error
        wait_until(lambda: not cluster.workers and not workers_of(second), GONE)
    assert {path.name for path in out.iterdir()} == {"sweep.json", "trials"}
    kept = {path.name: json.loads(path.read_bytes()) for path in (out / "trials").iterdir()}
    trials = [trial for trial in load_config(config).all_trials() if f"{trial.key}.json" in kept]
    assert len(trials) == len(kept)
    for trial in trials[:10]:
        expected, found = json.loads(run_trial(trial)), kept[f"{trial.key}.json"]
        assert {**found, "seconds": 0} == {**expected, "seconds": 0}


@pytest.mark.slow
@needs_ray
def test_another_version_of_ray_is_refused(tmp_path: Path, config: Path, cluster: Cluster) -> None:
    main = f"import ray; ray.__version__ = '1.2.3'; {MAIN}"
    status, error = swept(config, tmp_path / "out", main=main, **cluster.environment)
    assert status == 2 and in_one_line(error) and "1.2.3" in error and not cluster.workers
