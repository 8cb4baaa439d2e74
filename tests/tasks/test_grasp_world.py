"""Grasps under physics: what succeeds, what must fail and why, the wrench by statics, the same bytes again."""

import time
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from extremal.estimator import ExtremalError, InvalidInput
from extremal.estimator.errors import SceneError
from extremal.scenes import Box, Ellipsoid, Lathe, Superquadric, Surface
from extremal.sim import NOMINAL, ArmErrors, UnreachablePose
from extremal.tasks.grasp_motion import (
    STEP,
    T_FLANGE_CUP,
    T_TABLE_BASE,
    CupKinematics,
    JointPath,
    cup_facing,
    timed,
)
from extremal.tasks.grasp_world import GraspDiverged, GraspWorld
from extremal.tasks.suction import load_ratio

ARM = CupKinematics(T_TABLE_BASE)
BACK, BEYOND = (
    0.02,
    0.01,
)  # where a guarded approach starts and where it ends, from where the lip's middle would touch [m]
STEPPED = [(0.025, 150), (0.025, 225), (0.04, 180), (0.06, 135), (0.08, 200), (0.08, 250)]
FIELD = 9.81


def cylinder(radius: float) -> Lathe:
    return Lathe([0, 0.1, 0.2], [radius] * 3, name="vase")


def contact(radius: float, azimuth: float = 180.0, tilt: float = 0.0, height: float = 0.1) -> RigidTransform:
    """The lip's middle on a cylinder about the world's z axis, the cup turned about its own x by `tilt` [degrees]."""
    n = np.array([np.cos(np.radians(azimuth)), np.sin(np.radians(azimuth)), 0.0])
    facing = cup_facing([radius * n + [0, 0, height]], [n])[0]
    return facing * RigidTransform.from_rotation(Rotation.from_rotvec([np.radians(tilt), 0, 0]))


def along(pose: RigidTransform, advance: float) -> RigidTransform:
    return pose * RigidTransform.from_translation([0, 0, advance])


def approached(target: Surface, pose: RigidTransform, **world: object) -> GraspWorld:
    """After the guarded approach towards the cup's pose."""
    path = ARM.straight_approach(along(pose, -BACK), along(pose, BEYOND))
    grasp = GraspWorld(target, ARM, path[0], **world)  # pyright: ignore[reportArgumentType]
    grasp.approach(path)
    return grasp


def lifted(target: Surface, pose: RigidTransform, **world: object) -> GraspWorld:
    grasp = approached(target, pose, **world)
    grasp.lift()
    grasp.hold(1.05)
    return grasp


@pytest.mark.parametrize(("radius", "azimuth"), STEPPED)
def test_a_perfect_grasp_succeeds(radius: float, azimuth: float) -> None:
    grasp = lifted(cylinder(radius), contact(radius, azimuth))
    outcome = grasp.outcome
    assert outcome.success and outcome.sealed and not outcome.released and not outcome.other_contact
    assert 0.1 < outcome.lifted_m < 0.106 and outcome.held_s >= 1
    assert outcome.moved_before_lift_m < 5e-4
    up = grasp.T_world_target.rotation.apply([0, 0, 1])
    assert up[2] > np.cos(np.radians(0.5))  # it does not swing


@pytest.mark.parametrize(
    "target",
    [
        Ellipsoid(0.04, 0.04, 0.08, T_world_object=RigidTransform.from_translation([0, 0, 0.08])),
        Superquadric(
            0.04, 0.05, 0.08, 0.5, 0.9, T_world_object=RigidTransform.from_translation([0, 0, 0.08])
        ),
        Box((0.08, 0.06, 0.2), T_world_object=RigidTransform.from_translation([0, 0, 0.1])),
    ],
    ids=lambda s: s.name,
)
def test_other_shapes_stand_and_are_grasped(target: Surface) -> None:
    pose = contact(0.04, height=target.T_world_object.translation[2])
    still = GraspWorld(target, ARM, ARM.straight_approach(along(pose, -BACK), pose)[0])
    still.hold(1.0)
    moved = target.T_world_object.inv() * still.T_world_target
    assert np.linalg.norm(moved.translation) < 2e-4 and moved.rotation.magnitude() < 2e-3
    assert lifted(target, pose).outcome.success


@pytest.mark.parametrize("radius", [0.03, 0.06])
def test_the_wrench_of_a_lifted_target_is_its_weight(radius: float) -> None:
    grasp = lifted(cylinder(radius), contact(radius))
    weight = FIELD * grasp.mass
    # in the cup frame y is down; the lip has come closer to the axis than the surface
    lever = -(grasp.T_world_cup.inv() * grasp.T_world_target).apply([0, 0, 0.1])[2]
    assert radius - 0.006 < -lever < radius
    np.testing.assert_allclose(grasp.wrench[:3], [0, weight, 0], atol=0.01 * weight)
    np.testing.assert_allclose(grasp.wrench[3:], [lever * weight, 0, 0], atol=0.01 * radius * weight)


@pytest.mark.parametrize(("off", "reason"), [(-0.003, "gap"), (0.003, "stroke")])
def test_off_along_the_normal_it_does_not_seal(off: float, reason: str) -> None:
    radius = 0.04
    middle = (0.006 + radius - np.sqrt(radius**2 - 0.015**2)) / 2
    for advance, expected in ((middle, ""), (middle + off, reason)):
        pose = along(contact(radius), advance)
        start = ARM.joint_positions(RigidTransform.concatenate([pose]))[0]
        grasp = GraspWorld(cylinder(radius), ARM, start)
        assert grasp.seal_now().reason == expected
        assert grasp.outcome.sealed == grasp.holds == (not expected)


@pytest.mark.parametrize("radius", [0.025, 0.08])
def test_tilted_it_does_not_seal_and_does_not_lift(radius: float) -> None:
    outcome = lifted(cylinder(radius), contact(radius, tilt=15)).outcome
    assert not outcome.sealed and not outcome.success and outcome.held_s == 0
    assert abs(outcome.lifted_m) < 0.02


def test_pushed_by_the_stem_it_moves_and_that_is_a_contact() -> None:
    radius = 0.04
    pose = contact(radius) * RigidTransform.from_translation([0.02, 0, 0])
    path = ARM.straight_approach(along(pose, -BACK), along(pose, 0.04))
    grasp = GraspWorld(cylinder(radius), ARM, path[0])
    grasp.approach(path, speed=0.05)
    assert grasp.outcome.other_contact == "arm on vase"
    assert grasp.outcome.moved_before_lift_m > 0.005


def test_what_is_too_heavy_is_let_go_for_good() -> None:
    """The weight's torque about the lip: beyond V r = 0.64 N m at a mass of 1.8 kg."""
    grasp = lifted(cylinder(0.04), contact(0.04), area_density=30.0)
    outcome = grasp.outcome
    assert FIELD * grasp.mass * 0.037 > grasp.cup.vacuum_force * grasp.cup.lip_radius
    assert outcome.sealed and outcome.released and not outcome.success and outcome.largest_load > 1
    assert outcome.held_s == 0
    grasp.seal_now()
    assert not grasp.holds


def test_pulled_sideways_it_slides_beyond_friction() -> None:
    """A growing force at the lip, across it: it lets go where hypot(force, weight) is mu V."""
    grasp = lifted(cylinder(0.04), contact(0.04))
    limit = np.sqrt((0.5 * grasp.cup.vacuum_force) ** 2 - (FIELD * grasp.mass) ** 2)
    pulled = 0.0
    while grasp.holds and pulled < 2 * limit:
        pulled += 0.002 * limit
        arm = grasp.T_world_cup.translation - grasp._data.xipos[grasp._body]
        force = np.array([0.0, pulled, 0.0])
        grasp._data.xfrc_applied[grasp._body] = [*force, *np.cross(arm, force)]
        grasp.hold(0.01)
    assert not grasp.holds and grasp.outcome.released
    assert pulled == pytest.approx(limit, rel=0.03)
    assert load_ratio(grasp.cup, grasp.wrench[:3], grasp.wrench[3:]) > 1


def test_a_box_in_the_way_is_another_contact() -> None:
    box = Box((0.08, 0.08, 0.11), T_world_object=RigidTransform.from_translation([-0.1, 0.075, 0.055]))
    clear = Box((0.08, 0.08, 0.11), T_world_object=RigidTransform.from_translation([0.0, 0.12, 0.055]))
    touching = approached(cylinder(0.04), contact(0.04, 120), obstacles=[box]).outcome
    assert touching.other_contact in ("arm on box",) and not touching.success
    assert lifted(cylinder(0.04), contact(0.04), obstacles=[clear]).outcome.success


def test_physics_is_that_of_the_actual_arm() -> None:
    """Where the arm is not as believed, the cup is elsewhere, by as much as its own kinematics says."""
    actual = ArmErrors(joint_offset=2e-3, link_length=1e-3).draw(np.random.default_rng(3))
    pose = along(contact(0.06), -BACK)
    start = ARM.joint_positions(RigidTransform.concatenate([pose]))[0]
    grasp = GraspWorld(cylinder(0.06), ARM, start, actual=actual)
    grasp.hold(0.5)
    expected = (T_TABLE_BASE * actual.flange_poses(start[None]) * T_FLANGE_CUP)[0]
    np.testing.assert_allclose(grasp.T_world_cup.as_matrix(), expected.as_matrix(), atol=1e-6)
    assert np.linalg.norm(expected.translation - pose.translation) > 5e-4
    knowing = CupKinematics(T_TABLE_BASE, actual)
    q = knowing.joint_positions(RigidTransform.concatenate([pose]))
    grasp = GraspWorld(cylinder(0.06), knowing, q[0])
    np.testing.assert_allclose(grasp.T_world_cup.as_matrix(), pose.as_matrix(), atol=1e-8)


def test_same_calls_same_bytes() -> None:
    a, b = (lifted(cylinder(0.06), contact(0.06, 210)) for _ in range(2))
    assert a.outcome == b.outcome
    assert a.joint_positions.tobytes() == b.joint_positions.tobytes()
    assert a.T_world_target.as_matrix().tobytes() == b.T_world_target.as_matrix().tobytes()
    assert a.wrench.tobytes() == b.wrench.tobytes()


def test_a_grasp_runs_many_times_faster_than_the_clock() -> None:
    started = time.process_time()
    grasp = lifted(cylinder(0.04), contact(0.04))
    assert grasp.time > 10 * STEP and time.process_time() - started < grasp.time / 3


def test_straight_paths_are_straight() -> None:
    start, end = along(contact(0.04, 150), -0.1), along(contact(0.04, 150), 0.01)
    believed = NOMINAL.with_parameters(np.random.default_rng(0).normal(size=18) * 1e-3)
    arm = CupKinematics(T_TABLE_BASE, believed)
    path = arm.straight_approach(start, end)
    poses = arm.cup_poses(path)
    np.testing.assert_allclose(poses[-1].as_matrix(), end.as_matrix(), atol=1e-9)
    offset = start.inv().apply(poses.translation)
    np.testing.assert_allclose(offset[:, :2], 0, atol=1e-9)
    np.testing.assert_allclose(np.diff(offset[:, 2]), 0.11 / (len(path) - 1), atol=1e-9)
    assert np.max((start.rotation.inv() * poses.rotation).magnitude()) < 1e-9
    assert np.abs(np.diff(path, axis=0)).max() < 0.03
    # between them too, as the spline of `timed` goes
    dense = start.inv().apply(arm.cup_poses(timed(path).positions).translation)
    assert np.abs(dense[:, :2]).max() < 2e-6
    np.testing.assert_allclose(ARM.joint_path_to(path[0], end)[0], path[0])
    with pytest.raises(UnreachablePose):
        arm.straight(path[0], along(start, -2.0))


def test_timing() -> None:
    path = timed([[0.0] * 6, [0.3, -0.1, 0, 0, 0, 0], [0.5, 0.2, 0, 0, 0, 0.1]], speed=0.8, least=0.1)
    assert (
        np.abs(path.velocities).max() == pytest.approx(0.8, rel=0.02) or np.abs(path.velocities).max() < 0.8
    )
    np.testing.assert_allclose(
        np.gradient(path.positions, STEP, axis=0)[1:-1], path.velocities[1:-1], atol=1e-3
    )
    np.testing.assert_allclose(path.positions[-1], [0.5, 0.2, 0, 0, 0, 0.1], atol=1e-12)
    assert np.abs(path.velocities[-1]).max() == 0
    assert len(timed([[0.0] * 6] * 2, least=0.5).positions) == round(0.5 / STEP)


def test_bad_input(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    target, start = cylinder(0.04), ARM.joint_positions(RigidTransform.concatenate([contact(0.06)]))[0]
    with pytest.raises(InvalidInput, match="joint positions to start from are"):
        GraspWorld(target, ARM, [np.nan] * 6)
    with pytest.raises(SceneError, match=r"called \['vase', 'vase'\]; names must differ"):
        GraspWorld(target, ARM, start, [cylinder(0.05)])
    with pytest.raises(InvalidInput, match="area density is -1"):
        GraspWorld(target, ARM, start, area_density=-1)
    with pytest.raises(InvalidInput, match=r"positions of the joints are \(3, 6\)"):
        JointPath(np.full((3, 6), np.nan), np.zeros((3, 6)))
    with pytest.raises(InvalidInput, match="speed and acceleration are 6"):
        timed([start, start], speed=6.0)
    grasp = GraspWorld(target, ARM, start)
    with pytest.raises(InvalidInput, match="time to hold is nan"):
        grasp.hold(float("nan"))
    with pytest.raises(InvalidInput, match="speed of the approach is 0"):
        grasp.approach(start[None], speed=0.0)
    grasp._data.qvel[8] = 2e3
    with pytest.raises(GraspDiverged, match="the simulation of 'vase' diverged") as caught:
        grasp.hold(0.1)
    assert isinstance(caught.value, ExtremalError)
    assert not list(tmp_path.iterdir())  # MuJoCo's log
