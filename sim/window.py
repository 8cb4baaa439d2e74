"""The pinhole image that is rendered for a camera: with a margin, on a finer grid, before lens distortion."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline
from scipy.ndimage import map_coordinates

from extremal.estimator.camera import Array, Camera
from extremal.estimator.errors import InvalidInput
from extremal.sim.quality import psf_margin

NODE_SPACING = 8.0  # [px] of the spline that stands for the distortion; it errs by less than 1e-4 px


@dataclass(frozen=True)
class Window:
    """A rectangle of the camera's ideal pinhole image, sampled `scale` times a pixel.

    Attributes:
        camera: whose image is rendered.
        scale: rendered pixels along each side of a sensor pixel.
        left, top: sensor-pixel coordinates of the corner's pixel, in the pinhole image.
        width, height: in sensor pixels.
    """

    camera: Camera
    scale: int
    left: int
    top: int
    width: int
    height: int

    @classmethod
    def around(cls, camera: Camera, scale: int) -> "Window":
        """The window that holds all that the sensor and its margin for blur see."""
        m = psf_margin(camera.blur)
        if not camera.is_distorted:
            return cls(camera, scale, -m, -m, camera.width + 2 * m, camera.height + 2 * m)
        x, y = np.arange(-m - 1.0, camera.width + m + 1), np.arange(-m - 1.0, camera.height + m + 1)
        border = np.concatenate(
            [_grid(x, y[[0, -1]]).reshape(-1, 2), _grid(x[[0, -1]], y).reshape(-1, 2)]
        )  # for a one-to-one distortion, the image of the border bounds the image of the inside
        ideal = _undistort(camera, border)
        low = np.floor(ideal.min(axis=0)).astype(int) - 4  # room for the interpolation kernel
        size = np.ceil(ideal.max(axis=0)).astype(int) + 5 - low
        if np.any(size > 4 * np.array([camera.width, camera.height])):
            raise InvalidInput(
                f"distortion {camera.distortion} needs a pinhole image of {size[0]} x {size[1]} px; accepted: up to four times the sensor"
            )
        return cls(camera, scale, int(low[0]), int(low[1]), int(size[0]), int(size[1]))

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the rendered image."""
        return self.height * self.scale, self.width * self.scale

    @property
    def focal(self) -> Array:
        """Focal lengths (2,) [rendered px]."""
        return self.scale * np.array([self.camera.fx, self.camera.fy])

    @property
    def principal(self) -> Array:
        """Principal point (2,) [rendered px] from the outer corner of the top-left pixel."""
        corner = np.array([self.left, self.top]) - 0.5
        return self.scale * (np.array([self.camera.cx, self.camera.cy]) - corner)

    def distort(self, image: NDArray[np.float32]) -> NDArray[np.float32]:
        """The sensor's fine image, with margin, from the rendered one; rows of both start at the bottom."""
        return np.asarray(
            map_coordinates(image, self._maps[::-1], np.float32, order=3, mode="nearest"), np.float32
        )

    @cached_property
    def _maps(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """For every fine pixel of the sensor, where it lies in the rendered image."""
        camera, s, m = self.camera, self.scale, psf_margin(self.camera.blur)
        x, y = ((np.arange(s * (n + 2 * m)) + 0.5) / s - 0.5 - m for n in (camera.width, camera.height))
        nodes_x, nodes_y = (np.linspace(v[0], v[-1], int(np.ptp(v) / NODE_SPACING) + 8) for v in (x, y))
        ideal = _undistort(camera, _grid(nodes_x, nodes_y))
        u, v = (RectBivariateSpline(nodes_y, nodes_x, ideal[..., i])(y, x) for i in range(2))
        columns = (u - self.left + 0.5) * s - 0.5
        rows = self.shape[0] - 1 - ((v - self.top + 0.5) * s - 0.5)
        return columns[::-1].astype(np.float32), rows[::-1].astype(np.float32)


def cropped(camera: Camera, left: int, top: int, width: int, height: int) -> Camera:
    """The camera of a part of the image: of `width` x `height` px, whose corner is the pixel (left, top)."""
    return replace(camera, width=width, height=height, cx=camera.cx - left, cy=camera.cy - top)


def _grid(x: Array, y: Array) -> Array:
    return np.stack(np.meshgrid(x, y), axis=-1)


def _undistort(camera: Camera, pixels: Array) -> Array:
    """Pinhole pixels (..., 2) of pixels (..., 2); InvalidInput where the distortion can't be inverted."""
    with np.errstate(over="ignore", invalid="ignore"):  # where the iteration diverges
        ideal = camera.normalise(pixels)
    if not np.max(np.abs(camera.distort(ideal) - pixels)) < 1e-6:
        raise InvalidInput(
            f"distortion {camera.distortion} can't be inverted all over the image; accepted: one-to-one distortions"
        )
    return ideal * (camera.fx, camera.fy) + (camera.cx, camera.cy)
