"""Which OpenGL is chosen, in processes of their own: the choice is made once a process."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from extremal.estimator.errors import RenderingError
from extremal.sim import gl

RENDER = """
import mujoco
model = mujoco.MjModel.from_xml_string("<mujoco><worldbody><light pos='0 0 3'/><geom size='.3'/></worldbody></mujoco>")
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
with mujoco.Renderer(model, 32, 32) as renderer:
    renderer.update_scene(data)
    assert renderer.render().max() > 50
print(backend.name)
"""
SELECT = "from extremal.sim.gl import select_backend\nbackend = select_backend()\n"


def run(code: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run code in a fresh Python whose environment chooses no OpenGL besides what is given."""
    own = ("MUJOCO_GL", "PYOPENGL_PLATFORM", gl.BUNDLED)
    clean = {k: v for k, v in os.environ.items() if k not in own} | environment
    return subprocess.run(
        [sys.executable, "-W", "error", "-c", code], env=clean, capture_output=True, text=True, check=False
    )


def works(library: str) -> bool:
    return gl._probe(library, "")[0]


def broken(folder: Path, *names: str) -> str:
    """A search path whose libraries can't be loaded, as if absent."""
    for name in names:
        (folder / name).touch()
    return str(folder)


@pytest.mark.parametrize("first", ["", "import mujoco\n", "import extremal.scenes\n"])
def test_renders_without_any_variable_whatever_was_imported_first(first: str) -> None:
    done = run(first + SELECT + RENDER)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() in gl.AUTOMATIC


@pytest.mark.parametrize("name", gl.AUTOMATIC)
def test_a_chosen_backend_is_used(name: str) -> None:
    done = run(SELECT + RENDER, MUJOCO_GL=name.upper(), PYOPENGL_PLATFORM="egl")
    if works(name):
        assert done.stdout.strip() == name, done.stderr
    else:
        assert gl.INSTALL[name] in done.stderr


def test_spawned_processes_render_too(tmp_path: Path) -> None:
    work = "import mujoco\nfrom extremal.sim.gl import select_backend\ndef work(_):\n"
    work += "    backend = select_backend()\n" + "".join(f"    {line}\n" for line in RENDER.splitlines())
    (tmp_path / "worker.py").write_text(work + "    return backend.name\n")
    main = "import multiprocessing, sys\nfrom worker import work\nassert work(0)\n"
    main += "assert multiprocessing.get_context('spawn').Pool(1).map(work, [0])"
    done = run(main, PYTHONPATH=str(tmp_path))
    assert done.returncode == 0, done.stderr


def test_missing_libraries_are_one_line_with_the_remedy(tmp_path: Path) -> None:
    path = broken(tmp_path, "libEGL.so.1", "libOSMesa.so.8", "libOSMesa.so.6", "libOSMesa.so")
    code = "from importlib import metadata\nmetadata.files = lambda name: None\n" + SELECT
    done = run(code, LD_LIBRARY_PATH=path)
    assert done.returncode == 1
    message = done.stderr.strip().splitlines()[-1]
    for part in ("RenderingError", "egl:", "osmesa:", gl.INSTALL["egl"], gl.WITHOUT_ROOT):
        assert part in message


def test_a_missing_gl_library_counts_as_missing_egl(tmp_path: Path) -> None:
    path = broken(tmp_path, "libOpenGL.so.0", "libGL.so.1")
    done = run(SELECT, LD_LIBRARY_PATH=path, MUJOCO_GL="egl")
    assert "libOpenGL.so.0" in done.stderr and gl.INSTALL["egl"] in done.stderr


def test_a_driver_that_crashes_is_reported(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "gl_probe.py").write_text("import os\nos.abort()\n")
    monkeypatch.setattr(gl, "__file__", str(tmp_path / "gl.py"))
    with pytest.raises(RenderingError, match=r"crashes \(signal 6\)"):
        gl._find(gl.AUTOMATIC)


def test_a_driver_that_hangs_is_reported(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "gl_probe.py").write_text("import time\ntime.sleep(60)\n")
    monkeypatch.setattr(gl, "__file__", str(tmp_path / "gl.py"))
    monkeypatch.setattr(gl, "PROBE_SECONDS", 0.3)
    with pytest.raises(RenderingError, match="hangs"):
        gl._find(("egl",))


@pytest.mark.parametrize("name", ["glx", "disable", "vulkan"])
def test_unknown_names_are_refused(name: str) -> None:
    with pytest.raises(RenderingError, match=f"{name}.*accepted: egl, osmesa, glfw"):
        gl.select_backend(name)


def test_another_backend_than_the_one_in_use_is_refused() -> None:
    name = gl.select_backend().name
    other = next(n for n in gl.ACCEPTED if n != name)
    with pytest.raises(RenderingError, match=f"renders by {name}"):
        gl.select_backend(other)
    assert gl.select_backend(name) is gl.select_backend()


def test_the_choice_is_quick() -> None:
    started = time.perf_counter()
    assert any(works(name) for name in gl.AUTOMATIC)
    assert time.perf_counter() - started < 2.0  # 0.06 s when nothing else runs
