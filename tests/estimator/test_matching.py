"""Which edgel is near a pixel, what is beside it, and which matches continue their tracks."""

from dataclasses import replace

import numpy as np
import pytest
from exact_contours import cameras, exact_contours
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from extremal.estimator import Contours, View
from extremal.estimator.continuity import CONFIRMED, LEAST_MATCHES, Continuity, begun, shared_error
from extremal.estimator.matching import BESIDE, Crossings, EdgelMap
from extremal.estimator.poses import pose_exp
from extremal.estimator.splines import arc_length, fit, knots
from extremal.scenes import load_scene

POSE = 2e-3  # [m], [rad]


@pytest.mark.parametrize("reach", [4, 14])
def test_edgels_near_pixels(reach: int) -> None:
    view = cameras(3)[1]
    contours = exact_contours(load_scene("sphere")["sphere"], view)
    edgels = EdgelMap(contours, view.camera.width, view.camera.height, reach)
    rng = np.random.default_rng(0)
    pixels = rng.uniform(-20, 1.05 * max(view.camera.width, view.camera.height), (3000, 2))
    pixels[::2] = rng.choice(contours.positions, 1500) + rng.uniform(-15, 15, (1500, 2))
    pixels[7] = np.nan
    found = edgels.lookup(pixels)
    np.testing.assert_array_equal(found, edgels.lookup_few(pixels))
    # an edgel stands for 2.5 px of its contour to each side, and pixels are rounded
    distance = np.nan_to_num(KDTree(contours.positions).query(np.nan_to_num(pixels, nan=1e3))[0], posinf=1e3)
    assert np.all(found[distance > reach + 2.5 + 1.5] == -1)
    size = (view.camera.width - 1, view.camera.height - 1)
    inside = np.all((pixels > 0) & (pixels < size), axis=1)
    assert np.all(found[inside & (distance < reach - 1.5)] >= 0)


@pytest.mark.parametrize("gap", [4.0, 12.0])
def test_what_is_beside_a_contour(gap: float) -> None:
    """Two straight contours, side by side, of which one ends half-way: a gap along it is no other contour."""
    view = cameras(3)[1]
    along = np.arange(2.5, 200, 5.0)
    parts = [(along, 0.0), (along[:19], gap), (along[20:], 40.0), (along[:19], 40.0)]
    contours = straight([np.stack([100 + x, np.full(len(x), 100 + y)], axis=1) for x, y in parts])
    edgels = EdgelMap(contours, view.camera.width, view.camera.height, 14)
    crowd = edgels.crowded(contours, contours.positions, contours.normals, contours.u, contours.contour)
    first, second, *rest = (contours.contour == k for k in range(4))
    assert not crowd[rest[0]].any() and not crowd[rest[1]].any()
    near = gap <= BESIDE
    assert np.all(crowd[second] == near)
    x = contours.positions[first, 0] - 100
    assert np.all(crowd[first][x < 90] == near) and not crowd[first][x > 110].any()


def straight(lines: list[np.ndarray]) -> Contours:
    """Contours along lines of edgels (n, 2) [px]."""
    contour = np.repeat(np.arange(len(lines)), [len(line) for line in lines])
    positions = np.concatenate(lines)
    u, breaks = arc_length(positions, contour)
    t = knots(u, contour, breaks, np.full(len(u), 20.0), np.bincount(contour) - 3, 7.5)
    found = fit(u, positions, np.ones(len(u)), t, breaks)
    at, _, normals, bend = found.splines.frame(u)
    one = np.ones(len(u))
    return Contours(found.splines, u, contour, at, normals, bend, one, one, 100 * one, 0 * one, 1.0)


N, OFF = 40, 8  # tracks, of which the first OFF are on other contours
PIXEL = 1 / cameras(3)[1].camera.fx


class Drawn:
    """Views from poses that are off by POSE, of n tracks that are found where they are expected, give or take 0.1 px."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.view = cameras(3)[1]
        self.p = self.rng.uniform([-0.15, -0.1, 0.45], [0.15, 0.1, 0.65], (N, 3))
        self.image_normals = self.rng.standard_normal((N, 2))
        along = np.stack([-self.image_normals[:, 1], self.image_normals[:, 0], np.zeros(N)], axis=1)
        normals = np.cross(self.p, along)
        self.normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
        rotation = self.view.T_world_camera.rotation
        self.direction = rotation.apply(np.pad(self.image_normals, ((0, 0), (0, 1))))
        self.planes = rotation.apply(self.normals)

    def look(self, off: np.ndarray) -> tuple[View, np.ndarray, Crossings]:
        """A view, predicted points (n, 3) and matches that are `off` (n,) [px]."""
        error = pose_exp(POSE * self.rng.standard_normal(6))
        view = replace(
            self.view, T_world_camera=self.view.T_world_camera * error, pose_covariance=POSE**2 * np.eye(6)
        )
        turned = error.rotation
        direction, planes = (
            self.view.T_world_camera.rotation.apply(
                turned.apply(self.view.T_world_camera.rotation.inv().apply(v))
            )
            for v in (self.direction, self.planes)
        )
        distance = np.linalg.norm(self.p, axis=1)
        missed = (off + 0.1 * self.rng.standard_normal(N)) * PIXEL * distance
        points = self.view.T_world_camera.apply(self.p) + missed[:, None] * self.planes
        zero, no = np.zeros(N), np.zeros(N, bool)
        found = Crossings(
            ~no, direction, np.zeros((N, 2)), planes, planes, zero + 0.1, zero, zero, zero + 100.0, no
        )
        return view, points, found


def test_the_error_that_all_share() -> None:
    """Where most of the matches are right, the pose is found to what their noise leaves; what is left over is theirs."""
    drawn = Drawn(1)
    before, after = [], []
    for _ in range(20):
        off = np.where(np.arange(N) < OFF, 5.0, 0.0)
        view, points, found = drawn.look(off)
        normals = found.tangent_planes @ view.T_world_camera.rotation.as_matrix()
        shared = shared_error(np.ones(N, bool), view, points, normals)
        assert np.abs(shared.left[OFF:]).max() < 1.0 * PIXEL
        assert np.abs(shared.left[:OFF] - 5.0 * PIXEL).max() < 1.5 * PIXEL
        true = drawn.view.T_world_camera
        before.append((view.T_world_camera.inv() * true).rotation.magnitude())
        after.append((shared.T_world_camera.inv() * true).rotation.magnitude())
    assert np.median(after) < 0.5 * np.median(before)


def test_tracks_that_go_over_to_other_contours() -> None:
    """Tracks that hop by 3 px are left out; back on their own contours, they are believed after CONFIRMED views."""
    drawn, on = Drawn(2), np.ones(N, bool)
    tracks, hop = Continuity(N), np.where(np.arange(N) < OFF, 3.0, 0.0)
    for i, off in enumerate([0 * hop, 0 * hop, hop, hop, 0 * hop, 0 * hop]):
        view, points, found = drawn.look(off)
        ok = tracks.kept(on, view, 2.0, points, found, found.directions)
        assert np.all(ok[OFF:]), i
        assert np.all(ok[:OFF] == (i < 2 or i >= 3 + CONFIRMED)), i


@pytest.mark.parametrize("what", ["contrast", "directions", "crowded", "curvature"])
def test_edges_that_look_different(what: str) -> None:
    drawn, on = Drawn(3), np.ones(N, bool)
    tracks, first = Continuity(N), np.arange(N) < OFF
    for i in range(2):
        view, points, found = drawn.look(np.zeros(N))
        before = found.directions
        if i == 1:
            axis = view.T_world_camera.rotation.as_matrix()[:, 2]
            other = {
                "contrast": 2 * found.contrast,
                "directions": Rotation.from_rotvec(0.2 * axis).apply(found.directions),
                "crowded": on,
                "curvature": np.full(N, 0.2),
            }[what]
            mine = getattr(found, what)
            rows = first if mine.ndim == 1 else first[:, None]
            found = replace(found, **{what: np.where(rows, other, mine)})
        ok = tracks.kept(on, view, 2.0, points, found, before)
        np.testing.assert_array_equal(ok, on if i == 0 else ~first)


def test_the_first_views() -> None:
    """One edgel among its neighbours on a contour is off by as much as two contours may be apart."""
    drawn, on = Drawn(4), np.ones(N, bool)
    contour = np.repeat(np.arange(4), 10)
    lonely = np.isin(np.arange(N), [3, 17, 30])
    view, points, found = drawn.look(np.where(lonely, 2.0, 0.0))
    ok, pose = begun(on, view, 2.0, points, found, contour, found.contrast)
    np.testing.assert_array_equal(ok, ~lonely)
    true = drawn.view.T_world_camera
    assert (pose.inv() * true).rotation.magnitude() < (view.T_world_camera.inv() * true).rotation.magnitude()
    ok, _ = begun(on, view, 2.0, points, found, contour, np.where(lonely, 100.0, 300.0))
    assert not ok.any()


def test_too_few_matches_tell_nothing_of_each_other() -> None:
    drawn = Drawn(5)
    view, points, found = drawn.look(np.full(N, 20.0))
    few = np.arange(N) < LEAST_MATCHES - 1
    np.testing.assert_array_equal(Continuity(N).kept(few, view, 2.0, points, found, found.directions), few)
    ok, pose = begun(few, view, 2.0, points, found, np.zeros(N, int), found.contrast)
    np.testing.assert_array_equal(ok, few)
    assert pose is view.T_world_camera
