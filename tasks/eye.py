"""Colour images of a scene, as a person or a policy sees them: no point-spread function, no noise."""

from dataclasses import dataclass
from types import TracebackType
from typing import Self

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from extremal.estimator.camera import Camera
from extremal.estimator.errors import InvalidInput, RenderingError
from extremal.scenes import Scene
from extremal.scenes.grids import QUICK
from extremal.sim.axes import place_eye
from extremal.sim.buffers import drawing_context, thread_context
from extremal.sim.gl import select_backend
from extremal.sim.rendering import EYE, FARTHEST, NEAR, scene_model


@dataclass(frozen=True, eq=False)
class _Drawing:
    """What an open eye holds."""

    model: mujoco.MjModel
    data: mujoco.MjData
    scene: mujoco.MjvScene
    view: mujoco.MjvCamera
    gl: mujoco.GLContext
    context: mujoco.MjrContext

    @staticmethod
    def of(model: mujoco.MjModel, width: int, height: int) -> "_Drawing":
        gl = thread_context()
        context = drawing_context(model, width, height)
        view = mujoco.MjvCamera()
        view.type, view.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, model.camera(EYE).id
        scene = mujoco.MjvScene(model, maxgeom=model.ngeom + 10)
        return _Drawing(model, mujoco.MjData(model), scene, view, gl, context)


class Eye:
    """Renders a scene (width x height px) from any pose with MuJoCo; a context manager, of one thread.

    Its field of view is the camera's along the narrower side.

    Raises:
        RenderingError: offscreen rendering is not available.
    """

    def __init__(self, scene: Scene, camera: Camera, width: int, height: int) -> None:
        select_backend()
        model = scene_model(scene.to_spec(QUICK))
        focal = max(width / camera.width * camera.fx, height / camera.height * camera.fy)
        eye = model.camera(EYE).id
        model.vis.map.znear = NEAR / model.stat.extent
        model.cam_resolution[eye] = model.cam_sensorsize[eye] = width, height
        model.cam_intrinsic[eye] = focal, focal, 0.0, 0.0
        self.camera = Camera(
            width, height, fx=focal, fy=focal, cx=(width - 1) / 2, cy=(height - 1) / 2, blur=camera.blur
        )
        try:
            self._drawing: _Drawing | None = _Drawing.of(model, width, height)
        except Exception as error:
            raise RenderingError(f"no offscreen rendering of {width} x {height} px: {error}") from error

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def image(self, T_world_camera: RigidTransform) -> NDArray[np.uint8]:
        """(height, width, 3) RGB.

        Raises:
            InvalidInput: a pose that is not single and finite, which would be rendered black.
            RenderingError: after `close`.
        """
        if self._drawing is None:
            raise RenderingError("the eye is closed; accepted: a new one")
        pose = T_world_camera.as_matrix()
        if not (T_world_camera.single and np.all(np.abs(pose) < FARTHEST)):
            raise InvalidInput(
                f"T_world_camera is {pose.tolist()!r:.200}; accepted: one transform, less than "
                f"{FARTHEST:g} m away"
            )
        drawing = self._drawing
        model, data, scene = drawing.model, drawing.data, drawing.scene
        place_eye(model, data, pose)
        categories = int(mujoco.mjtCatBit.mjCAT_ALL)
        mujoco.mjv_updateScene(model, data, mujoco.MjvOption(), None, drawing.view, categories, scene)
        pixels = np.empty((self.camera.height, self.camera.width, 3), np.uint8)
        viewport = mujoco.MjrRect(0, 0, self.camera.width, self.camera.height)
        drawing.gl.make_current()
        mujoco.mjr_setBuffer(int(mujoco.mjtFramebuffer.mjFB_OFFSCREEN), drawing.context)
        mujoco.mjr_render(viewport, scene, drawing.context)
        mujoco.mjr_readPixels(pixels, None, viewport, drawing.context)
        return np.ascontiguousarray(pixels[::-1])

    def close(self) -> None:
        """Free the buffers and the model: garbage collection may come late to a cycle that the eye is part of."""
        if self._drawing is not None:
            self._drawing.gl.make_current()
            self._drawing.context.free()
            self._drawing = None
