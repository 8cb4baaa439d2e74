"""Which OpenGL renders offscreen: found by trying, once a process, and told to MuJoCo.

MuJoCo decides when it is imported, by MUJOCO_GL; without a display its default fails. Here EGL and OSMesa are tried in a
child process, and the choice also reaches a MuJoCo that was imported before.
"""

import importlib
import os
import subprocess
import sys
import threading
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

from extremal.estimator.errors import RenderingError

AUTOMATIC = ("egl", "osmesa")
ACCEPTED = (*AUTOMATIC, "glfw")
INSTALL = {
    "egl": "apt-get install -y --no-install-recommends libegl1 libgl1",
    "osmesa": "apt-get install -y --no-install-recommends libosmesa6",
}
WITHOUT_ROOT = 'pip install "extremal[gl]"'
PROBE_SECONDS = 30
WHEEL = "lavavu-osmesa"  # of the extra `gl`
BUNDLED = "EXTREMAL_OSMESA"  # environment variable: the wheel's library, in child processes too
_CONTEXT_MODULES = ("mujoco", "mujoco.gl_context", "mujoco.rendering.classic.gl_context")
_lock = threading.Lock()
_selected: list["Backend"] = []
_forked: list[bool] = []  # not empty in a child of a process that has chosen


@dataclass(frozen=True)
class Backend:
    """An OpenGL that works offscreen: MuJoCo's name for it, its renderer, and (name, reason) of those that failed."""

    name: str
    renderer: str
    failed: tuple[tuple[str, str], ...] = ()


def _note_fork() -> None:
    if _selected:
        _forked.append(True)


os.register_at_fork(after_in_child=_note_fork)


def select_backend(preferred: str | None = None) -> Backend:
    """Find a working OpenGL and make MuJoCo use it; call before the first renderer is made.

    Order: `preferred`, else the environment's MUJOCO_GL, else egl, then osmesa (of the system, then of the wheel in
    `extremal[gl]`). Costs 0.1 s (and MuJoCo's import) the first time, nothing afterwards. Child processes inherit the
    choice through the environment.

    Raises RenderingError (one line: what was tried, what to install) if nothing works, if a name is not one of
    egl, osmesa, glfw, or if another backend is in use already; and in a process that was forked from one that renders.
    """
    if _forked:  # it would wait for ever
        raise RenderingError(
            'this process was forked from one that renders; accepted: spawned ones, e.g. AsyncVectorEnv(..., context="spawn")'
        )
    with _lock:
        wanted = _wanted(preferred)
        if not _selected:
            _selected.append(_find((wanted,) if wanted else AUTOMATIC))
        backend = _selected[0]
    if preferred and wanted != backend.name:
        raise RenderingError(
            f"OpenGL backend {wanted!r} can't be used: this process renders by {backend.name}"
        )
    return backend


def _wanted(preferred: str | None) -> str | None:
    fallback = "osmesa" if BUNDLED in os.environ else ""
    source, value = (
        ("backend", preferred) if preferred else ("MUJOCO_GL", os.environ.get("MUJOCO_GL") or fallback)
    )
    name = value.strip().lower()
    if name and name not in ACCEPTED:
        raise RenderingError(
            f"{source} is {value!r}; accepted: {', '.join(ACCEPTED)}, or unset to try egl and osmesa"
        )
    return name or None


def _find(names: tuple[str, ...]) -> Backend:
    failed: list[tuple[str, str]] = []
    for name in names:
        for library in ("", _wheel_library()) if name == "osmesa" else ("",):
            if library is None:
                continue
            works, text = _probe(name, library)
            if works:
                _bind(name, library)
                return Backend(name, text, tuple(failed))
            failed.append((name, text))
    tried = "; ".join(f"{name}: {reason}" for name, reason in failed)
    raise RenderingError(f"offscreen rendering does not work (tried {tried}); {_remedy(names)}")


def _remedy(names: tuple[str, ...]) -> str:
    if names == ("glfw",):
        return "unset MUJOCO_GL to try egl and osmesa"
    return f"to install it: `{INSTALL[names[0]]}` as root, or without root `{WITHOUT_ROOT}`"


def _probe(name: str, library: str) -> tuple[bool, str]:
    """Whether a context can be made in a child process, and its renderer or the reason why not."""
    isolated = ("-I",) if name == "glfw" else ("-I", "-S")
    command = [sys.executable, *isolated, str(Path(__file__).with_name("gl_probe.py")), name, library]
    try:
        done = subprocess.run(
            command,
            capture_output=True,
            text=True,
            check=False,
            timeout=PROBE_SECONDS,
            stdin=subprocess.DEVNULL,
        )
    except subprocess.TimeoutExpired:
        return False, f"hangs for {PROBE_SECONDS} s"
    if done.returncode < 0:
        return False, f"the driver crashes (signal {-done.returncode})"
    lines = (done.stdout if done.returncode == 0 else done.stderr).strip().splitlines()
    return done.returncode == 0, lines[-1] if lines else "no reason given"


def _bind(name: str, library: str) -> None:
    """Make MuJoCo, imported or not, and PyOpenGL use the backend."""
    loaded = getattr(sys.modules.get("OpenGL.platform"), "PLATFORM", None)
    if name in AUTOMATIC and loaded is not None and name not in type(loaded).__name__.lower():
        raise RenderingError(
            f"PyOpenGL was loaded for another platform ({type(loaded).__name__}) before {name} was chosen; "
            f"accepted: PYOPENGL_PLATFORM={name} from the start"
        )
    os.environ["MUJOCO_GL"] = os.environ["PYOPENGL_PLATFORM"] = name
    if name == "glfw":
        del os.environ["PYOPENGL_PLATFORM"]
    if library:
        _use_wheel(library)
    context = importlib.import_module(f"mujoco.{name}").GLContext
    for module in _CONTEXT_MODULES:
        if module in sys.modules:
            vars(sys.modules[module])["GLContext"] = context


def _wheel_library() -> str | None:
    try:
        files = metadata.files(WHEEL) or []
    except metadata.PackageNotFoundError:
        return None
    return next((str(file.locate()) for file in files if file.name.startswith("libOSMesa")), None)


def _use_wheel(library: str) -> None:
    """Point PyOpenGL at the wheel's libOSMesa, which lies under a name of its own outside the loader's path.

    MUJOCO_GL is removed, because a child process that imports MuJoCo before this ran would fail by it; BUNDLED says to
    the child what was chosen.
    """
    from OpenGL.plugins import PlatformPlugin

    os.environ[BUNDLED] = library
    del os.environ["MUJOCO_GL"]
    plugin = PlatformPlugin.by_name("osmesa")
    assert plugin is not None
    plugin.import_path = "extremal.sim.gl_wheel.WheelOSMesaPlatform"
