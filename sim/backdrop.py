"""A sky of one colour, drawn as a far wall: OpenGL samples a texture for every pixel of a sky box, which takes a third of a frame's time."""

# mujoco's compiled classes come without type stubs.
# pyright: reportAttributeAccessIssue=false

from dataclasses import dataclass
from typing import Self

import mujoco
import numpy as np
from numpy.typing import NDArray

EMISSION = (
    1e5  # a colour that shines by itself, so much brighter than lights could make it that these do not count
)
FARTHEST = 0.98  # of what is drawn at all
WIDER = 3.0  # than the view, so that its own edges are never in it


@dataclass(frozen=True, eq=False)
class Backdrop:
    """rgb: (3,) in 0..1; distance: [m] along the optical axis."""

    rgb: NDArray[np.floating]
    distance: float

    @classmethod
    def of(cls, model: mujoco.MjModel) -> Self | None:
        """In place of a model's sky box; None where it has none, or of several colours."""
        for i in np.flatnonzero(np.equal(model.tex_type, int(mujoco.mjtTexture.mjTEXTURE_SKYBOX)))[:1]:
            first, channels = model.tex_adr[i], model.tex_nchannel[i]
            size = model.tex_height[i] * model.tex_width[i] * channels
            texels = np.asarray(model.tex_data[first : first + size]).reshape(-1, channels)
            if channels == 3 and np.all(texels == texels[0]):
                return cls(texels[0] / 255, FARTHEST * model.vis.map.zfar * model.stat.extent)
        return None

    def add_to(
        self,
        scene: mujoco.MjvScene,
        position: NDArray[np.floating],
        rotation: NDArray[np.floating],
        view: tuple[float, float],
    ) -> None:
        """Add it to a scene with room for one more geom.

        Args:
            position: (3,), rotation: (9,) of the camera with MuJoCo's axes. view: width and height of the image, in focal lengths.
        """
        geom = scene.geoms[scene.ngeom]
        half = [WIDER * self.distance * side for side in view] + [1e-3 * self.distance]
        centre = position - self.distance * rotation.reshape(3, 3)[:, 2]
        colour = np.append(self.rgb / EMISSION, 1.0).astype(np.float32)
        mujoco.mjv_initGeom(geom, mujoco.mjtGeom.mjGEOM_BOX, half, centre, rotation, colour)
        geom.emission, geom.specular, geom.shininess, geom.reflectance = EMISSION, 0, 0, 0
        scene.ngeom += 1
