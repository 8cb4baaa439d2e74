"""Random variations of a scene, for studies of accuracy."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from extremal.scenes.curves import Array
from extremal.scenes.lathe import Lathe
from extremal.scenes.scene import Light, Scene
from extremal.scenes.surface import Surface

SMALLEST, LARGEST = 0.025, 0.055  # radii [m] of random profiles


def randomised(scene: Scene, rng: np.random.Generator) -> Scene:
    """The scene with new smooth profiles for its lathes, its objects moved a little, and other lights.

    Lathes keep their markings, scaled with the height. Profiles stay within 25 to 55 mm. All objects but the
    table move by up to 4 mm and turn by up to 8 degrees about the vertical. Lights come from the camera's
    side (-x), from above, 60 degrees to either side.

    Args:
        scene: what to vary.
        rng: the only source of randomness.
    """
    objects = tuple(
        surface if surface.name == "table" else _moved(_reshaped(surface, rng), rng)
        for surface in scene.objects
    )
    return replace(scene, objects=objects, lights=_lights(scene.lights, rng))


def _reshaped(surface: Surface, rng: np.random.Generator) -> Surface:
    if not isinstance(surface, Lathe):
        return surface
    while True:
        height = surface.profile.height * rng.uniform(0.92, 1.08)
        z = np.linspace(0, height, 9)
        candidate = replace(
            surface,
            profile_z=tuple(z.tolist()),
            profile_r=tuple(_radii(z / height, rng).tolist()),
            markings=tuple(
                replace(m, bottom=m.bottom * scale, top=min(m.top * scale, height))
                for m in surface.markings
                for scale in [height / surface.profile.height]
            ),
        )
        if candidate.profile.smallest >= SMALLEST and candidate.profile.largest <= LARGEST:
            return candidate


def _radii(u: Array, rng: np.random.Generator) -> Array:
    """Mean radius with one and a half slow waves along 0 <= u <= 1 [m]."""
    waves = [
        amplitude * np.sin(2 * np.pi * frequency * u + rng.uniform(0, 2 * np.pi))
        for frequency, amplitude in (
            (0.5, rng.uniform(0, 0.005)),
            (1.0, rng.uniform(0.002, 0.006)),
            (1.5, rng.uniform(0, 0.003)),
        )
    ]
    return rng.uniform(0.037, 0.043) + np.sum(waves, axis=0)


def _moved(surface: Surface, rng: np.random.Generator) -> Surface:
    turn = Rotation.from_euler("z", rng.uniform(-8, 8), degrees=True)
    shift = np.append(rng.uniform(-0.004, 0.004, size=2), 0.0)
    pose = surface.T_world_object
    moved = RigidTransform.from_components(pose.translation + shift, turn * pose.rotation)
    return replace(surface, T_world_object=moved)


def _lights(lights: tuple[Light, ...], rng: np.random.Generator) -> tuple[Light, ...]:
    changed = []
    for light in lights:
        azimuth, elevation = np.radians(rng.uniform(-60, 60)), np.radians(rng.uniform(25, 60))
        direction = (
            float(np.cos(elevation) * np.cos(azimuth)),
            float(np.cos(elevation) * np.sin(azimuth)),
            float(-np.sin(elevation)),
        )
        diffuse = float(min(1.0, light.diffuse * rng.uniform(0.8, 1.15)))
        changed.append(replace(light, direction=direction, diffuse=diffuse))
    return tuple(changed)
