"""One OpenGL context a thread, buffers without stencil: renderers draw side by side what they draw alone."""

import threading

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from extremal.estimator import Camera, RenderingError
from extremal.scenes import Box, Scene, Sphere, Surface
from extremal.scenes.grids import QUICK
from extremal.sim import FrameRenderer, scene_model
from extremal.sim.buffers import drawing_context, thread_context

POSE = RigidTransform.from_translation([0.0, 0.0, -1.0])


def renderer(solid: Surface, width: int) -> FrameRenderer:
    camera = Camera(width, width * 3 // 4, fx=float(width), fy=float(width))
    return FrameRenderer(scene_model(Scene((solid,)).to_spec(QUICK)), camera, "preview")


def box() -> FrameRenderer:
    return renderer(Box((0.1, 0.1, 0.1)), 160)


def ball() -> FrameRenderer:
    return renderer(Sphere(0.07), 80)


def alone(one: FrameRenderer) -> NDArray[np.float32]:
    with one:
        return one.render(POSE)


def test_renderers_in_any_order_draw_as_they_do_alone() -> None:
    expected_box, expected_ball = alone(box()), alone(ball())
    first, second = box(), ball()
    with first:
        np.testing.assert_array_equal(first.render(POSE), expected_box)
        with second:
            np.testing.assert_array_equal(second.render(POSE), expected_ball)
            np.testing.assert_array_equal(first.render(POSE), expected_box)
            first.close()
            np.testing.assert_array_equal(second.render(POSE), expected_ball)
            first.__enter__()
            np.testing.assert_array_equal(first.render(POSE), expected_box)
        np.testing.assert_array_equal(first.render(POSE), expected_box)


def test_every_thread_draws_in_a_context_of_its_own() -> None:
    expected, found = alone(ball()), []
    with box() as here:
        before = here.render(POSE)
        thread = threading.Thread(target=lambda: found.append((thread_context(), alone(ball()))))
        thread.start()
        thread.join()
        np.testing.assert_array_equal(here.render(POSE), before)
    ((context, frame),) = found
    assert context is not thread_context()
    np.testing.assert_array_equal(frame, expected)


@pytest.mark.parametrize("width", [0, 10**6])
def test_buffers_that_no_driver_has_are_an_error(width: int) -> None:
    model = scene_model(Scene((Sphere(0.07),)).to_spec(QUICK))
    with box() as working:
        before = working.render(POSE)
        with pytest.raises(RenderingError, match=f"no buffers of {width} x 48 px"):
            drawing_context(model, width, 48)
        np.testing.assert_array_equal(working.render(POSE), before)
