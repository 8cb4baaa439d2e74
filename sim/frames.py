"""Frames of many poses, by several processes where that is quicker; the same bytes for any number of them."""

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import current_process, get_context
from tempfile import TemporaryDirectory

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import RigidTransform

from extremal.estimator.camera import Camera
from extremal.estimator.errors import InvalidInput, RenderingError
from extremal.sim.gl import select_backend
from extremal.sim.quality import Quality
from extremal.sim.rendering import FrameRenderer

Progress = Callable[[int, int], None]
Shot = tuple[RigidTransform, NDArray[np.floating]]  # pose or poses, gains (3,)

# Measured on two cores with llvmpipe: what one process takes for a vertex and for a rendered pixel [s], what further
# processes take before their first frames [s], and the share of their cores that they turn into speed: one
# process alone already uses several for rasterising.
VERTEX_SECONDS, PIXEL_SECONDS = 2.5e-7, 2.5e-8
START_SECONDS, EFFICIENCY = 4.0, 0.75

_renderer: list[FrameRenderer] = []


def render_frames(
    model: mujoco.MjModel,
    camera: Camera,
    quality: Quality,
    T_world_camera: RigidTransform | Sequence[RigidTransform],
    workers: int | None = None,
    progress: Progress | None = None,
    gains: ArrayLike | None = None,
) -> list[NDArray[np.float32]]:
    """Frames without noise (height, width) [grey levels] for poses (V).

    Args:
        model: from `scene_model`.
        T_world_camera: a pose for each frame; or several, over which the frame is averaged: motion blur.
        workers: number of processes; 1: this one alone; None: what is estimated to be quickest. More than one
            imports the main module again, as always with spawned processes: scripts need the
            `if __name__ == "__main__"` guard.
        progress: called with (frames done, frames in all) after every frame, in this process.
        gains: (V, 3) of R, G and B in each frame; None: all 1.

    Raises:
        InvalidInput: no poses, or some that are not finite; gains that are not (V, 3) positive numbers.
        RenderingError: rendering fails, or a process of its own can't be started.
    """
    if workers is not None and not 1 <= workers <= 256:
        raise InvalidInput(f"workers is {workers!r}; accepted: 1 to 256, or None to choose")
    count = len(T_world_camera)
    if count == 0:
        raise InvalidInput("there are no poses; accepted: one or more")
    poses = [T_world_camera[i] for i in range(count)]
    channels = np.ones((count, 3)) if gains is None else np.asarray(gains, float)
    if channels.shape != (count, 3):
        raise InvalidInput(f"gains are {channels.shape}; accepted: ({count}, 3), as there are frames")
    shots: list[Shot] = list(zip(poses, channels, strict=True))
    if workers is None:
        exposures = sum(1 if pose.single else len(pose) for pose in poses)
        workers = min(count, _quickest(model, camera, quality, exposures))
    report = progress or (lambda done, total: None)
    report(0, count)
    if min(workers, count) == 1:
        return _render_here(model, camera, quality, shots, report)
    return _render_there(model, camera, quality, shots, min(workers, count), report)


def _quickest(model: mujoco.MjModel, camera: Camera, quality: Quality, count: int) -> int:
    if current_process().daemon:
        return 1  # must not have children
    pixels = camera.width * camera.height * quality.supersampling**2
    vertices = int(model.nmeshvert)
    serial = count * quality.passes * (VERTEX_SECONDS * vertices + PIXEL_SECONDS * pixels)
    cores = min(len(os.sched_getaffinity(0)), count, 8)
    return cores if serial / (EFFICIENCY * cores) + START_SECONDS < 0.9 * serial else 1


def _render_here(
    model: mujoco.MjModel, camera: Camera, quality: Quality, shots: list[Shot], report: Progress
) -> list[NDArray[np.float32]]:
    frames = []
    with FrameRenderer(model, camera, quality) as renderer:
        for shot in shots:
            frames.append(renderer.render(*shot))
            report(len(frames), len(shots))
    return frames


def _render_there(
    model: mujoco.MjModel,
    camera: Camera,
    quality: Quality,
    shots: list[Shot],
    workers: int,
    report: Progress,
) -> list[NDArray[np.float32]]:
    select_backend()
    frames: dict[int, NDArray[np.float32]] = {}
    try:
        # The model goes through a file: a process that dies early would leave this one writing to its pipe for ever.
        with (
            TemporaryDirectory() as folder,
            _single_threaded_gl(),
            ProcessPoolExecutor(
                workers, get_context("spawn"), _start, (_saved(model, folder), camera, quality)
            ) as pool,
        ):
            jobs = {pool.submit(_render, shot): i for i, shot in enumerate(shots)}
            for job in as_completed(jobs):
                frames[jobs[job]] = job.result()
                report(len(frames), len(shots))
    except BrokenProcessPool as error:
        raise RenderingError(
            'a rendering process died; a script must call this under `if __name__ == "__main__":`, or with workers=1'
        ) from error
    return [frames[i] for i in range(len(shots))]


@contextmanager
def _single_threaded_gl() -> Iterator[None]:
    """Processes started here render in one thread each: llvmpipe's own would only compete."""
    before = os.environ.get("LP_NUM_THREADS")
    os.environ["LP_NUM_THREADS"] = "0"
    try:
        yield
    finally:
        if before is None:
            del os.environ["LP_NUM_THREADS"]
        else:
            os.environ["LP_NUM_THREADS"] = before


def _saved(model: mujoco.MjModel, folder: str) -> str:
    path = os.path.join(folder, "model.mjb")
    mujoco.mj_saveModel(model, path, None)
    return path


def _start(path: str, camera: Camera, quality: Quality) -> None:
    """In a worker: its renderer lives as long as the process."""
    model = mujoco.MjModel.from_binary_path(path)
    _renderer.append(FrameRenderer(model, camera, quality).__enter__())


def _render(shot: Shot) -> NDArray[np.float32]:
    return _renderer[0].render(*shot)
