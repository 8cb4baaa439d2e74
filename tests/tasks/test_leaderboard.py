"""Scores and their intervals: paired by seed, in the file and against a closed form."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from extremal.tasks.leaderboard import leaderboard, score_interval


def found(policy: str, outcomes: str, **more: Any) -> dict[str, Any]:
    rate = outcomes.count("1") / len(outcomes)
    return {
        "env": "Grasp", "policy": policy, "sensor": "geometric", "tier": "t", "arm": None, "seed": 0,
        "episodes": len(outcomes), "success_rate": rate, "success_ci95": [0.0, 1.0], "outcomes": outcomes,
        "metrics": {"path_ratio": {"median": 1.1}, "steps": {"median": 3.0}},
    } | more  # fmt: skip


def test_a_row_is_replaced_and_scored_once_its_references_are_there(tmp_path: Path) -> None:
    path = tmp_path / "leaderboard.json"
    for outcomes in ("1100", "1110"):
        rows = leaderboard(path, found("x", outcomes))
    assert len(rows) == 1 and rows[0]["success_rate"] == 0.75
    assert rows[0]["score"] is None and rows[0]["score_ci95"] is None
    assert rows[0]["median"] == {"path_ratio": 1.1}
    leaderboard(path, found("random", "0000", tier="another"))
    leaderboard(path, found("oracle", "1111"))
    rows = {row["policy"]: row for row in leaderboard(path, found("random", "0100")) if row["tier"] == "t"}
    assert rows["x"]["score"] == pytest.approx((0.75 - 0.25) / 0.75)
    assert rows["oracle"]["score"] == 1 and rows["random"]["score"] == 0
    low, high = rows["x"]["score_ci95"]
    assert low <= rows["x"]["score"] <= high


def test_an_interval_is_that_of_a_rate_where_the_references_are_sure() -> None:
    """Random never, oracle always: the score is the rate, whose standard deviation is known."""
    n, rate = 400, 0.7
    outcomes = dict(enumerate((np.arange(n) < rate * n).astype(float)))
    low, high = score_interval(
        outcomes, dict.fromkeys(range(n), 0.0), dict.fromkeys(range(n), 1.0), np.random.default_rng(1)
    )
    deviation = np.sqrt(rate * (1 - rate) / n)
    assert (high - low) / (2 * 1.96 * deviation) == pytest.approx(1, abs=0.1)
    assert (high + low) / 2 == pytest.approx(rate, abs=0.3 * deviation)


def test_episodes_are_paired() -> None:
    """A policy that fails where the oracle fails scores 1 for certain, whichever episodes are drawn."""
    outcomes = {seed: float(seed % 3 > 0) for seed in range(60)}
    never = dict.fromkeys(range(60), 0.0)
    assert score_interval(outcomes, never, outcomes, np.random.default_rng(0)) == (1.0, 1.0)
    few = {seed: 0.0 for seed in range(20)}  # references of fewer episodes will do
    low, high = score_interval(outcomes, few, outcomes, np.random.default_rng(0))
    assert (low, high) == (1.0, 1.0)


def test_references_that_do_not_differ_give_no_interval() -> None:
    same = dict.fromkeys(range(5), 1.0)
    assert np.isnan(score_interval(same, same, same, np.random.default_rng(0))).all()
