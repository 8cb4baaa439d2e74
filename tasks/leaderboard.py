"""Policies beside each other: success from 0, the random policy's, to 1, that of the one that knows the truth.

The score is (success - random) / (oracle - random). Its interval is a percentile bootstrap (Efron and Tibshirani 1993,
sec. 13.3) in which episodes are drawn by their seeds, for all three policies alike: what they have in common, the difficulty of
an episode, stays so, and the uncertainty of both references is in the score's.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from extremal.estimator.files import write_whole
from extremal.tasks.metrics import normalised_score

SETTING = ("env", "tier", "sensor", "arm")
RESAMPLES = 2000
# medians that tell more than success, where an environment has them
METRICS = ("path_ratio", "regret", "spl", "negative_log_likelihood", "path_length_m")

Row = dict[str, Any]


def leaderboard(path: Path, found: Row) -> list[Row]:
    """The table of a file with one more evaluation in it, in place of an older one of the same; the file is written.

    Args:
        path: of a JSON file, which need not be there yet.
        found: what `summary` of an evaluation returned.

    Returns a row a policy and setting: `score` and `score_ci95` are None until random and oracle are in the table for the same
    setting; `outcomes` holds a 1 or 0 for each episode, that of the test seed numbered `seed` first.
    """
    rows: list[Row] = json.loads(path.read_text()) if path.exists() else []
    same = ("policy", *SETTING)
    rows = [row for row in rows if any(row[k] != found[k] for k in same)]
    kept = ("episodes", "seed", "success_rate", "success_ci95", "outcomes")
    medians = {name: found["metrics"][name]["median"] for name in METRICS if name in found["metrics"]}
    rows.append({k: found[k] for k in (*same, *kept)} | {"median": medians})
    for row in rows:
        row["score"], row["score_ci95"] = _score(
            row, [r for r in rows if all(r[k] == row[k] for k in SETTING)]
        )
    rows.sort(key=lambda row: (*(str(row[k]) for k in SETTING), -row["success_rate"]))
    write_whole(path, json.dumps(rows, indent=1))
    return rows


def _score(row: Row, setting: Sequence[Row]) -> tuple[float | None, list[float] | None]:
    """Score of a row of a setting, and its interval; None without references that differ."""
    named = {other["policy"]: other for other in setting}
    if not ("random" in named and "oracle" in named):
        return None, None
    three = [row, named["random"], named["oracle"]]
    mine, random, oracle = (float(r["success_rate"]) for r in three)
    if not oracle > random:
        return None, None
    low, high = score_interval(*(_by_seed(r) for r in three), rng=np.random.default_rng(0))
    return float(normalised_score(mine, random, oracle)), [low, high] if np.isfinite(low) else None


def _by_seed(row: Row) -> dict[int, float]:
    return {row["seed"] + i: float(outcome) for i, outcome in enumerate(row["outcomes"])}


def score_interval(
    policy: dict[int, float],
    random: dict[int, float],
    oracle: dict[int, float],
    rng: np.random.Generator,
    confidence: float = 0.95,
) -> tuple[float, float]:
    """Percentile bootstrap interval of (policy - random) / (oracle - random).

    Resamples in which a policy has no episode, or oracle is not above random, are left out.

    Args:
        policy, random, oracle: scores by seed; paired where the seeds are the same, at least one each.
        rng: source of the resamples.
        confidence: between 0 and 1.
    """
    seeds = sorted({*policy, *random, *oracle})
    drawn = rng.multinomial(len(seeds), np.full(len(seeds), 1 / len(seeds)), size=RESAMPLES)
    mine, low, high = (_means(scores, seeds, drawn) for scores in (policy, random, oracle))
    known = np.isfinite(mine) & (high > low)
    if not known.any():
        return float("nan"), float("nan")
    values = (mine - low)[known] / (high - low)[known]
    first, last = np.quantile(values, [(1 - confidence) / 2, (1 + confidence) / 2])
    return float(first), float(last)


def _means(
    scores: dict[int, float], seeds: Sequence[int], drawn: NDArray[np.integer]
) -> NDArray[np.floating]:
    """Means (B,) over the seeds of B resamples, `drawn` (B, n) times each; NaN where none has a score."""
    has = np.array([seed in scores for seed in seeds])
    values = np.array([scores.get(seed, 0.0) for seed in seeds])
    count = drawn[:, has].sum(axis=1)
    return np.where(count > 0, drawn[:, has] @ values[has] / np.maximum(count, 1), np.nan)
