"""The silhouette of one object before a plain background: its pixels, and its outline to sub-pixel accuracy.

The background's grey level is that of the image's border. The silhouette is what differs from it by more than half of the
contrast nearby. Its outline takes its accuracy from the image contours (`find_contours`) that run along its border.
"""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from scipy.spatial import cKDTree  # pyright: ignore[reportAttributeAccessIssue]

from extremal.estimator.camera import Array, View
from extremal.estimator.contours import Contours, find_contours
from extremal.estimator.detection import noise_level

BORDER = 4  # [px] strip along the image's border that shows background
BESIDE = 13  # [px] from the silhouette's border within which image contours are looked for
CLEAR = 6.0  # standard deviations of noise by which the object differs from the background
NEARBY = 15  # [px] window of the local contrast
SMALLEST = 100  # [px] area of a silhouette
ASIDE = 2.0  # [px] from the silhouette's border to an outline's edgel
TURNED = np.cos(np.radians(30))  # least agreement of their normals
STEP = 1.0  # [px] between points of the outline


@dataclass(frozen=True, eq=False)
class Outline:
    """The apparent contour of an object in one view, in the world.

    Attributes:
        view: the view.
        mask: (height, width) pixels of the object, holes filled.
        pixels: (n, 2) points of the outline, `STEP` apart along it.
        normals: (n, 2) unit, in the image, out of the object.
        rays: (n, 3) unit rays of the pixels; planes: (n, 3) unit normals of the tangent planes, out of the object.
        sigma: (n,) standard deviation [rad] of the rays across the outline.
        cut: the image's border cuts the object.
    """

    view: View
    mask: np.ndarray
    pixels: Array
    normals: Array
    rays: Array
    planes: Array
    sigma: Array
    cut: bool

    @cached_property
    def tree(self) -> cKDTree:
        """Of the pixels."""
        return cKDTree(self.pixels)


def find_outline(view: View) -> Outline:
    """The outline of the object before a plain background; empty where nothing stands out from it."""
    mask = silhouette(view.camera.linear(view.image))
    ignored = np.abs(signed_field(mask)) > BESIDE
    contours = find_contours(
        view.image, view.camera, ignored if view.ignored is None else ignored | view.ignored
    )
    pixels, normals, sigma = _along(mask, contours)
    rays, planes = _tangent_planes(view, pixels, normals)
    cut = mask.sum() > mask[1:-1, 1:-1].sum()
    return Outline(view, mask, pixels, normals, rays, planes, sigma / view.camera.fx, bool(cut))


def silhouette(grey: np.ndarray) -> np.ndarray:
    """Pixels (height, width) of the largest object of a grey image before a plain background, holes filled."""
    height, width = grey.shape
    strip = np.ones((height, width), bool)
    strip[BORDER:-BORDER, BORDER:-BORDER] = False
    background = np.median(grey[strip])
    contrast = np.abs(cv2.GaussianBlur(grey, (0, 0), 0.7) - background)
    inside = (contrast > CLEAR * noise_level(grey)).astype(np.uint8)
    inside = _largest(inside)
    # grown by the blur as it is, the object's own level is found farther inside
    core = cv2.erode(inside, np.ones((5, 5), np.uint8)).astype(np.float32)
    weight = cv2.blur(core, (NEARBY, NEARBY))
    level = cv2.blur(core * contrast, (NEARBY, NEARBY)) / np.maximum(weight, 1e-6)
    refined = inside.astype(bool) & ((contrast > 0.5 * level) | (weight < 1e-6) | (core > 0))
    return _largest(refined.astype(np.uint8)).astype(bool)


def _largest(mask: np.ndarray) -> np.ndarray:
    """The largest component of a mask, its holes filled; nothing if it is smaller than SMALLEST."""
    outer, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    filled = np.zeros_like(mask)
    if outer:
        cv2.drawContours(filled, [max(outer, key=cv2.contourArea)], -1, 1, cv2.FILLED)
    return filled if filled.sum() >= SMALLEST else np.zeros_like(mask)


def _along(mask: np.ndarray, contours: Contours) -> tuple[Array, Array, Array]:
    """Points (n, 2), outward normals (n, 2) and sigma (n,) [px] of image contours along the border of a mask."""
    none = np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0)
    if len(contours.u) == 0 or not mask.any():
        return none
    each = np.split(contours.u, np.flatnonzero(np.diff(contours.contour)) + 1)
    u = np.concatenate([np.arange(float(part[0]), float(part[-1]) + 1e-9, STEP) for part in each])
    pixels, _, normals, _ = contours.splines.frame(u)
    distance, outward = _border(mask, pixels)
    agreement = np.sum(normals * outward, axis=1)
    keep = (np.abs(distance) < ASIDE) & (np.abs(agreement) > TURNED)
    height, width = mask.shape
    keep &= np.all((pixels > BORDER) & (pixels < np.array([width, height]) - 1 - BORDER), axis=1)
    normals = normals * np.sign(agreement)[:, None]
    return pixels[keep], normals[keep], contours.sigma_at(u)[keep]


def _border(mask: np.ndarray, pixels: Array) -> tuple[Array, Array]:
    """Distance (n,) [px] of pixels (n, 2) from the border of a mask, and its outward normals (n, 2) there."""
    field = signed_field(mask)
    smooth = cv2.GaussianBlur(field, (0, 0), 2.0)
    gradient = np.stack([cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1)])
    x, y = pixels.astype(np.float32).T
    at = [cv2.remap(a, x, y, cv2.INTER_LINEAR).ravel() for a in (field, *gradient)]
    outward = np.stack(at[1:], axis=1).astype(float)
    return at[0].astype(float), outward / np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-9)


def signed_field(mask: np.ndarray) -> np.ndarray:
    """Distance (height, width) [px] of pixel centres from the border of a mask, negative inside; float32."""
    inside = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    outside = cv2.distanceTransform(1 - mask.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return np.where(mask, 0.5 - inside, outside - 0.5).astype(np.float32)


def _tangent_planes(view: View, pixels: Array, normals: Array) -> tuple[Array, Array]:
    """Rays (n, 3) and the outward unit normals (n, 3) of the planes through them and the outline's tangents."""
    if len(pixels) == 0:
        return np.zeros((0, 3)), np.zeros((0, 3))
    tangents = np.stack([-normals[:, 1], normals[:, 0]], axis=1)
    ahead, behind = view.rays(pixels + 0.5 * tangents), view.rays(pixels - 0.5 * tangents)
    rays, beside = view.rays(pixels), view.rays(pixels + normals)
    planes = np.cross(behind, ahead)
    planes *= np.sign(np.sum(planes * (beside - rays), axis=1))[:, None]
    return rays, planes / np.linalg.norm(planes, axis=1, keepdims=True)
