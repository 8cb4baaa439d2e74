"""What is commonly done with such frames: dense stereo (OpenCV's semi-global matching) between neighbouring views."""

from collections.abc import Callable, Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike

from extremal.estimator.camera import Array, View
from extremal.estimator.silhouette import Outline

BLOCK = 5  # [px] window of the matching cost
STEP = 16  # disparities come in multiples of that
SLACK = 8  # [px] of disparity beyond what the object needs
EVERY = 3  # pixels from one point that is kept to the next


def stereo_points(
    outlines: Sequence[Outline], low: Array, high: Array, progress: Callable[[int, int], None] | None = None
) -> Array:
    """Points (n, 3) [m] by stereo between each view and the next, the last and the first included, within silhouettes.

    Args:
        low, high: corners (3,) [m] of a box around the object; it limits disparities.
        progress: called with (pairs done, pairs in all).
    """
    clouds = []
    for i, outline in enumerate(outlines):
        clouds.append(_pair(outline, outlines[(i + 1) % len(outlines)], low, high))
        if progress:
            progress(i + 1, len(outlines))
    return np.concatenate(clouds)


def _pair(first: Outline, second: Outline, low: Array, high: Array) -> Array:
    """Points (n, 3) [m] of one pair of views."""
    T = second.view.T_world_camera.inv() * first.view.T_world_camera
    if T.translation[0] > 0:  # the second camera stands to the left
        first, second, T = second, first, T.inv()
    view, other = first.view, second.view
    size = (view.camera.width, view.camera.height)
    lens = [np.array(v.camera.distortion) for v in (view, other)]
    R1, R2, P1, P2, Q, *_ = cv2.stereoRectify(
        view.camera.matrix, lens[0], other.camera.matrix, lens[1], size, T.rotation.as_matrix(), T.translation[:, None], alpha=-1
    )  # fmt: skip
    if abs(P2[0, 3]) < abs(P2[1, 3]) or P2[0, 3] >= 0:  # one camera above the other
        return np.zeros((0, 3))
    images, masks = [], []
    for outline, R, P in ((first, R1, P1), (second, R2, P2)):
        camera = outline.view.camera
        maps = cv2.initUndistortRectifyMap(
            camera.matrix, np.array(camera.distortion), R, P, size, cv2.CV_32FC1
        )
        grey = camera.encode(camera.linear(outline.view.image))
        images.append(cv2.remap(grey, *maps, cv2.INTER_LINEAR))
        masks.append(cv2.remap(outline.mask.astype(np.uint8), *maps, cv2.INTER_NEAREST))
    least, count = _disparities(view, R1, P1, P2, low, high)
    if least + count + BLOCK > view.camera.width // 2:  # too far apart to look alike
        return np.zeros((0, 3))
    disparity = _matcher(least, count).compute(*images).astype(np.float32) / 16
    points = cv2.reprojectImageTo3D(disparity, Q)[::EVERY, ::EVERY]
    good = (disparity > least)[::EVERY, ::EVERY] & (masks[0] > 0)[::EVERY, ::EVERY]
    good &= np.isfinite(points).all(axis=2)
    world = view.T_world_camera.apply(points[good].astype(float) @ R1)
    return world[np.all((world > low) & (world < high), axis=1)]


def _disparities(
    view: View, R1: ArrayLike, P1: ArrayLike, P2: ArrayLike, low: Array, high: Array
) -> tuple[int, int]:
    """Lowest disparity and number of disparities (a multiple of STEP) [px] of a box."""
    first, second = np.asarray(P1, float), np.asarray(P2, float)
    corners = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T
    depth = (view.T_world_camera.inv().apply(corners) @ np.asarray(R1, float).T)[:, 2]
    depth = np.maximum(depth, 0.05)
    values = -second[0, 3] / depth + first[0, 2] - second[0, 2]
    least = int(np.floor(values.min())) - SLACK
    return least, STEP * int(np.ceil((values.max() + SLACK - least) / STEP))


def _matcher(least: int, count: int) -> Any:
    """OpenCV's matcher with the penalties that its documentation recommends."""
    return cv2.StereoSGBM_create(  # pyright: ignore[reportAttributeAccessIssue]
        minDisparity=least,
        numDisparities=count,
        blockSize=BLOCK,
        P1=8 * BLOCK**2,
        P2=32 * BLOCK**2,
        disp12MaxDiff=1,
        uniquenessRatio=10,
        speckleWindowSize=100,
        speckleRange=2,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )
