"""What a 3D view holds, read back from its serialised form, and meshes that are made coarse."""

import base64
import re
import socket
from typing import Any

import cv2
import msgspec
import numpy as np
import pytest
import trimesh
import zstandard
from scipy.spatial.transform import RigidTransform, Rotation

from extremal.estimator import Camera, InvalidInput
from extremal.scenes import load_scene
from extremal.scripts.report_mesh import DisplayMesh, coarse, object_meshes
from extremal.scripts.report_scene import CAMERA, EXTREMAL, FIXED, STEP, Scene3D, label_colours, small_image

TARGET, EYE = (0.0, 0.0, 0.1), (1.0, 0.0, 0.4)
IMAGES = [np.full((48, 64), value, np.uint8) for value in (50, 100, 150)]
POSES = RigidTransform.from_components(
    [[-0.1, 0, 0.2], [0, 0, 0.2], [0.1, 0, 0.2]], Rotation.from_rotvec([[0, 0, 0], [0.1, 0, 0], [0, 0.2, 0]])
)


class Played:
    """A page's messages (time [s], content), with arrays in place."""

    def __init__(self, page: str) -> None:
        (data,) = re.findall(r'__VISER_EMBED_DATA__="([^"]*)"', page)
        packed = base64.b64decode(data)
        raw = zstandard.ZstdDecompressor().decompress(packed[8:], int.from_bytes(packed[:8], "little"))
        end = 8 + int.from_bytes(raw[:8], "little")
        content = msgspec.msgpack.decode(raw[8:end])
        self.duration: float = content["durationSeconds"]
        self.messages: list[tuple[float, dict[str, Any]]] = content["messages"]

    def named(self, name: str) -> list[tuple[float, dict[str, Any]]]:
        return [(t, m) for t, m in self.messages if m.get("name") == name]


def test_parts_have_their_names_and_a_static_view_has_no_timeline() -> None:
    scene = Scene3D(TARGET, EYE).points("contours", np.zeros((3, 3)), EXTREMAL)
    scene.lines("way", [np.eye(3)], FIXED, visible=False)
    played = Played(scene.html())
    names = {m["name"] for _, m in played.messages if "name" in m}
    assert {"/contours", "/way"} <= names and played.duration == 0
    assert [m["visible"] for _, m in played.named("/way") if "visible" in m] == [False]


def test_the_camera_goes_along_its_path_on_the_timeline() -> None:
    played = Played(Scene3D(TARGET, EYE).cameras(Camera(), POSES, IMAGES).html())
    assert played.duration == pytest.approx(3 * STEP)
    frustums = {m["name"] for _, m in played.messages if str(m.get("name", "")).startswith("/cameras/views/")}
    assert len(frustums) == 3
    moves = [(t, m["position"]) for t, m in played.named("/cameras/now") if "position" in m]
    for i, position in enumerate(POSES.translation):
        at = [p for t, p in moves if t == pytest.approx(i * STEP)]
        np.testing.assert_allclose(at[-1], position, atol=1e-9)
    turns = [m["wxyz"] for _, m in played.named("/cameras/now") if "wxyz" in m]
    np.testing.assert_allclose(turns[-1], POSES[2].rotation.as_quat(scalar_first=True), atol=1e-9)


def test_points_that_are_not_finite_are_left_out() -> None:
    points = np.array([[0, 0, 0], [np.nan, 0, 0], [0, np.inf, 0.0]])
    with_one = Scene3D(TARGET, EYE).points("contours", points, label_colours(np.array([True, False, True])))
    assert Played(with_one.html()).named("/contours")
    assert not Played(Scene3D(TARGET, EYE).points("contours", points[1:], FIXED).html()).named("/contours")


def test_the_server_listens_on_the_loopback_interface_alone_and_only_meanwhile(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    bound: list[Any] = []
    bind = socket.socket.bind

    def watched(self: socket.socket, address: Any) -> None:
        bind(self, address)
        bound.append(self.getsockname())

    monkeypatch.setattr(socket.socket, "bind", watched)
    Scene3D(TARGET, EYE).points("contours", np.zeros((1, 3)), FIXED).html()
    assert bound and all(host == "127.0.0.1" for host, _ in bound)
    for address in bound:
        with socket.socket() as client:
            assert client.connect_ex(address) != 0
    assert capsys.readouterr().out == ""


def test_the_same_view_is_the_same_text() -> None:
    pages = [Scene3D(TARGET, EYE).cameras(Camera(), POSES, IMAGES).html() for _ in range(2)]
    assert pages[0] == pages[1]


def test_bad_values_are_refused() -> None:
    with pytest.raises(InvalidInput, match="accepted: two points"):
        Scene3D(TARGET, TARGET)
    with pytest.raises(InvalidInput, match="2 images are given for 3 views"):
        Scene3D(TARGET, EYE).cameras(Camera(), POSES, IMAGES[:2])
    with pytest.raises(InvalidInput, match="accepted: finite"):
        DisplayMesh(np.full((3, 3), np.nan), np.array([[0, 1, 2]]), np.zeros((3, 3), np.uint8))
    with pytest.raises(InvalidInput, match="accepted: 0 to 2"):
        DisplayMesh(np.zeros((3, 3)), np.array([[0, 1, 3]]), np.zeros((3, 3), np.uint8))
    with pytest.raises(InvalidInput, match="uint8"):
        DisplayMesh(np.zeros((3, 3)), np.array([[0, 1, 2]]), np.zeros((3, 3)))  # pyright: ignore[reportArgumentType]


def test_the_onlooker_sees_path_and_target_from_the_side() -> None:
    for centres in (POSES.translation - [0.6, 0, 0], np.array([[0, 0, 0.7], [0.1, 0, 0.7]])):
        scene = Scene3D.beside(TARGET, centres)
        forward = scene._target - scene._eye
        for point in (np.array(TARGET), centres.mean(axis=0)):
            to_point = point - scene._eye
            cosine = forward @ to_point / np.linalg.norm(forward) / np.linalg.norm(to_point)
            assert 0.9 < cosine < 0.9999


def test_a_coarse_sphere_is_a_sphere_still() -> None:
    ball = trimesh.creation.icosphere(subdivisions=6, radius=0.1)
    colours = np.where(ball.vertices[:, 2:] > 0, EXTREMAL, FIXED).astype(np.uint8)
    fine = DisplayMesh(np.array(ball.vertices), np.array(ball.faces), colours)
    found = coarse(fine, cells=30, most=1000)
    assert 1000 < len(found.faces) < 12_000
    shown = trimesh.Trimesh(found.vertices, found.faces, process=False)
    cell = 0.2 / 30
    assert np.abs(np.linalg.norm(found.vertices, axis=1) - 0.1).max() < cell
    assert shown.volume == pytest.approx(ball.volume, rel=0.05)  # faces keep their side
    top = found.vertices[:, 2] > cell
    assert np.all(found.colours[top] == EXTREMAL)
    assert coarse(fine, most=len(fine.faces)) is fine


def test_objects_are_where_the_scene_has_them() -> None:
    scene = load_scene("vase-and-box")
    meshes = dict(object_meshes(scene))
    assert set(meshes) == {surface.name for surface in scene.objects}
    for surface in scene.objects:
        vertices = meshes[surface.name].vertices
        assert np.abs(surface.signed_distance(vertices[:: max(1, len(vertices) // 500)])).max() < 1e-5


def test_images_are_shrunk_and_coloured() -> None:
    grey = np.tile(np.arange(0, 256, 0.4, dtype=float).astype(np.uint8), (480, 1))
    small = small_image(grey)
    assert small.shape == (240, 320, 3)
    np.testing.assert_allclose(small.mean(), grey.mean(), atol=1)
    assert small_image(small) is small
    assert cv2.cvtColor(small, cv2.COLOR_RGB2GRAY).std() > 50 and CAMERA != FIXED
