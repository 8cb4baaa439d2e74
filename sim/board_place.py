"""Where a board stands while the camera looks at something else: low in every frame, in front of all objects."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from extremal.estimator.board import Board
from extremal.estimator.camera import Array, Camera
from extremal.estimator.errors import InvalidInput
from extremal.scenes import Scene
from extremal.scenes.board import CalibrationBoard

# A wide strip, tilted back: wide, to tell a turn of the camera from a step aside; tilted, for the depth that it gains.
# Squares of 20 mm at 0.6 m are 27 px wide. Four rows of them in the lowest fifth of the frame leave the object alone.
LOOK_BOARD = Board(columns=18, rows=4, square=0.02, marker=0.015, dictionary="DICT_4X4_100")
DESIGN_DISTANCE = 0.6  # [m] of LOOK_BOARD from the target; boards of other distances are scaled
TILT = np.radians(55)
ROW = 0.91  # of the image's height, at which its centre appears in the middle view
NEARNESS = (
    0.82,
    0.76,
    0.7,
    0.64,
    0.58,
    0.52,
    0.46,
    0.4,
)  # its distance, of the target's: the first with room
ROOM = 0.004  # [m] between the board and every object

# Board axes of an upright board that faces a camera looking along world x: x to the right, y down, z away from it.
UPRIGHT = Rotation.from_matrix([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])


def upright_board(board: Board, centre: Array) -> CalibrationBoard:
    """A board with its centre at a point (3,) of the world, facing -x: to calibrate by."""
    return _standing(board, UPRIGHT, centre)


def board_in_view(scene: Scene, camera: Camera, T_world_camera: RigidTransform) -> CalibrationBoard:
    """A board low in the frames of cameras (V) that fixate the scene's target, clear of all objects.

    Raises:
        InvalidInput: there is no room for it.
    """
    middle = T_world_camera[len(T_world_camera) // 2]
    distance = float(np.linalg.norm(middle.translation - scene.target))
    pixel = [camera.cx, ROW * camera.height]
    ray = middle.rotation.apply(camera.rays(pixel))
    heading = Rotation.from_rotvec([0, 0, np.arctan2(ray[1], ray[0])])
    rotation = heading * UPRIGHT * Rotation.from_rotvec([-TILT, 0, 0])
    for nearness in NEARNESS:
        scale = nearness / NEARNESS[0] * distance / DESIGN_DISTANCE
        board = replace(LOOK_BOARD, square=scale * LOOK_BOARD.square, marker=scale * LOOK_BOARD.marker)
        placed = _standing(board, rotation, middle.translation + nearness * distance * ray)
        if _clear(scene, placed):
            return placed
    raise InvalidInput(
        f"there is no room for a board in front of {scene.name!r} seen from {np.round(middle.translation, 3).tolist()} m; accepted: "
        "scenes that leave the space in the lowest fifth of the frame free, or --egomotion robot"
    )


def _standing(board: Board, rotation: Rotation, centre: Array) -> CalibrationBoard:
    middle = np.append(np.asarray(board.size) / 2, 0.0)
    return CalibrationBoard(
        name="board",
        T_world_object=RigidTransform.from_components(np.asarray(centre) - rotation.apply(middle), rotation),
        board=board,
    )


def _clear(scene: Scene, placed: CalibrationBoard) -> bool:
    u = np.linspace(-0.05, 1.05, 45)
    x, y = np.meshgrid(u * placed.board.size[0], u * placed.board.size[1])
    points = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    world = placed.T_world_object.apply(points)
    return all(np.all(surface.signed_distance(world) > ROOM) for surface in scene.objects)
