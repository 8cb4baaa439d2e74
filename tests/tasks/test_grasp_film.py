"""Films of a grasp show the arm and what it lifts."""

import numpy as np
from scipy.spatial.transform import RigidTransform

from extremal.scenes import Lathe
from extremal.tasks.grasp_film import HEIGHT, WIDTH, pictures
from extremal.tasks.grasp_motion import T_TABLE_BASE, CupKinematics, cup_facing
from extremal.tasks.grasp_world import GraspWorld


def test_a_film_shows_what_moves_and_leaves_the_world_alone() -> None:
    vase = Lathe([0.0, 0.1, 0.2], [0.04, 0.05, 0.04], name="vase")
    arm = CupKinematics(T_TABLE_BASE)
    azimuth = np.radians(220)
    normal = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    before = cup_facing((0.12 * normal + [0, 0, 0.1])[None], normal[None])[0]
    start = arm.joint_positions(RigidTransform.concatenate([before]))[0]
    world = GraspWorld(vase, arm, start)
    world.hold(0.35)
    before_film = world.joint_positions
    film = list(world.film())
    assert len(film) == 1 + 3 and {picture.shape for picture in film} == {(HEIGHT, 2 * WIDTH, 3)}
    assert np.array_equal(world.joint_positions, before_film) and world.time > 0.34
    blue = film[0].astype(int)[..., 2] - film[0].astype(int)[..., 0] > 30
    assert all(half.sum() > 500 for half in np.hsplit(blue, 2))  # the vase is in both views
    aside = start + np.array([0.3, 0, 0, 0, 0, 0])
    moved, still = (
        next(pictures(world._model, [np.concatenate([q, world._film[0][6:]])])) for q in (aside, start)
    )
    assert np.mean(np.any(moved != still, axis=-1)) > 0.01  # and the arm
