"""From exact meshes to MuJoCo bodies."""

import mujoco
import numpy as np
from scipy.spatial.transform import RigidTransform

from extremal.scenes.curves import Appearance, Piece


def add_pieces(
    spec: mujoco.MjSpec,
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
