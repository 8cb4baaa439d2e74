"""The 3D view of a report: points, lines, meshes and a camera on its way, as one page that needs no network.

viser's client draws it (WebGL); its scene serializer puts everything, the client included, into one HTML document.
"""

import io
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from typing import Any

import cv2
import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import RigidTransform

from extremal.estimator import Camera, InvalidInput
from extremal.estimator.camera import Array
from extremal.scenes import Scene
from extremal.scripts.report_mesh import DisplayMesh, coarse, object_meshes

LOOPBACK = "127.0.0.1"
STEP = 0.4  # [s] of the timeline for which a view is shown
IMAGE_WIDTH, IMAGE_QUALITY = 320, 80  # [px], of JPEG
MOST_VIEWS = 60  # of a timeline; of a longer path views are left out evenly
FIELD = 0.6  # [rad] of the onlooker's view
PATH, CAMERA = (128, 138, 155), (230, 60, 60)  # colours
EXTREMAL, FIXED = (40, 150, 255), (255, 127, 14)
SCREEN: dict[str, Any] = {"thickness": 1.5, "thickness_units": "screen"}
DARK = "window.__VISER_EMBED_CONFIG__.darkMode=matchMedia('(prefers-color-scheme: dark)').matches"


class Scene3D:
    """What a 3D view shows. Methods that add something return the view, so that calls can be chained.

    Names are paths such as "truth/vase": a reader switches branches of their tree on and off.
    """

    def __init__(self, target: ArrayLike, eye: ArrayLike) -> None:
        """
        Args:
            target, eye: (3,) [m] what the onlooker looks at first, and from where; the world's z axis is up.
        """
        self._target, self._eye = np.array(target, float), np.array(eye, float)
        if self._target.shape != (3,) or self._eye.shape != (3,) or np.allclose(self._target, self._eye):
            raise InvalidInput(f"target is {target!r}, eye {eye!r}; accepted: two points (3,) that differ")
        self._parts: list[Callable[[Any], object]] = []  # each adds something to viser's scene
        self._run: Callable[[Any, Any], None] | None = None  # plays the timeline

    @classmethod
    def beside(cls, target: ArrayLike, centres: ArrayLike) -> "Scene3D":
        """A view from the side on a target (3,) and the camera's path (V, 3) before it [m]."""
        path, aim = np.asarray(centres, float), np.asarray(target, float)
        middle = path.mean(axis=0)
        spread = float(np.linalg.norm(path - middle, axis=1).max())
        back = middle - aim
        reach = max(float(np.linalg.norm(back)), 3 * spread, 0.1)  # a scale of what is to be seen
        side = np.cross([0.0, 0.0, 1.0], back / reach)
        length = float(np.linalg.norm(side))
        side = side / length if length > 0.1 else np.array([1.0, 0.0, 0.0])  # the path is above the target
        away = back / max(float(np.linalg.norm(back)), 1e-6)
        looked_at = aim + 0.38 * back
        return cls(looked_at, looked_at + reach * (1.15 * away + 1.3 * side + [0, 0, 0.75]))

    def points(
        self, name: str, positions: ArrayLike, colours: ArrayLike, size: float = 0.0025, visible: bool = True
    ) -> "Scene3D":
        """Add points (n, 3) [m] of colours (n, 3) or (3,) in 0-255; those that are not finite are left out."""
        every = np.asarray(positions, float).reshape(-1, 3)
        known = np.isfinite(every).all(axis=1)
        shown = every[known].astype(np.float32)
        painted = np.broadcast_to(np.asarray(colours, np.uint8), every.shape)[known]
        looks: dict[str, Any] = {
            "point_size": size,
            "point_shape": "circle",
            "point_shading": "flat",
            "precision": "float32",
        }
        if len(shown):
            self._parts.append(
                lambda scene: scene.add_point_cloud(f"/{name}", shown, painted, visible=visible, **looks)
            )
        return self

    def lines(
        self, name: str, polylines: Sequence[ArrayLike], colour: tuple[int, int, int], visible: bool = True
    ) -> "Scene3D":
        """Add polylines (n, 3) [m] of one colour."""
        curves = [np.asarray(line, np.float32) for line in polylines]
        pairs = [np.stack([line[:-1], line[1:]], axis=1) for line in curves if len(line) > 1]
        if pairs:
            segments = np.concatenate(pairs)
            self._parts.append(
                lambda scene: scene.add_line_segments(f"/{name}", segments, colour, visible=visible, **SCREEN)
            )
        return self

    def mesh(
        self, name: str, mesh: DisplayMesh, opacity: float | None = None, visible: bool = True
    ) -> "Scene3D":
        """Add a mesh, made coarse where it is fine. With an opacity (0 to 1) it has one colour, the mean."""
        shown = coarse(mesh)
        if opacity is None:
            coloured = trimesh.Trimesh(
                shown.vertices, shown.faces, vertex_colors=_opaque(shown.colours), process=False
            )
            self._parts.append(lambda scene: scene.add_mesh_trimesh(f"/{name}", coloured, visible=visible))
            return self
        colour = tuple(int(c) for c in shown.colours.mean(axis=0))
        looks: dict[str, Any] = {"color": colour, "opacity": opacity, "side": "double", "visible": visible}
        vertices, faces = shown.vertices.astype(np.float32), shown.faces.astype(np.uint32)
        self._parts.append(lambda scene: scene.add_mesh_simple(f"/{name}", vertices, faces, **looks))
        return self

    def objects(self, scene: Scene, opacity: float | None = 0.3, visible: bool = True) -> "Scene3D":
        """Add the objects of a scene as they really are, under "truth"."""
        for name, mesh in object_meshes(scene):
            self.mesh(f"truth/{name}", mesh, opacity, visible)
        return self

    def cameras(
        self,
        camera: Camera,
        T_world_camera: RigidTransform,
        images: Sequence[NDArray[np.uint8]] = (),
        step: float = STEP,
    ) -> "Scene3D":
        """Add a camera's path with a frustum a view, and a timeline on which the camera goes along it.

        Args:
            T_world_camera: poses (V) of the views, in order.
            images: (V) frames, grey or RGB; none: the frustums stay empty.
            step: [s] for which a view is shown.
        """
        views = len(T_world_camera)
        if len(images) not in (0, views):
            raise InvalidInput(
                f"{len(images)} images are given for {views} views; accepted: none, or {views}"
            )
        at = np.linspace(0, views - 1, min(views, MOST_VIEWS)).round().astype(int)
        poses = [_placed(T_world_camera[int(i)]) for i in at]
        small = [small_image(images[i]) for i in at] if len(images) else []
        size = 0.15 * float(np.linalg.norm(self._target - T_world_camera.translation.mean(axis=0)))
        fov = 2 * float(np.arctan2(camera.height / 2, camera.fy))
        lens: dict[str, Any] = {"fov": fov, "aspect": camera.width / camera.height, **SCREEN}
        self.lines("cameras/path", [T_world_camera.translation], PATH)

        def frustums(scene: Any) -> None:
            for i, pose in zip(at, poses, strict=True):
                name = f"/cameras/views/{i:03d}"
                scene.add_camera_frustum(name, **lens, scale=0.25 * size, color=PATH, **pose)

        def run(server: Any, timeline: Any) -> None:
            moving = {"scale": size, "color": CAMERA, "format": "jpeg", "jpeg_quality": IMAGE_QUALITY}
            image = small[0] if small else None
            now = server.scene.add_camera_frustum("/cameras/now", **lens, **moving, image=image, **poses[0])
            for i, pose in enumerate(poses):
                now.wxyz, now.position = pose["wxyz"], pose["position"]
                if small and i:
                    now.image = small[i]
                timeline.insert_sleep(step)

        self._parts.append(frustums)
        self._run = run
        return self

    def html(self) -> str:
        """The whole as one HTML document, in the reader's dark or light theme."""
        with _server() as server:
            server.initial_camera.position, server.initial_camera.look_at = self._eye, self._target
            server.initial_camera.fov = FIELD
            server.scene.configure_default_lights(cast_shadow=False)
            for add in self._parts:
                add(server.scene)
            serializer = server.get_scene_serializer()
            if self._run:
                self._run(server, serializer)
            page: str = serializer.as_html()
        return page.replace("</head>", f"<script>{DARK}</script></head>", 1)


@contextmanager
def _server() -> Iterator[Any]:
    """A viser server while a scene is written: at a free port of the loopback interface, which nobody is told."""
    import viser  # takes a second, which only a report should pay

    with redirect_stdout(io.StringIO()):  # it announces its start and its end
        server = viser.ViserServer(host=LOOPBACK, port=0, verbose=False)
        try:
            yield server
        finally:
            server.stop()


def label_colours(extremal: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Colours (n, 3) of points by their labels (n,)."""
    return np.where(np.asarray(extremal, bool)[:, None], EXTREMAL, FIXED).astype(np.uint8)


def _placed(pose: RigidTransform) -> dict[str, Array]:
    return {"wxyz": pose.rotation.as_quat(scalar_first=True), "position": pose.translation}


def _opaque(colours: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return np.column_stack([colours, np.full(len(colours), 255, np.uint8)])


def small_image(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """A frame (height, width) or (height, width, 3) as RGB, at most IMAGE_WIDTH wide."""
    height, width = image.shape[:2]
    if width > IMAGE_WIDTH:
        size = (IMAGE_WIDTH, max(1, round(height * IMAGE_WIDTH / width)))
        image = cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(np.uint8)
    return np.repeat(image[:, :, None], 3, axis=2) if image.ndim == 2 else image
