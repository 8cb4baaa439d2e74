"""What a grasp looked like: pictures of the arm and what it lifts, of positions that physics went through."""

from collections.abc import Iterator, Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from extremal.estimator.camera import Array
from extremal.estimator.errors import InvalidInput
from extremal.sim.arm import ARM_GROUP
from extremal.sim.gl import select_backend
from extremal.tasks.grasp_model import OBSTACLES, TARGET

WIDTH, HEIGHT = 640, 480  # [px] of each of two views side by side
SHADOWS = 1024  # [px] sides of the shadow map; by default it takes 100 MB
VIEWS = (
    (135.0, -25.0, 1.3, 0.22),
    (180.0, -12.0, 0.75, 0.14),
)  # azimuth, elevation [deg], distance, height [m]
TABLE_COLOUR, TARGET_COLOUR, OTHER_COLOUR = (0.9, 0.89, 0.86, 1), (0.3, 0.5, 0.7, 1), (0.8, 0.65, 0.45, 1)


def pictures(model: mujoco.MjModel, positions: Sequence[Array]) -> Iterator[NDArray[np.uint8]]:
    """Pictures (HEIGHT, 2 WIDTH, 3) of a `grasp_model` at positions (nq,): the whole arm, and the cup from near.

    Raises:
        RenderingError: offscreen rendering is not available.
        InvalidInput: positions that are not finite.
    """
    select_backend()
    data, option = mujoco.MjData(model), mujoco.MjvOption()
    option.geomgroup[ARM_GROUP] = 1
    model.vis.global_.offwidth, model.vis.global_.offheight = WIDTH, HEIGHT
    model.vis.quality.shadowsize = SHADOWS
    model.vis.headlight.ambient, model.vis.headlight.diffuse = [0.45] * 3, [0.5] * 3
    _paint(model)
    with mujoco.Renderer(model, HEIGHT, WIDTH, max_geom=model.ngeom + 10) as renderer:
        for qpos in positions:
            if not np.isfinite(qpos).all():  # MuJoCo would go on with them
                raise InvalidInput(
                    f"positions of a picture are {np.asarray(qpos).tolist()}; accepted: finite numbers"
                )
            data.qpos[:] = qpos
            mujoco.mj_forward(model, data)
            seen = []
            for camera in _cameras():
                renderer.update_scene(data, camera, option)
                seen.append(renderer.render().copy())
            yield np.hstack(seen)


def _cameras() -> Iterator[mujoco.MjvCamera]:
    for azimuth, elevation, distance, height in VIEWS:
        camera = mujoco.MjvCamera()
        camera.azimuth, camera.elevation, camera.distance = azimuth, elevation, distance
        camera.lookat[:] = 0, 0, height
        yield camera


def _paint(model: mujoco.MjModel) -> None:
    """Colours by what a geom belongs to: collision shapes have none of their own."""
    for geom, body in enumerate(model.geom_bodyid):
        name = model.body(int(body)).name
        if name == TARGET:
            model.geom_rgba[geom] = TARGET_COLOUR
        elif name.startswith(OBSTACLES):
            model.geom_rgba[geom] = OTHER_COLOUR
        elif body == 0:
            model.geom_rgba[geom] = TABLE_COLOUR
