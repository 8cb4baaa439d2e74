"""What a renderer draws into: offscreen buffers without the stencil that mirrors need, and one OpenGL context a thread.

MuJoCo gives every sample a depth of 4 bytes and a stencil of 4 more, and keeps a depth of what the samples are resolved to. No
frame here has mirrors, none of its depth is read: without them 36 bytes a pixel are left of 60, and the same pixels are drawn.
"""

# mujoco's compiled classes come without type stubs.
# pyright: reportAttributeAccessIssue=false

import atexit
import threading

import mujoco

from extremal.estimator.errors import RenderingError

SAMPLES = 4  # of MSAA; llvmpipe offers no more
_TINY = 16  # [px] of what MuJoCo itself allocates

_thread = threading.local()


@atexit.register
def _free() -> None:
    """While there still is an interpreter to do it."""
    if hasattr(_thread, "context"):
        _thread.context.free()


def thread_context() -> mujoco.GLContext:
    """The OpenGL context of this thread, current from now on. It stays: to make one takes as long as several frames, and 7 MB."""
    if not hasattr(_thread, "context"):
        _thread.context = mujoco.GLContext(64, 64)
    _thread.context.make_current()
    return _thread.context


def drawing_context(model: mujoco.MjModel, width: int, height: int) -> mujoco.MjrContext:
    """A model on the graphics card, or what stands for it, with buffers of `width` x `height` px, in the current context.

    Raises:
        RenderingError: the driver has no such buffers.
    """
    shown, quality = model.vis.global_, model.vis.quality
    shown.offwidth = shown.offheight = _TINY
    quality.offsamples, quality.shadowsize = SAMPLES, 0
    context = mujoco.MjrContext(model, int(mujoco.mjtFontScale.mjFONTSCALE_50))
    try:
        if context.offSamples != SAMPLES:  # MuJoCo falls back in silence to what the driver can do
            raise RenderingError(f"{context.offSamples} samples a pixel; needed: {SAMPLES}")
        _replace_buffers(context, width, height)
    except Exception as error:  # PyOpenGL's are of no common type
        context.free()
        raise RenderingError(f"the driver has no buffers of {width} x {height} px: {error}") from error
    return context


def _replace_buffers(context: mujoco.MjrContext, width: int, height: int) -> None:
    # PyOpenGL looks for its library when it is imported: after a backend has been chosen.
    from OpenGL.raw.GL.VERSION import GL_1_1, GL_3_0

    target, depth = GL_3_0.GL_RENDERBUFFER, GL_3_0.GL_DEPTH_COMPONENT32F

    def store(buffer: int, samples: int, kind: int, size: tuple[int, int]) -> None:
        GL_3_0.glBindRenderbuffer(target, buffer)
        GL_3_0.glRenderbufferStorageMultisample(target, samples, kind, *size)

    def detach(*points: int) -> None:
        for point in points:
            GL_3_0.glFramebufferRenderbuffer(GL_3_0.GL_FRAMEBUFFER, point, target, 0)

    def check() -> None:
        if GL_3_0.glCheckFramebufferStatus(GL_3_0.GL_FRAMEBUFFER) != GL_3_0.GL_FRAMEBUFFER_COMPLETE:
            raise RenderingError("incomplete")

    GL_3_0.glBindFramebuffer(GL_3_0.GL_FRAMEBUFFER, context.offFBO)
    detach(GL_3_0.GL_STENCIL_ATTACHMENT)
    store(context.offColor, SAMPLES, GL_1_1.GL_RGBA8, (width, height))
    store(context.offDepthStencil, SAMPLES, depth, (width, height))
    check()
    GL_3_0.glBindFramebuffer(GL_3_0.GL_FRAMEBUFFER, context.offFBO_r)
    detach(GL_3_0.GL_STENCIL_ATTACHMENT, GL_3_0.GL_DEPTH_ATTACHMENT)
    store(context.offColor_r, 0, GL_1_1.GL_RGBA8, (width, height))
    check()
    context.offWidth, context.offHeight = width, height
