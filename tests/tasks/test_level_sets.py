"""Level sets in compiled code against the surfaces' own answers and finite differences."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from extremal.scenes import Box, Ellipsoid, Lathe, Sphere, Superquadric, Surface
from extremal.tasks.clearance import _meridians
from extremal.tasks.distances import from_box, from_lathe, nearest, radial
from extremal.tasks.level_sets import Solids, differential, inside, local, profile, world

POSE = RigidTransform.from_components([0.1, -0.2, 0.3], Rotation.from_rotvec([0.4, -0.3, 1.0]))
LATHE = Lathe([0, 0.05, 0.12, 0.2], [0.04, 0.06, 0.03, 0.05], T_world_object=POSE, name="lathe")
SMOOTH = [
    LATHE,
    Sphere(radius=0.05, T_world_object=POSE),
    Ellipsoid(a=0.05, b=0.08, c=0.11, T_world_object=POSE),
    Superquadric(a=0.05, b=0.08, c=0.11, e1=0.4, e2=0.7, T_world_object=POSE),
]
BOX = Box(size=(0.1, 0.2, 0.3), T_world_object=POSE)
SOLIDS = Solids.of([BOX, *SMOOTH, Lathe([0, 0.1], [0.03, 0.02], name="cone")])


def points(surface: Surface, n: int) -> np.ndarray:
    """Points (n, 3) about a surface, in its frame."""
    centre, radius = surface._bounds
    return centre + np.random.default_rng(4).uniform(-0.85, 0.85, (n, 3)) * radius


@pytest.mark.parametrize("k", range(1, 5))
def test_derivatives_are_those_of_finite_differences(k: int) -> None:
    directions = np.random.default_rng(5).normal(size=(30, 3))
    places = points(SMOOTH[k - 1], 30)
    if k == 1:
        places[:, 2] = np.clip(places[:, 2], 0.001, 0.199)  # of its side
    for p, d in zip(places, directions, strict=True):
        h, at = 1e-7, tuple(p.tolist())
        F, g, turn = differential(SOLIDS, k, at, tuple(d.tolist()))
        ahead, behind = (differential(SOLIDS, k, tuple((p + s * h * d).tolist()), at) for s in (1, -1))
        size = max(1.0, float(np.linalg.norm(turn)))
        assert (ahead[0] - behind[0]) / (2 * h) == pytest.approx(np.dot(g, d), rel=1e-5, abs=1e-6)
        slope = (np.array(ahead[1]) - behind[1]) / (2 * h)
        np.testing.assert_allclose(slope, turn, rtol=1e-4, atol=1e-5 * size)
        if k > 1:
            assert (F < 0) == inside(SOLIDS, k, at)


@pytest.mark.parametrize("k", range(1, 5))
def test_inside_is_where_the_distance_is_negative(k: int) -> None:
    surface = SMOOTH[k - 1]
    p = points(surface, 200)
    expected = surface._signed_distance(p) < 0
    assert 0.03 < expected.mean() < 0.95
    np.testing.assert_array_equal([inside(SOLIDS, k, tuple(x.tolist())) for x in p], expected)


def test_distances_of_points_outside() -> None:
    meridians = _meridians(SOLIDS)
    for k, surface in enumerate([BOX, *SMOOTH]):
        p = points(surface, 300)
        exact = surface._signed_distance(p)
        for x, expected in zip(p[exact > 1e-3], exact[exact > 1e-3], strict=True):
            y = tuple(x.tolist())
            if k == 0:
                found = from_box(SOLIDS.shape[0], y)
            elif k == 1:
                found = from_lathe(SOLIDS, 1, meridians[1], y)
            else:
                found = nearest(SOLIDS, k, radial(SOLIDS, k, y), y)[2]
            assert found == pytest.approx(expected, abs=1e-9) or (k > 1 and not found > 0)


def test_profiles_and_frames() -> None:
    for z in (-0.1, 0.0, 0.01, 0.05, 0.13, 0.2, 0.3):
        for k, lathe in ((1, LATHE), (5, Lathe([0, 0.1], [0.03, 0.02], name="cone"))):
            expected = [float(v) for v in lathe.profile.derivatives(np.array(z))]
            np.testing.assert_allclose(profile(SOLIDS, k, z), expected, atol=1e-14)
    p = (0.3, 0.2, -0.5)
    np.testing.assert_allclose(local(SOLIDS, 2, p), POSE.inv().apply(p), atol=1e-15)
    np.testing.assert_allclose(world(SOLIDS, 2, local(SOLIDS, 2, p)), p, atol=1e-15)
