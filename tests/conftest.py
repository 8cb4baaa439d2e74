"""What all tests share: a working OpenGL, one rendering thread a worker, no log file left by MuJoCo."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

# Under xdist two workers with all threads each are slower than one; Mesa reads it when its first context is made.
if "PYTEST_XDIST_WORKER" in os.environ:
    os.environ.setdefault("LP_NUM_THREADS", "1")
os.environ.setdefault("MPLBACKEND", "Agg")

MUJOCO_LOG = "MUJOCO_LOG.TXT"


@pytest.fixture(scope="session", autouse=True)
def mujoco_warnings() -> Iterator[list[str]]:
    """Collect MuJoCo's warnings (raising in its callback would abort), so that it writes no log file."""
    import mujoco

    warnings: list[str] = []
    mujoco.set_mju_user_warning(lambda message: warnings.append(str(message)))  # pyright: ignore[reportAttributeAccessIssue]
    yield warnings
    mujoco.set_mju_user_warning(None)  # pyright: ignore[reportAttributeAccessIssue]


@pytest.fixture(autouse=True)
def no_mujoco_warnings(mujoco_warnings: list[str]) -> Iterator[None]:
    """A warning of MuJoCo fails the test, like any other warning, and so does a log file."""
    mujoco_warnings.clear()
    yield
    assert not mujoco_warnings, f"MuJoCo warned: {mujoco_warnings}"
    assert not Path(MUJOCO_LOG).exists(), f"MuJoCo wrote {MUJOCO_LOG}"
