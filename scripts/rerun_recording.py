"""Recordings for the Rerun viewer, as files: nothing is sent, no port is opened, no viewer is started."""

from importlib.util import find_spec
from pathlib import Path

import numpy as np

from extremal.estimator import InvalidInput
from extremal.scenes import Scene
from extremal.scripts.look_result import Look
from extremal.scripts.report_mesh import coarse, object_meshes
from extremal.scripts.report_scene import label_colours

QUALITY = 85  # of JPEG


def require_rerun() -> None:
    """Raise InvalidInput where the extra is not installed."""
    if find_spec("rerun") is None:
        raise InvalidInput(
            "--rerun needs Rerun's SDK, which is not installed; accepted: without --rerun, or first: pip install 'rerun-sdk>=0.41'"
        )


def write_rerun(path: Path, scene: Scene, look: Look) -> None:
    """Write a look (.rrd): true objects, contour points, and the views with their images on a timeline "view"."""
    import rerun as rr  # pyright: ignore[reportMissingImports]

    shape, views = look.shape, look.recording.views
    stream = rr.RecordingStream("extremal")
    stream.save(path)
    for name, mesh in object_meshes(scene):
        shown = coarse(mesh)
        solid = rr.Mesh3D(
            vertex_positions=shown.vertices, triangle_indices=shown.faces, vertex_colors=shown.colours
        )
        stream.log(f"world/truth/{name}", solid, static=True)
    known = np.isfinite(shape.position).all(axis=1)
    colours = label_colours(shape.extremal[known])
    points = rr.Points3D(shape.position[known], colors=colours, radii=0.001)
    stream.log("world/contours", points, static=True)
    for i, view in enumerate(views):
        pose, camera = shape.T_world_camera[i], view.camera
        stream.set_time("view", sequence=i)
        placed = rr.Transform3D(translation=pose.translation, quaternion=pose.rotation.as_quat())
        lens = rr.Pinhole(
            resolution=[camera.width, camera.height],
            focal_length=[camera.fx, camera.fy],
            principal_point=[camera.cx, camera.cy],
            camera_xyz=rr.ViewCoordinates.RDF,
        )
        stream.log("world/camera", placed)
        stream.log("world/camera/image", lens, rr.Image(view.image).compress(jpeg_quality=QUALITY))
    stream.flush()
    stream.disconnect()
