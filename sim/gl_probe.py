"""Creates one real offscreen OpenGL context and prints its renderer; run as a child process by `extremal.sim.gl`.

A broken driver can abort the process that tries it, so this never runs in the user's. Standard library only, so that
it starts in milliseconds with `python -I -S`.
"""

import ctypes
import sys
from ctypes import CDLL, CFUNCTYPE, byref, c_char_p, c_int, c_uint, c_void_p
from pathlib import Path
from typing import Any

GL_RENDERER = 0x1F01
# The attributes MuJoCo asks for: pbuffer, OpenGL, 8 bits a colour, 24 of depth, 8 of stencil.
EGL_CONFIG = (0x3033, 1, 0x3040, 8, 0x3024, 8, 0x3023, 8, 0x3022, 8, 0x3021, 8, 0x3025, 24, 0x3026, 8, 0x3038)
EGL_OPENGL_API, EGL_PLATFORM_DEVICE = 0x30A2, 0x313F
OSMESA_RGBA, GL_FLOAT = 0x1908, 0x1406


def main(backend: str, library: str) -> None:
    """Print the renderer's name, or end with a one-line reason."""
    try:
        print({"egl": egl, "osmesa": osmesa, "glfw": glfw}[backend](library))
    except (OSError, RuntimeError, AttributeError, ImportError) as error:
        sys.exit(f"{error}")


def egl(library: str) -> str:
    """Renderer of a surfaceless context on the first EGL device that works (MuJoCo picks the same way)."""
    _load("libOpenGL.so.0", "libGL.so.1")  # PyOpenGL needs one of them besides EGL
    lib = _load(library or "libEGL.so.1")
    lib.eglGetProcAddress.restype, lib.eglGetProcAddress.argtypes = c_void_p, [c_char_p]
    devices, found = (c_void_p * 32)(), c_int()
    _function(lib.eglGetProcAddress, "eglQueryDevicesEXT", c_uint, c_int, c_void_p, c_void_p)(
        32, devices, byref(found)
    )
    open_display = _function(
        lib.eglGetProcAddress, "eglGetPlatformDisplayEXT", c_void_p, c_int, c_void_p, c_void_p
    )
    lib.eglInitialize.argtypes = [c_void_p] * 3
    for device in devices[: found.value]:
        display = open_display(EGL_PLATFORM_DEVICE, device, None)
        if display and lib.eglInitialize(display, None, None):
            return _egl_renderer(lib, display)
    raise RuntimeError(f"none of {found.value} EGL devices can be initialised")


def _egl_renderer(lib: CDLL, display: int) -> str:
    config, count = c_void_p(), c_int()
    lib.eglChooseConfig.argtypes = [c_void_p, c_void_p, c_void_p, c_int, c_void_p]
    lib.eglChooseConfig(display, (c_int * len(EGL_CONFIG))(*EGL_CONFIG), byref(config), 1, byref(count))
    if not count.value:
        raise RuntimeError("EGL has no framebuffer with 24 bits of depth")
    lib.eglBindAPI(EGL_OPENGL_API)
    lib.eglCreateContext.restype, lib.eglCreateContext.argtypes = c_void_p, [c_void_p] * 4
    context = lib.eglCreateContext(display, config, None, None)
    lib.eglMakeCurrent.argtypes = [c_void_p] * 4
    if not context or not lib.eglMakeCurrent(display, None, None, context):
        raise RuntimeError("EGL can't create an OpenGL context")
    return _renderer(lib.eglGetProcAddress)


def osmesa(library: str) -> str:
    """Renderer of a small OSMesa context."""
    lib = load_bundled(library) if library else _load("libOSMesa.so.8", "libOSMesa.so.6", "libOSMesa.so")
    lib.OSMesaCreateContextExt.restype = c_void_p
    lib.OSMesaCreateContextExt.argtypes = [c_int, c_int, c_int, c_int, c_void_p]
    lib.OSMesaMakeCurrent.argtypes = [c_void_p, c_void_p, c_int, c_int, c_int]
    lib.OSMesaGetProcAddress.restype, lib.OSMesaGetProcAddress.argtypes = c_void_p, [c_char_p]
    context = lib.OSMesaCreateContextExt(OSMESA_RGBA, 24, 8, 0, None)
    pixels = (ctypes.c_float * (16 * 16 * 4))()
    if not context or not lib.OSMesaMakeCurrent(context, pixels, GL_FLOAT, 16, 16):
        raise RuntimeError("OSMesa can't create an OpenGL context")
    return _renderer(lib.OSMesaGetProcAddress)


def glfw(_: str) -> str:
    """Renderer of an invisible window; needs a display."""
    import glfw as library

    if not library.init():
        raise RuntimeError("GLFW found no display")
    library.window_hint(library.VISIBLE, 0)
    window = library.create_window(16, 16, "", None, None)
    if not window:
        raise RuntimeError("GLFW can't create a window")
    library.make_context_current(window)
    return _renderer(library.get_proc_address)


def load_bundled(library: str) -> CDLL:
    """Load a wheel's library after those beside it that it needs (the wheel gives no search path to the loader)."""
    waiting = [path for path in Path(library).parent.glob("*.so*") if path != Path(library)]
    while waiting:
        failed = [path for path in waiting if not _loads(path)]
        if len(failed) == len(waiting):
            break
        waiting = failed
    return CDLL(library, ctypes.RTLD_GLOBAL)


def _loads(path: Path) -> bool:
    try:
        return bool(CDLL(str(path), ctypes.RTLD_GLOBAL))
    except OSError:
        return False


def _load(*names: str) -> CDLL:
    reasons = []
    for name in names:
        try:
            return CDLL(name, ctypes.RTLD_GLOBAL)
        except OSError as error:
            reasons.append(str(error))
    raise OSError(reasons[0])


def _function(lookup: Any, name: str, result: Any, *arguments: Any) -> Any:
    address = lookup(name.encode())
    if not address:
        raise RuntimeError(f"{name} is missing")
    return CFUNCTYPE(result, *arguments)(address)


def _renderer(lookup: Any) -> str:
    address = lookup("glGetString") if lookup.__module__.startswith("glfw") else lookup(b"glGetString")
    name = CFUNCTYPE(c_char_p, c_uint)(address)(GL_RENDERER) if address else None
    if not name:
        raise RuntimeError("the OpenGL context is dead")
    return name.decode()


if __name__ == "__main__":
    main(*sys.argv[1:])
