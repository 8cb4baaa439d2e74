"""Where the board stands in a look: low in every frame, clear of all objects; a clear error where there is no room."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from extremal.estimator import Camera, InvalidInput
from extremal.scenes import Box, load_scene, randomised
from extremal.sim import LinearMotion
from extremal.sim.board_place import board_in_view


@pytest.mark.parametrize("motion", [LinearMotion(), LinearMotion(views=3, baseline=0.1, distance=0.5)])
@pytest.mark.parametrize("seed", range(3))
def test_all_views_show_it(motion: LinearMotion, seed: int) -> None:
    scene, camera = randomised(load_scene("vase-and-box"), np.random.default_rng(seed)), Camera()
    poses = motion.poses(scene.target, np.random.default_rng(seed))
    placed = board_in_view(scene, camera, poses)
    corners = placed.T_world_object.apply(placed.board.corners)
    for surface in scene.objects:
        assert np.all(surface.signed_distance(corners) > 0)
    for i in range(len(poses)):
        pixels = camera.project(poses[i].inv().apply(corners))
        seen = np.all((pixels > 0) & (pixels < [camera.width, camera.height]), axis=1)
        assert seen.mean() > 0.6


def test_no_room_is_said() -> None:
    scene = load_scene("vase-and-box")
    motion = LinearMotion()
    poses = motion.poses(scene.target, np.random.default_rng(0))
    middle = poses[len(poses) // 2].translation
    pose = RigidTransform.from_translation((np.asarray(scene.target) + middle) / 2 - [0, 0, 0.2])
    wall = Box((0.5, 0.9, 0.3), name="wall", T_world_object=pose)
    with pytest.raises(InvalidInput, match=r"no room for a board.*accepted:.*--egomotion robot"):
        board_in_view(replace(scene, objects=(*scene.objects, wall)), Camera(), poses)
