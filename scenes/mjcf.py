"""From exact meshes, lights and sky to MuJoCo's model."""

# mujoco's compiled classes come without type stubs.
# pyright: reportAttributeAccessIssue=false

from collections.abc import Sequence
from typing import TypeAlias

import mujoco
import numpy as np
from scipy.spatial.transform import RigidTransform

from extremal.scenes.curves import Appearance, Piece

Spec: TypeAlias = "mujoco.MjSpec"


def empty_world(name: str, sky: Sequence[float]) -> Spec:
    """A model with nothing but a sky of one colour: no headlight, no shadows, no floor."""
    spec = mujoco.MjSpec()
    spec.modelname = name
    spec.visual.headlight.active = 0
    spec.visual.quality.shadowsize = 0
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT,
        rgb1=sky,
        rgb2=sky,
        width=16,
        height=96,
    )
    return spec


def add_light(
    spec: Spec, name: str, direction: Sequence[float], diffuse: float, ambient: float, specular: float
) -> None:
    """Add a white directional light that casts no shadows."""
    spec.worldbody.add_light(
        name=name,
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        dir=np.array(direction) / np.linalg.norm(direction),
        diffuse=[diffuse] * 3,
        ambient=[ambient] * 3,
        specular=[specular] * 3,
        castshadow=False,
    )


def add_pieces(
    spec: Spec,
    name: str,
    T_world_object: RigidTransform,
    appearance: Appearance,
    pieces: list[Piece],
) -> None:
    """Add a fixed body called `name`, with a mesh, a material and a visual geom for every piece.

    Faces and normals are given, so MuJoCo neither draws hulls nor smooths; "shell" inertia accepts open pieces.
    MuJoCo moves each mesh into its own inertia frame and moves the geom back: what is drawn stays in place.
    """
    quat = T_world_object.rotation.as_quat(scalar_first=True)
    body = spec.worldbody.add_body(name=name, pos=T_world_object.translation, quat=quat)
    for i, piece in enumerate(pieces):
        part = f"{name}/{i}"
        spec.add_mesh(
            name=part,
            uservert=piece.vertices.astype(np.float32).ravel(),
            usernormal=piece.normals.astype(np.float32).ravel(),
            userface=piece.faces.astype(np.int32).ravel(),
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
        )
        spec.add_material(
            name=part,
            rgba=piece.rgba,
            specular=appearance.specular,
            shininess=appearance.shininess,
        )
        body.add_geom(
            name=part,
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=part,
            material=part,
            contype=0,
            conaffinity=0,
        )
