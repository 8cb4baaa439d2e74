"""Worker processes that die, hang and fail; nothing of it reaches other jobs."""

import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
import sweep_jobs

from extremal.scripts.sweep_attempts import Attempts, WorkersFailed
from extremal.scripts.sweep_engine import run_locally

Results = dict[str, bytes | str]


def run(
    jobs: list[str],
    workers: int = 2,
    timeout: float = 120.0,
    prepare: Callable[[], object] = sweep_jobs.nothing,
) -> Results:
    """Results by job; reasons where there are none."""
    outcomes = list(run_locally(sweep_jobs.do, prepare, jobs, workers, timeout))
    assert len(outcomes) == len({outcome.job for outcome in outcomes}) == len(jobs)
    return {outcome.job: outcome.reason if outcome.result is None else outcome.result for outcome in outcomes}


def test_what_kills_its_worker_twice_is_given_up_and_the_rest_is_done(tmp_path: Path) -> None:
    squares = [f"square {i}" for i in range(20)]
    once = f"kill-once {tmp_path / 'mark'}"
    found = run([*squares[:5], "kill", once, "raise", *squares[5:], "exit", "environment"])
    assert [found[job] for job in squares] == [str(i * i).encode() for i in range(20)]
    assert found["kill"] == "it failed 2 times, the last time: killed by SIGKILL"
    assert found["exit"] == "it failed 2 times, the last time: its process ended with status 7"
    assert found["raise"] == "it failed 2 times, the last time: ZeroDivisionError: of no use"
    assert found[once] == b"second time"
    assert found["environment"] == b"1"


@pytest.mark.slow
def test_what_takes_too_long_is_ended(tmp_path: Path) -> None:
    slow, started = f"sleep {tmp_path / 'pid'}", time.monotonic()
    found = run([slow, "square 2"], workers=1, timeout=1.0)
    assert found == {slow: "it failed 2 times, the last time: it took more than 1 s", "square 2": b"4"}
    assert time.monotonic() - started < 50
    assert not alive(int((tmp_path / "pid").read_text()))


def test_workers_that_never_start_are_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("extremal.scripts.sweep_engine.MOST_STARTS", 2)
    with pytest.raises(WorkersFailed, match="before they were ready: its process ended with status 3"):
        run(["square 1"], prepare=sweep_jobs.die)


def test_workers_end_with_the_process_that_made_them(tmp_path: Path) -> None:
    code = (
        "import sys; sys.path.insert(0, sys.argv[1])\n"
        "import sweep_jobs; from extremal.scripts.sweep_engine import run_locally\n"
        "list(run_locally(sweep_jobs.do, sweep_jobs.nothing, ['sleep ' + sys.argv[2]], 1, 60.0))"
    )
    pid = tmp_path / "pid"
    with subprocess.Popen(
        [sys.executable, "-c", code, str(Path(sweep_jobs.__file__).parent), str(pid)]
    ) as driver:
        wait_for(lambda: pid.exists() and pid.read_text() != "")
        worker = int(pid.read_text())
        assert alive(worker)
        driver.kill()
    wait_for(lambda: not alive(worker), seconds=10)


def test_jobs_are_asked_for_when_they_are_needed_and_failed_ones_come_first() -> None:
    asked: list[int] = []
    attempts = Attempts(asked.append(i) or str(i) for i in range(3))
    assert attempts.more() and asked == [0]
    first = attempts.next()
    assert attempts.fail(first, "no") == [] and attempts.next() is first and asked == [0]
    assert attempts.fail(first, "no")[0].result is None
    assert attempts.more() and attempts.next().job == "1" and attempts.more() and attempts.next().job == "2"
    assert not attempts.more()


def alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def wait_for(condition: Callable[[], bool], seconds: float = 60) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        os.sched_yield()
        time.sleep(0.02)
