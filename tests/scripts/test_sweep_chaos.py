"""Sweeps whose processes are killed at random moments: nothing is lost, nothing doubled, the same digest. And the same by Ray."""

import csv
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from extremal.scripts.sweep import SweepSettings, sweep

TRIALS, WORKER_KILLS, DRIVER_KILLS = 300, 20, 5
CONFIG = f"""
kind = "estimate"
trials = {TRIALS // 4}
[settings]
fixed_points = 6
[grid]
views = [3, 25]
position_error = [1e-4, 1e-3]
[draw]
radius = {{ uniform = [0.02, 0.05] }}
"""
PATIENCE = 10.0  # [s] in which workers of a killed driver have to be gone
MAIN = "from extremal.scripts.cli import main; main()"


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "sweep.toml"
    path.write_text(CONFIG)
    return path


def started(config: Path, out: Path, *more: str) -> subprocess.Popen[bytes]:
    arguments = [str(config), "--workers", "2", "--out", str(out), *more]
    return subprocess.Popen([sys.executable, "-c", MAIN, "sweep", *arguments], stdout=subprocess.DEVNULL)


def workers_of(driver: int) -> list[int]:
    """Processes that a driver has spawned to run trials."""
    try:
        children = [int(pid) for pid in Path(f"/proc/{driver}/task/{driver}/children").read_text().split()]
        return [pid for pid in children if b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes()]
    except (FileNotFoundError, ProcessLookupError):
        return []


def reached(out: Path, moment: int, driver: subprocess.Popen[bytes]) -> bool:
    """Whether so many results are there, and workers to be killed."""
    return len(list(out.glob("trials/*.json"))) >= moment and bool(workers_of(driver.pid))


def wait_until(condition: Callable[[], bool], seconds: float) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.005)


def alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


@pytest.mark.slow
def test_kills_lose_nothing_and_double_nothing(tmp_path: Path, config: Path) -> None:
    clean, out, rng = tmp_path / "clean", tmp_path / "out", np.random.default_rng(7)
    assert started(config, clean).wait() == 0
    kinds = rng.permutation(["worker"] * WORKER_KILLS + ["driver"] * DRIVER_KILLS)
    moments = np.sort(rng.integers(0, 2 * TRIALS // 3, len(kinds)))  # by number of results on the disk
    killed = {"worker": 0, "driver": 0}
    acknowledged: dict[str, bytes] = {}
    driver = started(config, out)
    for kind, moment in zip(kinds, moments, strict=True):
        wait_until(partial(reached, out, int(moment), driver), 300)
        time.sleep(rng.uniform(0, 0.3))
        acknowledged |= {path.name: path.read_bytes() for path in out.glob("trials/*.json")}
        workers = workers_of(driver.pid)
        assert workers
        os.kill(driver.pid if kind == "driver" else int(rng.choice(workers)), signal.SIGKILL)
        killed[str(kind)] += 1
        if kind == "driver":
            driver.wait()
            wait_until(lambda workers=workers: not any(map(alive, workers)), PATIENCE)
            driver = started(config, out)
    status = driver.wait()
    if status:  # two of the kills met the same trial: it is tried again
        assert (out / "quarantined.json").exists() and started(config, out).wait() == 0
    assert killed == {"worker": WORKER_KILLS, "driver": DRIVER_KILLS}
    for name, content in acknowledged.items():
        assert (out / "trials" / name).read_bytes() == content
    assert (out / "digest.txt").read_text() == (clean / "digest.txt").read_text()
    with (out / "results.csv").open(newline="") as file:
        keys = [row["key"] for row in csv.DictReader(file)]
    assert len(keys) == len(set(keys)) == TRIALS == len(list(out.glob("trials/*.json")))


@pytest.mark.slow
def test_two_drivers_in_one_folder_do_no_harm(tmp_path: Path, config: Path) -> None:
    out = tmp_path / "out"
    drivers = [started(config, out), started(config, out)]
    assert [driver.wait() for driver in drivers] == [0, 0]
    sweep(SweepSettings(config, out=tmp_path / "alone"))
    assert (out / "digest.txt").read_text() == (tmp_path / "alone/digest.txt").read_text()


@pytest.mark.slow
@pytest.mark.skipif(find_spec("ray") is None, reason="Ray is not installed")
def test_ray_gives_the_same_bytes(tmp_path: Path, config: Path) -> None:
    config.write_text(CONFIG.replace(f"trials = {TRIALS // 4}", "trials = 5"))
    for engine in ("local", "ray"):
        assert started(config, tmp_path / engine, "--engine", engine).wait() == 0
    assert (tmp_path / "local/digest.txt").read_text() == (tmp_path / "ray/digest.txt").read_text()
