"""The suction cup against closed forms for cylinders, quadrature, and the criterion worked out by hand."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.spatial.transform import RigidTransform, Rotation

from extremal.estimator import InvalidInput
from extremal.scenes import Box, Lathe, Sphere
from extremal.tasks.suction import RAYS, SuctionCup, load_ratio, seal

CUP = SuctionCup()
POSE = RigidTransform.from_components([0.3, -0.2, 0.1], Rotation.from_euler("xyz", [0.4, -0.7, 1.1]))
# The lip in the plane that touches a cylinder half-way up, its z into it, its y along the axis.
TOUCHING = Rotation.from_matrix(np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]]))


def cylinder(radius: float) -> Lathe:
    return Lathe([0, 0.1, 0.2], [radius] * 3, T_world_object=POSE)


def poses(
    radius: float, advance: np.ndarray, sideways: float = 0.0, turn: tuple[float, float] = (0, 0)
) -> RigidTransform:
    """Cups (N) on a cylinder of POSE, pushed in by `advance` (N,), shifted across the axis, turned about their own x and y."""
    touching = RigidTransform.from_components([-radius, 0, 0.1], TOUCHING)
    shift = np.stack([np.full_like(advance, sideways), np.zeros_like(advance), advance], axis=-1)
    return POSE * touching * RigidTransform.from_components(shift, Rotation.from_rotvec([*turn, 0.0]))


def sagitta(radius: float) -> float:
    return radius - np.sqrt(radius**2 - CUP.lip_radius**2)


def test_travel_to_a_cylinder_is_its_section() -> None:
    angle = 2 * np.pi * np.arange(RAYS) / RAYS
    for advance in (-0.02, 0.0, 0.004, 0.03):
        found = seal(CUP, cylinder(0.04), poses(0.04, np.array([advance])))
        depth = 0.04 - np.sqrt(0.04**2 - (CUP.lip_radius * np.cos(angle)) ** 2)
        np.testing.assert_allclose(found.travel[0], depth - advance, atol=1e-12)


def test_the_strain_is_the_rims_arc_length() -> None:
    def rate(phi: float) -> float:
        across = CUP.lip_radius * np.cos(phi)
        slope = across * -np.sin(phi) * CUP.lip_radius / np.sqrt(0.03**2 - across**2)
        return float(np.hypot(CUP.lip_radius, slope))

    length = quad(rate, 0, 2 * np.pi)[0]
    expected = length / (2 * np.pi * CUP.lip_radius) - 1
    found = seal(CUP, cylinder(0.03), poses(0.03, np.array([0.0])))
    assert found.strain[0] == pytest.approx(expected, rel=0.01)  # a polygon of 64 sides
    assert expected > 0.01


@pytest.mark.parametrize(
    ("radius", "normal", "tilt", "sideways"),
    [(0.03, 1.0e-3, 5.5, 3e-3), (0.04, 1.5e-3, 8.5, 6e-3), (0.06, 2.0e-3, 10.5, 11e-3)],
)
def test_windows(radius: float, normal: float, tilt: float, sideways: float) -> None:
    """Half of what the section leaves of the stroke; tilt and shift as on the prototype, guarded approach."""
    surface, advance = cylinder(radius), np.linspace(0, 0.014, 281)
    sealed = advance[seal(CUP, surface, poses(radius, advance)).sealed]
    exact = sagitta(radius), CUP.stroke
    np.testing.assert_allclose([sealed.min(), sealed.max()], exact, atol=5.1e-5)
    assert (exact[1] - exact[0]) / 2 == pytest.approx(normal, abs=0.06e-3)

    def seals(shift: float = 0.0, turn: tuple[float, float] = (0, 0)) -> bool:
        return bool(np.any(seal(CUP, surface, poses(radius, advance, shift, turn)).sealed))

    for axis in ((1, 0), (0, 1)):
        for factor, expected in ((0.9, True), (1.5, False)):
            angle = np.radians(factor * tilt)
            assert seals(turn=(axis[0] * angle, axis[1] * angle)) == expected
    assert seals(0.9 * sideways) and not seals(1.2 * sideways)


def test_reasons_and_batches() -> None:
    surface = cylinder(0.04)
    batch = poses(0.04, np.array([-1e-3, 4e-3, 8e-3]))
    found = seal(CUP, surface, batch)
    assert found.reason.tolist() == ["gap", "", "stroke"] and found.sealed.tolist() == [False, True, False]
    for i in range(3):
        one = seal(CUP, surface, batch[i])
        np.testing.assert_array_equal(one.travel, found.travel[i])
        assert one.sealed == found.sealed[i] and one.reason == found.reason[i]
        assert one.strain == found.strain[i]
    beside = seal(CUP, surface, poses(0.04, np.array([4e-3]), sideways=0.03))
    assert beside.reason == ["missed"] and not beside.sealed and np.isinf(beside.gap)
    stiff = seal(SuctionCup(strain=1e-3), surface, batch[1])
    assert stiff.reason == "strain" and not stiff.sealed
    small = seal(
        CUP, Sphere(0.018, T_world_object=POSE), POSE * RigidTransform.from_translation([0, 0, -0.018])
    )
    assert small.reason == "gap" and np.ptp(small.travel) < 1e-12


def test_a_flat_face_seals_over_the_whole_stroke_and_over_its_edge_not_at_all() -> None:
    box = Box((0.1, 0.1, 0.1))
    centres = np.array([[0, 0, -0.05 + 1e-9], [0, 0, -0.044 - 1e-9], [0, 0, -0.0439], [0.036, 0, -0.047]])
    assert seal(CUP, box, RigidTransform.from_translation(centres)).reason.tolist() == [
        "",
        "",
        "stroke",
        "missed",
    ]


def test_load_ratios_by_hand() -> None:
    V = 60e3 * np.pi * 0.015**2
    assert pytest.approx(V) == CUP.vacuum_force
    cases = [
        ([0, 0, 0.4 * V], [0, 0, 0], 0.4),
        ([0, 0.25 * V, 0], [0, 0, 0], 0.5),
        ([0.15 * V, 0.2 * V, 0.5 * V], [0, 0, 0], 1.0),
        ([0, 0, 0], [0, 0, 0.25 * V * 0.015], 0.5),
        ([0.3 * V, 0, 0], [0, 0, 0.4 * V * 0.015], 1.0),
        ([0, 0, 0], [0.3 * V * 0.015, 0.4 * V * 0.015, 0], 0.5),
        ([0, 0.25 * V, -V], [0, 0, 0], 0.25),
    ]
    force, torque, expected = (np.array(x) for x in zip(*cases, strict=True))
    np.testing.assert_allclose(load_ratio(CUP, force, torque), expected)
    assert load_ratio(CUP, [0.1, 0, 1.001 * V], [0, 0, 0]) > 1


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"lip_radius": 0.0}, "lip radius of the cup is 0.0; accepted: above 0"),
        ({"stroke": float("nan")}, "stroke of the cup is nan"),
        ({"pressure": 2e5}, "pressure of the cup is 200000.0"),
        ({"friction": -1.0}, "friction of the cup is -1.0"),
        ({"strain": 0.0}, "strain of the cup is 0.0"),
    ],
)
def test_bad_cups_are_named(values: dict[str, float], message: str) -> None:
    with pytest.raises(InvalidInput, match=message):
        SuctionCup(**values)


def test_poses_must_be_finite() -> None:
    with pytest.raises(InvalidInput, match="T_world_cup must be finite"):
        seal(CUP, cylinder(0.04), RigidTransform.from_translation([np.nan, 0, 0]))
