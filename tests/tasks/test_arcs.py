"""Arcs around what is seen: closed forms on cylinders, then looking again along exact contours of other bodies."""

import time
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from extremal.estimator.errors import InvalidInput
from extremal.scenes import Ellipsoid, Lathe, Superquadric, Surface
from extremal.tasks.metrics import smallest_clearance, travelled_length
from extremal.tasks.planning.arcs import plan_arc, plan_around
from extremal.tasks.planning.belief import ArcBelief, Caution
from extremal.tasks.planning.pursuit import next_velocity
from extremal.tasks.shortest_path import shortest_path

UP = np.array([0.0, 0.0, 1.0])


def on_cylinder(angle: float, radius: float = 0.05, **sigmas: float) -> ArcBelief:
    n = np.array([np.cos(angle), np.sin(angle), 0.0])
    return ArcBelief(radius * n, n, UP, radius, **sigmas)


def test_exact_beliefs_on_cylinders_give_the_optimum() -> None:
    rng = np.random.default_rng(31)
    for _ in range(15):
        radius, clearance = rng.uniform(0.02, 0.15), rng.uniform(0.02, 0.06)
        pose = RigidTransform.from_components(rng.normal(size=3), Rotation.from_rotvec(rng.normal(size=3)))
        cylinder = Lathe([0, 1, 2], [radius] * 3, T_world_object=pose)
        a, b = (radius + clearance) * rng.uniform(1.02, 2.0, 2)
        side = rng.choice([-1, 1])
        goal_at, seen_at = side * rng.uniform(1.8, 3.1), side * np.arccos(radius / a)
        start = pose.apply([a, 0, 1 + rng.uniform(-0.05, 0.05)])
        goal = pose.apply([b * np.cos(goal_at), b * np.sin(goal_at), 1 + rng.uniform(-0.05, 0.05)])
        n = np.array([np.cos(seen_at), np.sin(seen_at), 0.0])
        seen = ArcBelief(
            pose.apply(radius * n + [0, 0, 1.02]),
            pose.rotation.apply(n),
            pose.rotation.apply(UP) * rng.choice([-1, 1]),
            radius,
        )
        plan = plan_arc(start, goal, seen, Caution(clearance))
        assert plan.length == pytest.approx(shortest_path(cylinder, start, goal, clearance).length, rel=1e-6)
        assert travelled_length(plan.waypoints) == pytest.approx(plan.length, rel=2e-4)
        assert smallest_clearance(cylinder, plan.waypoints, 0) > clearance - 2e-4
        assert np.abs(plan.waypoints[[0, -1]] - [start, goal]).max() < 1e-12


@dataclass
class Walk:
    """A sphere's centre that goes around a surface on one side, and looks at the exact contour on its way.

    The contact lies in the horizontal plane through the centre; beliefs carry the true radius of that section.
    """

    surface: Surface
    goal: np.ndarray
    clearance: float
    side: float  # 1: the obstacle is on the left
    step: float = 0.002

    def look(self, centre: np.ndarray, near: np.ndarray | None) -> ArcBelief:
        if near is None:
            curves = self.surface.contour_generator(centre)
            p = np.concatenate([c.points[c.visible] for c in curves])
            n = np.concatenate([c.normals[c.visible] for c in curves])
            ray = (p - centre) / np.linalg.norm(p - centre, axis=1, keepdims=True)
            left = np.cross(ray, -n) @ UP * self.side > 0.2
            near = p[left][np.argmin(np.abs(ray[left] @ UP))]
        p = self.surface.contour_points_in_planes(np.array([near]), centre, UP[None])[0]
        radius = float(self.surface.section_radius(p, UP))
        return ArcBelief(p, self.surface.normals(p), UP, min(radius, 10.0))

    def go(self, start: np.ndarray, look_every: float) -> np.ndarray:
        """Travelled points (n, 3)."""
        x, travelled, beliefs, since = start, [start], [], np.inf
        waypoints = np.stack([start, self.goal])
        for _ in range(1000):
            if since >= look_every:
                beliefs.append(self.look(x, beliefs[-1].point if beliefs else None))
                waypoints = plan_arc(x, self.goal, beliefs, Caution(self.clearance)).waypoints
                since = 0.0
            x = x + next_velocity(x, waypoints, self.step / 0.02, 0.02) * 0.02
            since += self.step
            travelled.append(x)
            if np.linalg.norm(x - self.goal) < 1e-6:
                break
        return np.array(travelled)


def around(
    surface: Surface, far: float, clearance: float, rng: np.random.Generator
) -> tuple[Walk, np.ndarray]:
    """A walk around a body at the origin, 60 to 110 mm beyond its clearance at both ends, along a random chord."""
    a, b = far + clearance + rng.uniform(0.06, 0.11, 2)
    turn = rng.uniform(2.5, 3.0)
    start, goal = np.array([-a, 0, 0]), np.array([-b * np.cos(turn), -b * np.sin(turn), 0.01])
    best = shortest_path(surface, start, goal, clearance)
    middle = best.points[len(best.points) // 2] - (start + goal) / 2
    return Walk(surface, goal, clearance, -float(np.sign(np.cross(goal - start, middle) @ UP))), start


BODIES = [
    (Ellipsoid(0.1, 0.05, 0.3), 0.1),
    pytest.param(Superquadric(0.05, 0.07, 0.3, 0.8, 0.7), 0.085, marks=pytest.mark.slow),
    (
        Lathe(
            [0, 0.05, 0.1, 0.15, 0.2],
            [0.055, 0.062, 0.05, 0.045, 0.055],
            T_world_object=RigidTransform.from_translation([0, 0, -0.1]),
        ),
        0.062,
    ),
]


@pytest.mark.parametrize(("surface", "far"), BODIES, ids=["ellipse", "superellipse", "vase"])
def test_looking_again_keeps_the_clearance_and_nearly_the_optimum(surface: Surface, far: float) -> None:
    rng = np.random.default_rng(32)
    walk, start = around(surface, far, 0.03, rng)
    travelled = walk.go(start, 0.006)
    optimum = shortest_path(surface, start, walk.goal, walk.clearance).length
    assert np.linalg.norm(travelled[-1] - walk.goal) < 1e-6
    assert smallest_clearance(surface, travelled, 0) > walk.clearance - 5e-4
    assert travelled_length(travelled) <= 1.05 * optimum


def test_one_arc_around_an_ellipse_cuts_the_clearance() -> None:
    """From the tip's side towards the flat side, the first circle says nothing of how flat the section becomes."""
    body, clearance = Ellipsoid(0.1, 0.05, 0.3), 0.02
    start, goal = np.array([-0.15, 0.001, 0]), np.array([0.15, -0.01, 0])
    walk = Walk(body, goal, clearance, 1.0)
    once, again = walk.go(start, np.inf), walk.go(start, 0.006)
    assert smallest_clearance(body, once, 0) < clearance - 5e-3
    assert smallest_clearance(body, again, 0) > clearance - 5e-4


def test_uncertainty_widens_the_arc_up_to_a_limit() -> None:
    start, goal = np.array([-0.2, 0, 0]), np.array([0.2, 0.02, 0])
    lengths = [
        plan_arc(start, goal, on_cylinder(1.9, sigma_radius=sigma), Caution(0.03, k=2)).length
        for sigma in (0.0, 0.01, 0.03, 10.0, np.inf)
    ]
    assert np.all(np.diff(lengths[:3]) > 0)
    assert lengths[3] == lengths[4] < 0.7
    moved = plan_arc(start, goal, on_cylinder(1.9, sigma_point=0.01), Caution(0.03, k=2))
    wider = plan_arc(start, goal, on_cylinder(1.9), Caution(0.05, k=0))
    assert moved.length == pytest.approx(wider.length)


def test_within_the_clearance_the_way_out_comes_first() -> None:
    start, goal = np.array([-0.06, 0.02, 0]), np.array([0.12, 0.08, 0])
    plan = plan_arc(start, goal, on_cylinder(1.9), Caution(0.03))
    distance = np.linalg.norm(start[:2])
    assert plan.depth == pytest.approx(0.08 - distance, abs=1e-9)
    np.testing.assert_allclose(plan.waypoints[1][:2], start[:2] * 0.08 / distance, atol=1e-9)


def test_straight_where_nothing_is_in_the_way_or_nothing_is_known() -> None:
    start = np.array([-0.2, 0, 0])
    for goal in ([-0.2, 0.2, 0.0], [-0.1, 0.1, 0], [-0.25, 0, 0.05], [-0.2, 0, 0]):
        assert len(plan_arc(start, np.array(goal), on_cylinder(1.9), Caution(0.03)).waypoints) == 2
    assert len(plan_arc(start, np.array([0.2, 0, 0]), [], Caution(0.03)).waypoints) == 2
    passed = plan_arc(np.array([0.1, 0.08, 0]), np.array([0.15, 0.05, 0]), on_cylinder(1.9), Caution(0.04))
    assert len(passed.waypoints) == 2


def test_the_shorter_side_with_evidence() -> None:
    start, goal = np.array([-0.15, 0, 0]), np.array([0.14, 0.03, 0])
    left, right = [on_cylinder(1.9)], [on_cylinder(-1.9)]
    both, which = plan_around(start, goal, [left, right], Caution(0.03))
    assert which == 0
    only, other = plan_around(start, goal, [[], right], Caution(0.03))
    assert other == 1
    assert only.length > both.length
    assert only.waypoints[len(only.waypoints) // 2, 1] < 0 < both.waypoints[len(both.waypoints) // 2, 1]
    assert plan_around(start, goal, [[], []], Caution(0.03))[1] == -1


def test_any_belief_gives_a_finite_path_to_the_goal() -> None:
    rng = np.random.default_rng(33)
    for _ in range(500):
        axis, ends = rng.normal(size=3), rng.normal(size=(2, 3)) * 0.15
        beliefs = []
        for _ in range(rng.integers(1, 5)):
            n = np.cross(axis, rng.normal(size=3))
            n = n / np.linalg.norm(n) + rng.uniform(-1, 1) * axis / np.linalg.norm(axis)
            point, radius, sigmas = rng.normal(size=3) * 0.05, rng.normal() * 0.1, np.abs(rng.normal(size=2))
            beliefs.append(ArcBelief(point, n, axis, radius, 0.2 * sigmas[0], 0.02 * sigmas[1]))
        plan = plan_arc(ends[0], ends[1], beliefs, Caution(0.03))
        assert np.all(np.isfinite(plan.waypoints))
        assert np.array_equal(plan.waypoints[[0, -1]], ends)
        assert np.linalg.norm(ends[1] - ends[0]) - 1e-9 <= plan.length < 5


def test_following_an_arc_never_cuts_inside_and_stops_at_its_end() -> None:
    start, goal = np.array([-0.15, 0, 0]), np.array([0.14, 0.03, 0.04])
    plan = plan_arc(start, goal, on_cylinder(1.9), Caution(0.03))
    x, travelled = start, [start]
    for _ in range(200):
        v = next_velocity(x, plan.waypoints, 0.1, 0.05)
        assert np.linalg.norm(v) <= 0.1 + 1e-12
        x = x + v * 0.05
        travelled.append(x)
    np.testing.assert_allclose(x, goal, atol=1e-9)
    inside = 0.08 - np.linalg.norm(np.array(travelled)[:, :2], axis=1)
    assert inside.max() < 5e-5  # the waypoints' own chords
    assert travelled_length(travelled) < 1.01 * plan.length


def test_a_plan_takes_about_a_millisecond() -> None:
    beliefs = [on_cylinder(2.2 - 0.01 * i) for i in range(40)]
    spent = []
    for _ in range(50):
        begin = time.process_time()
        plan_arc(np.array([-0.15, 0, 0]), np.array([0.14, 0.03, 0]), beliefs, Caution(0.03))
        spent.append(time.process_time() - begin)
    assert np.median(spent) < 0.005  # 0.0007 on a quiet machine


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"point": [0, 0, np.nan]}, "point"),
        ({"normal": [0, 0, 0]}, "normal"),
        ({"axis": [1, 0.1, 0]}, "axis"),
        ({"radius": np.inf}, "radius"),
        ({"sigma_radius": -1.0}, "sigma_radius"),
        ({"sigma_point": np.inf}, "sigma_point"),
    ],
)
def test_beliefs_that_are_refused(change: dict, message: str) -> None:
    good = {"point": [0.05, 0, 0], "normal": [1, 0, 0], "axis": [0, 0, 1], "radius": 0.05}
    with pytest.raises(InvalidInput, match=message):
        ArcBelief(**(good | change))


def test_cautions_positions_and_speeds_that_are_refused() -> None:
    with pytest.raises(InvalidInput, match="clearance"):
        Caution(0.0)
    with pytest.raises(InvalidInput, match="k is"):
        Caution(0.03, k=-1)
    with pytest.raises(InvalidInput, match="goal"):
        plan_arc(np.zeros(3), np.array([0, 0, np.nan]), [], Caution(0.03))
    with pytest.raises(InvalidInput, match="speed"):
        next_velocity(np.zeros(3), np.zeros((2, 3)), 0.0, 0.1)
