"""The rendered board shows its corners where they are, and hidden or blurred ones are not called good."""

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from extremal.estimator import Camera
from extremal.estimator.board import Board
from extremal.estimator.corners import Corners, find_corners
from extremal.scenes import Scene
from extremal.scenes.scene import Background
from extremal.sim import FrameRenderer, Sensor, scene_model
from extremal.sim.board_motion import BoardMotion
from extremal.sim.board_place import upright_board

BOARD = Board()
CENTRE = (0.0, 0.0, 0.25)
VIEWS = 5
LENSES = {"pinhole": (0.0, 0.0, 0.0, 0.0, 0.0), "barrel": (-0.25, 0.1, 1e-3, -1e-3, 0.0)}


@pytest.fixture(scope="module", params=list(LENSES))
def frames(request: pytest.FixtureRequest) -> tuple[Camera, list[np.ndarray], list[np.ndarray]]:
    """The camera, light without noise (H, W) of a few views, and where all corners are."""
    placed = upright_board(BOARD, np.array(CENTRE))
    scene = Scene((placed,), background=Background((0.6, 0.6, 0.6)), target=CENTRE)
    camera = Camera(distortion=LENSES[request.param])
    poses = BoardMotion(views=VIEWS).poses(CENTRE, np.random.default_rng(0))
    with FrameRenderer(scene_model(scene.to_spec()), camera, "standard") as renderer:
        light = [renderer.render(poses[i]) for i in range(VIEWS)]
    to_camera: list[RigidTransform] = [poses[i].inv() * placed.T_world_object for i in range(VIEWS)]
    return camera, light, [camera.project(T.apply(BOARD.corners)) for T in to_camera]


def read(camera: Camera, light: np.ndarray) -> Corners:
    image = Sensor(noise=2.0).read(light, camera, np.random.default_rng(1))
    return find_corners(image, camera, BOARD)


def test_corners_are_unbiased_and_sigma_is_honest(
    frames: tuple[Camera, list[np.ndarray], list[np.ndarray]],
) -> None:
    camera, light, true = frames
    found = [read(camera, frame) for frame in light]
    off = np.concatenate([c.pixels - t[c.ids] for c, t in zip(found, true, strict=True)])
    covariance = np.concatenate([c.covariance for c in found])
    assert len(off) > 30 * VIEWS
    assert np.all(np.abs(off.mean(axis=0)) < 0.005)
    assert np.sqrt(np.mean(off**2)) < 0.02
    nees = np.einsum("ni,nij,nj->n", off, np.linalg.inv(covariance), off) / 2
    assert 0.5 < nees.mean() < 1.6


def test_what_is_hidden_or_blurred_is_dropped_or_less_certain(
    frames: tuple[Camera, list[np.ndarray], list[np.ndarray]],
) -> None:
    camera, light, true = frames
    hidden = light[0].copy()
    hidden[:, : camera.width // 2] = 90.0
    whole, half = read(camera, light[0]), read(camera, hidden)
    assert 0 < len(half) < len(whole)
    off = half.pixels - true[0][half.ids]
    sigma = np.sqrt(np.trace(half.covariance, axis1=1, axis2=2))
    assert np.all(np.linalg.norm(off, axis=1) < 5 * sigma)
    blurred = read(camera, cv2.GaussianBlur(light[0], (0, 0), 2.0))
    if len(blurred):
        off = np.linalg.norm(blurred.pixels - true[0][blurred.ids], axis=1)
        assert np.all(off < 5 * np.sqrt(np.trace(blurred.covariance, axis1=1, axis2=2)))
        assert np.median(np.trace(blurred.covariance, axis1=1, axis2=2)) > np.median(sigma**2)


def test_no_board_no_corners() -> None:
    grey = np.full((480, 640), 128, np.uint8)
    assert len(find_corners(grey, Camera(), BOARD)) == 0
