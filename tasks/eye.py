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
from extremal.sim.axes import swap_camera_axes
from extremal.sim.gl import select_backend
from extremal.sim.rendering import EYE, FARTHEST, NEAR, scene_model


@dataclass(frozen=True, eq=False)
class _Drawing:
    """What an open eye holds."""

    model: mujoco.MjModel
    data: mujoco.MjData
    renderer: mujoco.Renderer


class Eye:
    """Renders a scene (width x height px) from any pose with MuJoCo's own renderer; a context manager, of one thread.

    Its field of view is the camera's along the narrower side.

    Raises:
        RenderingError: offscreen rendering is not available.
    """

    def __init__(self, scene: Scene, camera: Camera, width: int, height: int) -> None:
        select_backend()
        model = scene_model(scene.to_spec(QUICK))
        focal = max(width / camera.width * camera.fx, height / camera.height * camera.fy)
        eye = model.camera(EYE).id
        model.vis.global_.offwidth, model.vis.global_.offheight = width, height
        model.vis.map.znear = NEAR / model.stat.extent
        model.cam_resolution[eye] = model.cam_sensorsize[eye] = width, height
        model.cam_intrinsic[eye] = focal, focal, 0.0, 0.0
        self.camera = Camera(
            width, height, fx=focal, fy=focal, cx=(width - 1) / 2, cy=(height - 1) / 2, blur=camera.blur
        )
        try:
            renderer = mujoco.Renderer(model, height, width, max_geom=model.ngeom + 10)
        except Exception as error:
            raise RenderingError(f"no offscreen rendering of {width} x {height} px: {error}") from error
        self._drawing: _Drawing | None = _Drawing(model, mujoco.MjData(model), renderer)

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
        if not (T_world_camera.single and np.all(np.abs(T_world_camera.as_matrix()) < FARTHEST)):
            raise InvalidInput(
                f"T_world_camera is {T_world_camera.as_matrix().tolist()!r:.200}; accepted: one transform, less than "
                f"{FARTHEST:g} m away"
            )
        eye = swap_camera_axes(T_world_camera)
        model, data, renderer = self._drawing.model, self._drawing.data, self._drawing.renderer
        data.mocap_pos[0] = eye.translation
        data.mocap_quat[0] = eye.rotation.as_quat(scalar_first=True)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_camlight(model, data)
        renderer.update_scene(data, EYE)
        return renderer.render()

    def close(self) -> None:
        """Free the renderer and its model: garbage collection may come late to a cycle that the eye is part of."""
        if self._drawing is not None:
            self._drawing.renderer.close()
            self._drawing = None
