"""The command line as a user meets it: one clear line and exit status 2, or help."""

import os
import subprocess
import sys
import time
from dataclasses import dataclass
from importlib import metadata

import pytest

from extremal.estimator.errors import SceneError
from extremal.scripts import cli


def run(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    code = "from extremal.scripts.cli import main; main()"
    return subprocess.run(
        [sys.executable, "-W", "error", "-c", code, *arguments],
        env=os.environ | environment,
        capture_output=True,
        text=True,
        check=False,
    )


def assert_refused(done: subprocess.CompletedProcess[str], *parts: str) -> None:
    lines = done.stderr.splitlines()
    assert done.returncode == 2
    assert len(lines) == 1 and lines[0].startswith("extremal: error: "), done.stderr
    for part in parts:
        assert part in lines[0]


def test_version() -> None:
    done = run("--version")
    assert done.returncode == 0 and done.stdout == f"extremal {metadata.version('extremal')}\n"


def test_version_and_help_import_nothing_heavy() -> None:
    code = "import sys; from extremal.scripts import cli; cli.run(['--version']); cli.run(['--help'])\n"
    code += (
        "sys.exit(any(m in sys.modules for m in ('mujoco', 'scipy', 'numpy', 'cv2', 'matplotlib', 'tyro')))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False, capture_output=True).returncode == 0


def test_help_lists_the_commands() -> None:
    done = run("--help")
    assert done.returncode == 0 and all(name in done.stdout for name in cli.COMMANDS)
    assert run().returncode == 2


def test_the_options_of_look() -> None:
    done = run("look", "--help", COLUMNS="100")
    assert done.returncode == 0, done.stderr
    promised = [
        "scene",
        "views",
        "baseline",
        "distance",
        "quality",
        "noise",
        "position-error",
        "rotation-error",
        "arm",
        "camera",
        "calibration",
        "egomotion",
        "seed",
        "out",
    ]
    assert all(f"--{option} " in done.stdout for option in promised)
    assert "--physics" in done.stdout and "[m]" in done.stdout and "[rad]" in done.stdout


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (("lok",), ("'lok'", "look", "doctor")),
        (("--lok",), ("'--lok'", "accepted")),
        (("look", "--veiws", "3"), ("--veiws", "look --help")),
        (("look", "--views", "many"), ("--views", "many")),
        (("look", "--baseline"), ("--baseline",)),
        (("doctor", "now"), ("now", "doctor --help")),
        (("look", "--scene", "no-such-scene"), ("no-such-scene", "vase-and-box")),
    ],
)
def test_bad_input_is_one_line(
    arguments: tuple[str, ...],
    parts: tuple[str, ...],
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    """In this process: to import everything takes one of its own far longer than all the rest."""
    monkeypatch.setattr(sys, "argv", ["extremal", *arguments])
    with pytest.raises(SystemExit) as end:
        cli.main()
    assert isinstance(end.value.code, int)
    captured = capfd.readouterr()
    assert_refused(subprocess.CompletedProcess(arguments, end.value.code, captured.out, captured.err), *parts)


def test_a_process_of_its_own_refuses_alike() -> None:
    assert_refused(run("look", "--views", "many"), "--views", "many")


def test_a_backend_that_is_unknown_is_one_line() -> None:
    done = run("doctor", MUJOCO_GL="vulkan")
    assert_refused(done, "MUJOCO_GL", "vulkan", "egl, osmesa, glfw")


def test_a_long_complaint_is_cut_to_its_message() -> None:
    box = "╭─ Value error ─╮\n│ Error parsing   │\n│ --views: no.    │\n│                 │\n│ Got errors:  │\n│ - int │\n╰──╯\n"
    assert cli._one_line(box) == "Error parsing --views: no."
    assert cli._one_line("plain text\nof another release") == "plain text of another release"


@dataclass(frozen=True)
class Settings:
    """Nothing to set."""


def call(monkeypatch: pytest.MonkeyPatch, error: BaseException) -> int:
    def doctor(settings: Settings) -> None:
        raise error

    monkeypatch.setattr("extremal.scripts.doctor.doctor", doctor)
    monkeypatch.setattr(sys, "argv", ["extremal", "doctor"])
    with pytest.raises(SystemExit) as end:
        cli.main()
    assert isinstance(end.value.code, int)
    return end.value.code


def test_own_errors_are_one_line(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(monkeypatch, SceneError("scene is 'x'\n  accepted: y")) == 2
    assert capsys.readouterr().err == "extremal: error: scene is 'x' accepted: y\n"


def test_an_interrupt_ends_quietly(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(monkeypatch, KeyboardInterrupt()) == 130
    assert capsys.readouterr().err == ""


def test_other_errors_keep_their_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ZeroDivisionError):
        call(monkeypatch, ZeroDivisionError())


def test_start_up_is_quick() -> None:
    started = time.perf_counter()
    run("--version")
    assert time.perf_counter() - started < 2  # 0.15 s when nothing else runs
