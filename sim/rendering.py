"""Offscreen frames without noise: MuJoCo renders finely, the point-spread function and the pixels average."""

from dataclasses import dataclass
from functools import lru_cache
from types import TracebackType
from typing import Self

import cv2
import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse
from scipy.spatial.transform import RigidTransform

from extremal.estimator.camera import Camera
from extremal.estimator.errors import InvalidInput, RenderingError
from extremal.sim.axes import place_eye
from extremal.sim.backdrop import Backdrop
from extremal.sim.buffers import SAMPLES, drawing_context, thread_context
from extremal.sim.gl import select_backend
from extremal.sim.quality import Quality, get_quality, sampling_matrix
from extremal.sim.window import Window

EYE = "eye"
NEAR = 0.02  # nearest distance that is drawn [m]
WHITE = (1.0, 1.0, 1.0)
FARTHEST = 1e5  # a camera may be from the world's origin [m]
MAX_BUFFER = 16384  # longest side of a rendered frame [px]


def scene_model(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """Compile a scene with the body `EYE`, a camera that can be put anywhere. The spec is modified.

    Raises:
        RenderingError: MuJoCo can't compile it.
    """
    eye = spec.worldbody.add_body(name=EYE, mocap=True)
    eye.add_camera(name=EYE)
    spec.visual.quality.shadowsize = 0
    spec.visual.quality.offsamples = SAMPLES
    try:
        return spec.compile()
    except ValueError as error:
        raise RenderingError(f"MuJoCo can't compile the scene: {error}") from error


@dataclass(frozen=True, eq=False)
class _Stage:
    """What an open renderer holds: garbage collection may come late to a cycle that a closed one is part of."""

    gl: mujoco.GLContext
    context: mujoco.MjrContext
    data: mujoco.MjData
    scene: mujoco.MjvScene
    view: mujoco.MjvCamera
    option: mujoco.MjvOption
    backdrop: Backdrop | None

    @staticmethod
    def of(model: mujoco.MjModel, width: int, height: int) -> "_Stage":
        gl = thread_context()
        context = drawing_context(model, width, height)
        scene = mujoco.MjvScene(model, maxgeom=model.ngeom + 10)
        backdrop = Backdrop.of(model)
        for flag in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
            scene.flags[flag] = 0
        if backdrop:
            scene.flags[mujoco.mjtRndFlag.mjRND_SKYBOX] = 0
        view = mujoco.MjvCamera()
        view.type, view.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, model.camera(EYE).id
        return _Stage(gl, context, mujoco.MjData(model), scene, view, mujoco.MjvOption(), backdrop)

    def free(self) -> None:
        self.gl.make_current()
        self.context.free()


class FrameRenderer:
    """Renders frames of one model with one camera, in a context manager; of one thread.

    A frame is float32 grey levels (height, width) in 0..255: the scene's luminance (mean of R, G, B), convolved with the
    Gaussian of `camera.blur` and the pixel's box. Pixel (0, 0) is the centre of the top-left pixel.

    Args:
        model: from `scene_model`.
        camera: intrinsics, distortion and blur.
        quality: a name in `QUALITIES`, or one of your own.

    Raises:
        RenderingError: offscreen rendering is not available, or gives another buffer than asked for.
    """

    def __init__(self, model: mujoco.MjModel, camera: Camera, quality: str | Quality = "standard") -> None:
        self.camera, self.quality = camera, get_quality(quality)
        self._model = model
        self._window = Window.around(camera, self.quality.supersampling)
        self._stage: _Stage | None = None
        self._check_model()

    def __enter__(self) -> Self:
        select_backend()
        model, (height, width) = self._model, self._window.shape
        model.vis.map.znear = NEAR / model.stat.extent
        try:
            self._stage = _Stage.of(model, width, height)
        except Exception as error:
            raise RenderingError(f"no offscreen rendering of {width} x {height} px: {error}") from error
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Free the buffers; the renderer can be entered again."""
        if self._stage is not None:
            self._stage.free()
            self._stage = None

    def render(
        self, T_world_camera: RigidTransform, gains: ArrayLike = WHITE, part: Camera | None = None
    ) -> NDArray[np.float32]:
        """The frame (height, width) [grey levels] seen from a pose, or from poses (S) in turn while the shutter is open.

        Args:
            T_world_camera: a pose; or S, those in the middle of equal parts of the exposure, of which the mean is taken.
            gains: (3,) of R, G and B, before their mean is taken.
            part: the camera, `cropped`: of its frame only this part is rendered, in less time.

        Raises:
            InvalidInput: a pose is not finite, gains are not positive, or the part is larger than the whole.
            RenderingError: outside the context manager.
        """
        if self._stage is None:
            raise RenderingError("the renderer is closed; use it in a `with` statement")
        matrices = T_world_camera.as_matrix()
        shape = matrices.shape[:-2]
        # MuJoCo renders from a camera that is not finite, in single precision, without an error: black
        if len(shape) > 1 or 0 in shape or not np.all(np.abs(matrices) < FARTHEST):
            raise InvalidInput(
                f"T_world_camera of shape {shape} must be one finite transform, or a row of them, less than {FARTHEST:g} m away"
            )
        weights = np.asarray(gains, np.float32)
        if weights.shape != (3,) or not np.all((weights > 0) & np.isfinite(weights)):
            raise InvalidInput(f"gains are {weights.tolist()}; accepted: three positive numbers")
        self._stage.gl.make_current()
        poses = matrices.reshape(-1, 4, 4)
        camera, s = part or self.camera, self.quality.supersampling
        window = Window.around(part, s) if part else self._window
        if np.any(np.array(window.shape) > self._window.shape):
            raise InvalidInput(
                f"a part of {camera.width} x {camera.height} px; accepted: parts of {self.camera.width} x {self.camera.height} px"
            )
        total = np.zeros(window.shape, np.float32)
        for pose in poses:
            place_eye(self._model, self._stage.data, pose)
            for offset in self.quality.offsets:
                channels = cv2.split(self._draw(self._stage, window, offset))
                for channel, weight in zip(channels, weights, strict=True):
                    total += channel if weight == 1 else weight * channel
        if camera.is_distorted:
            total = window.distort(total)
        # Sparse products: the same bytes on every machine and with any number of threads.
        rows = _sampling(camera.height, s, camera.blur, True)
        columns = _sampling(camera.width, s, camera.blur, False)
        frame = (columns @ np.ascontiguousarray((rows @ total).T)).T
        return np.ascontiguousarray(frame / (3 * self.quality.passes * len(poses)), np.float32)

    def _draw(self, stage: _Stage, window: Window, offset: NDArray[np.floating]) -> NDArray[np.uint8]:
        """One pass (height, width, 3) over a window, bottom row first; `offset` (2,) shifts the image [rendered px]."""
        (fx, fy), (cx, cy) = window.focal, window.principal + offset
        height, width = window.shape
        model, data, eye = self._model, stage.data, stage.view.fixedcamid
        model.cam_resolution[eye] = model.cam_sensorsize[eye] = width, height  # lengths in rendered pixels
        # MuJoCo's principal point: both coordinates measured from the centre, against the image axes.
        model.cam_intrinsic[eye] = fx, fy, width / 2 - cx, height / 2 - cy
        categories = int(mujoco.mjtCatBit.mjCAT_ALL)
        mujoco.mjv_updateScene(model, data, stage.option, None, stage.view, categories, stage.scene)
        if stage.backdrop:
            stage.backdrop.add_to(
                stage.scene, data.cam_xpos[eye], data.cam_xmat[eye], (width / fx, height / fy)
            )
        pixels = np.empty((height, width, 3), np.uint8)
        viewport = mujoco.MjrRect(0, 0, width, height)
        mujoco.mjr_setBuffer(int(mujoco.mjtFramebuffer.mjFB_OFFSCREEN), stage.context)
        mujoco.mjr_render(viewport, stage.scene, stage.context)
        mujoco.mjr_readPixels(pixels, None, viewport, stage.context)
        return pixels

    def _check_model(self) -> None:
        if mujoco.mj_name2id(self._model, int(mujoco.mjtObj.mjOBJ_CAMERA), EYE) < 0:
            raise InvalidInput(f"the model has no camera {EYE!r}; accepted: models made by scene_model")
        if max(self._window.shape) > MAX_BUFFER:
            size = "x".join(map(str, self._window.shape[::-1]))
            raise InvalidInput(
                f"quality {self.quality.name} renders this camera at {size} px; accepted: sides up to {MAX_BUFFER} px"
            )


@lru_cache(maxsize=128)
def _sampling(size: int, supersampling: int, blur: float, backwards: bool) -> sparse.csr_array:
    """`sampling_matrix` of pixels that are counted from the other end, as OpenGL does with rows."""
    matrix = sampling_matrix(size, supersampling, blur)
    return matrix[:, ::-1] if backwards else matrix
