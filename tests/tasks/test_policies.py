"""Baselines do what they are for, on episodes that nothing was tuned to; `evaluate` writes what it says."""

import json
from pathlib import Path

import numpy as np
import pytest

from extremal.estimator import InvalidInput
from extremal.scenes import Lathe
from extremal.scripts.evaluate import EvaluateSettings, evaluate
from extremal.tasks.answers import Answer, contact_from, crps, probability_extremal, quality
from extremal.tasks.evaluation import Evaluation, run_episode
from extremal.tasks.inspect_setup import InspectTruth
from extremal.tasks.policies.baselines import BASELINES
from extremal.tasks.policies.grasping import radius_around
from extremal.tasks.policies.policy import RandomPolicy, load_policy
from extremal.tasks.tiers import TRAIN_SEEDS

SEEDS = TRAIN_SEEDS[71_000:71_002]


@pytest.mark.parametrize("env", sorted(BASELINES))
def test_the_oracle_succeeds(env: str) -> None:
    for seed in SEEDS:
        assert run_episode(Evaluation(env, "oracle", 1), seed)["is_success"]


@pytest.mark.parametrize("env", sorted(BASELINES))
def test_the_active_policy_succeeds_where_robots_are_typical(env: str) -> None:
    results = [run_episode(Evaluation(env, "active", 1), seed) for seed in SEEDS]
    assert sum(result["is_success"] for result in results) >= 1
    assert all(0 <= result["return"] <= 1 + 1e-6 for result in results)


@pytest.mark.parametrize("env", sorted(BASELINES))
@pytest.mark.parametrize(
    "policy",
    ["random", "blind", *(pytest.param(p, marks=pytest.mark.slow) for p in ("parallax", "absolute"))],
)
def test_every_baseline_gets_through(env: str, policy: str) -> None:
    assert np.isfinite(run_episode(Evaluation(env, policy, 1), SEEDS[0])["return"])


def test_the_command_writes_its_files_and_takes_policies_of_ones_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "own_policy.py").write_text(
        "import numpy as np\n\nclass Still:\n"
        "    def reset(self, env, rng):\n        self.shape = env.action_space.shape\n"
        "    def act(self, observation):\n        return np.zeros(self.shape)\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    for policy in ("oracle", "random", "own_policy:Still"):
        evaluate(EvaluateSettings("Inspect", policy, 2, workers=1, out=tmp_path / "out"))
    found = json.loads((tmp_path / "out" / "evaluation.json").read_text())
    assert found["policy"] == "own_policy:Still" and found["success_rate"] == 0
    assert set(found) >= {"env", "policy", "episodes", "success_rate", "success_ci95", "metrics"}
    rows = {row["policy"]: row for row in json.loads((tmp_path / "out" / "leaderboard.json").read_text())}
    assert rows["oracle"]["score"] == 1 and rows["random"]["score"] == 0
    assert len(rows) == 3


def test_bad_names_are_named(tmp_path: Path) -> None:
    for values in (("Fly", "active", 1), ("Navigate", "clever", 1), ("Navigate", "nowhere:Policy", 1)):
        with pytest.raises(InvalidInput):
            Evaluation(*values)
    with pytest.raises(InvalidInput, match="accepted: 0 to 999"):
        Evaluation("Navigate", "random", 1001)
    with pytest.raises(InvalidInput, match="accepted: one with reset and act"):
        load_policy("builtins:dict", {"random": RandomPolicy})


# Answers.


def test_scores_are_proper() -> None:
    """Whoever believes R ~ N(40, 5) mm expects the best score by saying so."""
    rng = np.random.default_rng(0)
    values = 0.04 + 0.005 * rng.standard_normal(20_000)

    def mean(radius: float, sigma: float) -> float:
        return float(np.mean([crps(radius, sigma, value) for value in values[:4000]]))

    honest = mean(0.04, 0.005)
    for radius, sigma in ((0.04, 0.001), (0.04, 0.02), (0.046, 0.005), (0.034, 0.005)):
        assert mean(radius, sigma) > honest
    # the integral that defines it
    x = np.linspace(0, 0.1, 20_001)
    from scipy.stats import norm

    integral = np.trapezoid((norm.cdf((x - 0.04) / 0.005) - (x >= 0.047)) ** 2, x)
    assert crps(0.04, 0.005, 0.047) == pytest.approx(integral, rel=2e-3)


def test_a_contour_generator_slides_as_on_a_cylinder() -> None:
    """Tangents from two places to a circle of radius 50 mm, seen from 0.4 m away."""
    radius, centre = 0.05, np.array([0.0, 0.0, 0.1])

    def contact(eye: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        d = centre - eye
        bearing, angle = np.arctan2(d[1], d[0]), np.arccos(radius / np.linalg.norm(d))
        normal = np.array([np.cos(bearing + np.pi - angle), np.sin(bearing + np.pi - angle), 0.0])
        return centre + radius * normal, normal

    eyes = [np.array([-0.4, y, 0.1]) for y in (0.0, 0.15)]
    (first, normal), (second, _) = (contact(eye) for eye in eyes)
    both = contact_from(
        tuple(eyes[1].tolist()), np.array([first] * 2), np.array([normal] * 2), np.array([radius, 0.0])
    )
    np.testing.assert_allclose(both, [second, first], atol=1e-12)


@pytest.mark.parametrize("bend", [0.0, -2.5, 3.0], ids=["cone", "barrel", "waist"])
def test_level_sections_from_slanting_ones(bend: float) -> None:
    """Sections by planes of any slant, also against the normal, as they are where a track's arc has gone far round."""
    z, rng = np.linspace(0, 0.2, 21), np.random.default_rng(3)
    vase = Lathe(z, 0.05 + 0.1 * (z - 0.1) + bend * (z - 0.1) ** 2)
    height = np.linspace(0.06, 0.14, 9)
    r = vase.profile.derivatives(height)[0]
    position = np.stack([r, np.zeros(9), height], axis=1)
    normal = vase.normals(position)
    slant, lean = rng.uniform(-0.9, 0.9, (2, 9)) * [[1.0], [0.4]]
    along = np.cos(slant)[:, None] * [0.0, 1.0, 0.0] + np.sin(slant)[:, None] * np.cross(normal, [0, 1.0, 0])
    plane = np.cos(lean)[:, None] * np.cross(along, normal) + np.sin(lean)[:, None] * normal
    radius, level = (vase.section_radius(position, e) for e in (plane, np.tile([0, 0, 1.0], (9, 1))))
    found, sigma = radius_around(radius, np.full(9, 1e-6), position, normal, plane)
    np.testing.assert_allclose(found, level, rtol=2e-3)
    more, _ = radius_around(radius + 1e-6, np.full(9, 1e-6), position, normal, plane)
    np.testing.assert_allclose(more - found, sigma, rtol=1e-3)


def test_probability_of_an_extremal_boundary() -> None:
    assert probability_extremal(0.04, 0.001) > 0.999
    assert probability_extremal(0.0005, 0.001) < 0.1
    assert 0.2 < probability_extremal(0.0, 0.05) < 0.8  # nothing is known


def test_a_fixed_feature_called_one_is_worth_all() -> None:
    truth = InspectTruth("crease", np.zeros(3), np.array([1.0, 0, 0]), 0.0, True)
    assert quality(Answer(0.0, 0.0, 0.01, np.zeros(3)), truth) == 1
    assert quality(Answer(1.0, 0.05, 0.01, np.zeros(3)), truth) == 0
