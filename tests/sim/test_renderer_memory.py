"""What renderers leave behind, and what a live one takes: in a process of its own, whose memory nothing else disturbs."""

import subprocess
import sys

import pytest

HEAD = """
import gc
import resource
from pathlib import Path

import mujoco
from scipy.spatial.transform import RigidTransform

from extremal.estimator import Camera
from extremal.scenes import Box, Scene
from extremal.sim import FrameRenderer, scene_model
from extremal.tasks.eye import Eye

scene = Scene((Box((0.1, 0.1, 0.1)),))
model = scene_model(scene.to_spec())
pose = RigidTransform.from_translation([0.0, 0.0, -1.0])


def used():
    gc.collect()
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 1e6


def frame(width=64):
    return FrameRenderer(model, Camera(width, width * 3 // 4, fx=width, fy=width), "preview")


"""

CREATE_AND_CLOSE = """
class Loop:
    def __init__(self, renderer):
        self.renderer, self.me = renderer, self


marks = []
for i in range(400):
    if i % 100 == 0:
        marks.append(used())
    if i % 2:
        with frame() as renderer:
            Loop(renderer).renderer.render(pose)
    else:
        with Eye(scene, Camera(), 64, 64) as eye:
            Loop(eye).renderer.image(pose)
marks.append(used())
print((marks[-1] - marks[1]) / 3)  # single hundreds differ by the megabytes in which an allocator takes memory
"""

LIVE = """
with frame(64) as first:
    first.render(pose)
before, live = used(), []
for i in range(4):
    live.append(frame({width}).__enter__())
    live[-1].render(pose)
print((used() - before) / len(live))
"""


def measured(script: str) -> float:
    done = subprocess.run(
        [sys.executable, "-c", HEAD + script], capture_output=True, text=True, check=False, timeout=1200
    )
    assert done.returncode == 0, done.stderr
    return float(done.stdout)


@pytest.mark.slow
def test_create_and_close_leaves_less_than_a_megabyte_a_hundred() -> None:
    """300 after a warm-up of 100, the renderers in reference cycles."""
    assert measured(CREATE_AND_CLOSE) < 1.0


@pytest.mark.slow
@pytest.mark.parametrize("width", [64, 320, 640])
def test_a_live_renderer_is_small(width: int) -> None:
    """Four samples a pixel take 36 bytes a pixel: at 640 x 480 12 MB of buffers, beside 1 MB and what the frame itself takes."""
    assert measured(LIVE.format(width=width)) < 20.0
