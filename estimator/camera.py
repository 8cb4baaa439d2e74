"""The camera model and one view of it: the value types that scenes, sim and the estimator share."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import RigidTransform

from extremal.estimator.errors import InvalidInput

Array = NDArray[np.floating]


@dataclass(frozen=True)
class Camera:
    """Pinhole camera with Brown-Conrady distortion and a Gaussian point-spread function.

    Pixel (0, 0) is the centre of the top-left pixel; camera axes are x right, y down, z forward.

    Attributes:
        width, height: image size [px].
        fx, fy: focal lengths [px].
        cx, cy: principal point [px]; default: the image centre, ((width - 1) / 2, (height - 1) / 2).
        distortion: (k1, k2, p1, p2, k3) of the Brown-Conrady model.
        blur: standard deviation of the optical point-spread function [px], without the pixel's own area.
        gamma: grey levels are 255 (E / 255)^(1 / gamma) of the light E in 0..255; 1: proportional to it.
    """

    width: int = 640
    height: int = 480
    fx: float = 800.0
    fy: float = 800.0
    cx: float = field(default=float("nan"))
    cy: float = field(default=float("nan"))
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    blur: float = 0.7
    gamma: float = 1.0

    def __post_init__(self) -> None:
        for name, size in (("width", self.width), ("height", self.height)):
            if not (isinstance(size, int | np.integer) and 8 <= size <= 16384):
                raise InvalidInput(f"camera {name} is {size!r}; accepted: an integer from 8 to 16384 [px]")
        if np.isnan(self.cx):
            object.__setattr__(self, "cx", (self.width - 1) / 2)
        if np.isnan(self.cy):
            object.__setattr__(self, "cy", (self.height - 1) / 2)
        for name, value in (("fx", self.fx), ("fy", self.fy)):
            if not (np.isfinite(value) and value > 0):
                raise InvalidInput(f"camera {name} is {value!r}; accepted: a positive number of pixels")
        if not np.all(np.isfinite([self.cx, self.cy, *self.distortion])) or len(self.distortion) != 5:
            raise InvalidInput(
                f"camera principal point ({self.cx}, {self.cy}) or distortion {self.distortion} "
                "is not made of finite numbers (five of them for the distortion: k1, k2, p1, p2, k3)"
            )
        if not (np.isfinite(self.blur) and self.blur >= 0):
            raise InvalidInput(f"camera blur is {self.blur!r}; accepted: 0 or a positive number of pixels")
        if not (np.isfinite(self.gamma) and 1 <= self.gamma <= 4):
            raise InvalidInput(f"camera gamma is {self.gamma!r}; accepted: 1 (linear) to 4")

    @cached_property
    def matrix(self) -> Array:
        """Intrinsic matrix K (3, 3)."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1.0]])

    @cached_property
    def _pixel_scale(self) -> tuple[Array, Array]:
        """(fx, fy) and (cx, cy): arrays, which cost as much to make as a few points to project."""
        return np.array([self.fx, self.fy]), np.array([self.cx, self.cy])

    @cached_property
    def is_distorted(self) -> bool:
        return any(self.distortion)

    def encode(self, light: NDArray[np.floating]) -> NDArray[np.uint8]:
        """Grey levels of light (...) in 0..255 grey levels, clipped to that range; the inverse of `linear`."""
        light = np.clip(light, 0, 255)
        return np.rint(light if self.gamma == 1 else 255 * (light / 255) ** (1 / self.gamma)).astype(np.uint8)

    def linear(self, image: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Light (height, width) in 0..255 grey levels of an image (height, width[, 3]); of colours their mean.

        Raises:
            InvalidInput: the image is not uint8 of either shape.
        """
        if image.dtype != np.uint8 or not (image.ndim == 2 or (image.ndim == 3 and image.shape[2] == 3)):
            raise InvalidInput(
                f"image is {image.dtype} {image.shape}; accepted: uint8 (height, width) or (height, width, 3)"
            )
        if self.gamma == 1:
            return image.astype(np.float32) if image.ndim == 2 else image.mean(axis=2, dtype=np.float32)
        light = (255 * (np.arange(256) / 255) ** self.gamma).astype(np.float32)[image]
        return light if light.ndim == 2 else light.mean(axis=2)

    def project(self, p_camera: ArrayLike) -> Array:
        """Pixels (..., 2) of points (..., 3) [m] in the camera frame; NaN for points behind the camera."""
        p = np.asarray(p_camera, float)
        z = p[..., 2:]
        return self.distort(p[..., :2] / np.where(z > 0, z, np.nan))

    def distort(self, normalised: ArrayLike) -> Array:
        """Pixels (..., 2) of ideal image coordinates (..., 2) = (X/Z, Y/Z) (Brown-Conrady)."""
        xy = np.asarray(normalised, float)
        if self.is_distorted:
            k1, k2, p1, p2, k3 = self.distortion
            x, y = xy[..., 0], xy[..., 1]
            r2 = x * x + y * y
            radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
            xy = np.stack(
                [
                    x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
                    y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
                ],
                axis=-1,
            )
        focal, middle = self._pixel_scale
        return xy * focal + middle

    def normalise(self, pixels: ArrayLike) -> Array:
        """Ideal image coordinates (..., 2) = (X/Z, Y/Z) of pixels (..., 2); the inverse of `distort`."""
        pixels = np.asarray(pixels, float)
        if not self.is_distorted:
            return (pixels - (self.cx, self.cy)) / (self.fx, self.fy)
        ideal = (pixels - (self.cx, self.cy)) / (self.fx, self.fy)
        for _ in range(
            50
        ):  # fixed point; OpenCV's own iteration has a name of its own in every major version
            error = pixels - self.distort(ideal)
            ideal = ideal + error / (self.fx, self.fy)
            if not np.nanmax(np.abs(error), initial=0.0) > 1e-10:
                break
        return ideal

    def rays(self, pixels: ArrayLike) -> Array:
        """Unit rays (..., 3) in the camera frame through pixels (..., 2)."""
        xy = self.normalise(pixels)
        rays = np.concatenate([xy, np.ones_like(xy[..., :1])], axis=-1)
        return rays / np.linalg.norm(rays, axis=-1, keepdims=True)


@dataclass(frozen=True, eq=False)
class View:
    """One frame with the pose that the robot believes the camera had.

    Attributes:
        camera: the camera model.
        T_world_camera: pose; maps camera coordinates to world coordinates.
        image: grey (height, width) or RGB (height, width, 3) frame, uint8.
        pose_covariance: (6, 6) covariance of (translation [m], rotation vector [rad]) in the camera frame,
            right-multiplied; zero where the pose is exact.
        ignored: (height, width) pixels in which no contour is looked for; None: none.
    """

    camera: Camera
    T_world_camera: RigidTransform
    image: NDArray[np.uint8]
    pose_covariance: Array = field(default_factory=lambda: np.zeros((6, 6)))
    ignored: NDArray[np.bool_] | None = None

    def __post_init__(self) -> None:
        shape = (self.camera.height, self.camera.width)
        if self.image.dtype != np.uint8 or self.image.shape not in (shape, (*shape, 3)):
            raise InvalidInput(
                f"image is {self.image.dtype} {self.image.shape}; accepted: uint8 {shape} or {(*shape, 3)}"
            )
        if not np.all(np.isfinite(self.T_world_camera.as_matrix())):
            raise InvalidInput("T_world_camera holds a number that is not finite")
        if self.pose_covariance.shape != (6, 6) or not np.all(np.isfinite(self.pose_covariance)):
            raise InvalidInput("pose_covariance must be a finite (6, 6) array")
        if self.ignored is not None and (self.ignored.dtype != bool or self.ignored.shape != shape):
            raise InvalidInput(
                f"ignored is {self.ignored.dtype} {self.ignored.shape}; accepted: bool {shape}, or None"
            )

    @property
    def centre(self) -> Array:
        """Camera centre (3,) [m] in the world."""
        return self.T_world_camera.translation

    def rays(self, pixels: ArrayLike) -> Array:
        """Unit rays (..., 3) in the world through pixels (..., 2)."""
        return self.camera.rays(pixels) @ self.T_world_camera.rotation.as_matrix().T

    def project(self, p_world: ArrayLike) -> Array:
        """Pixels (..., 2) of points (..., 3) [m] in the world; NaN for points behind the camera."""
        rotation = self.T_world_camera.rotation.as_matrix()
        return self.camera.project((np.asarray(p_world, float) - self.centre) @ rotation)
