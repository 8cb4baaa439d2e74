"""How well a policy does: episodes of the test seeds, each by itself, and their summary."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import gymnasium as gym
import numpy as np

from extremal.estimator.errors import InvalidInput, is_whole
from extremal.sim.arm_errors import ARMS
from extremal.tasks import ENVIRONMENTS
from extremal.tasks.metrics import bootstrap_interval, wilson_interval
from extremal.tasks.policies.baselines import ARGUMENTS, BASELINES
from extremal.tasks.policies.policy import arguments_of, load_policy
from extremal.tasks.sensors import SENSORS
from extremal.tasks.tiers import TEST_SEEDS, get_tier

NOT_METRICS = ("is_success",)


@dataclass(frozen=True)
class Evaluation:
    """What is evaluated. Two that are equal give the same numbers.

    Attributes:
        env: "Inspect", "Navigate" or "Grasp". policy: see `load_policy`.
        episodes: number; episode i has the seed `TEST_SEEDS[seed + i]`.
        sensor, tier, arm: see `ActiveVisionEnv`.

    Raises InvalidInput for an unknown name, and for more episodes than there are test seeds.
    """

    env: str
    policy: str
    episodes: int
    sensor: str = "geometric"
    tier: str = "standard-v0"
    arm: str | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        names = [name.split("/")[1].split("-")[0] for name in ENVIRONMENTS]
        for key, accepted in (("env", names), ("sensor", SENSORS), ("arm", (None, *ARMS))):
            if getattr(self, key) not in accepted:
                raise InvalidInput(
                    f"{key} is {getattr(self, key)!r}; accepted: {', '.join(str(a) for a in accepted if a)}"
                )
        get_tier(self.tier)
        for key in ("episodes", "seed"):
            if not is_whole(getattr(self, key)):
                raise InvalidInput(f"{key} is {getattr(self, key)!r}; accepted: a whole number")
        arguments_of(load_policy(self.policy, BASELINES[self.env]))
        if self.episodes < 1 or self.seed < 0 or self.seed + self.episodes > len(TEST_SEEDS):
            raise InvalidInput(
                f"episodes {self.seed} to {self.seed + self.episodes - 1} are asked for; accepted: 0 to {len(TEST_SEEDS) - 1}"
            )

    @property
    def key(self) -> str:
        """Of everything that an episode's result depends on, but its number."""
        values = {k: v for k, v in asdict(self).items() if k not in ("episodes", "seed")}
        return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()[:12]

    @property
    def seeds(self) -> range:
        return TEST_SEEDS[self.seed : self.seed + self.episodes]


def run_episode(
    evaluation: Evaluation, seed: int, options: Mapping[str, Any] | None = None
) -> dict[str, float]:
    """The last `info` of an episode, its steps and the sum of its rewards; `options` replace fields of its tier."""
    policy = load_policy(evaluation.policy, BASELINES[evaluation.env])
    env = gym.make(
        f"extremal.tasks:extremal/{evaluation.env}-v0",
        sensor=evaluation.sensor,
        tier=evaluation.tier,
        arm=evaluation.arm,
        **ARGUMENTS.get(evaluation.env, {}),
        **arguments_of(policy),
    )
    try:
        observation, info = env.reset(seed=seed, options=None if options is None else dict(options))
        policy.reset(env, np.random.default_rng([seed, 3]))
        total, ended = 0.0, False
        while not ended:
            observation, reward, terminated, truncated, info = env.step(policy.act(observation))
            total, ended = total + float(reward), terminated or truncated
        return {name: float(value) for name, value in info.items()} | {"return": total}
    finally:
        env.close()


def summary(evaluation: Evaluation, results: list[dict[str, float]]) -> dict[str, Any]:
    """What evaluation.json holds: success with its interval (Wilson), medians and percentiles of everything else, what was
    evaluated, and the outcome of each episode (1: success).

    Raises InvalidInput for no results.
    """
    if not results:
        raise InvalidInput("no episode to summarise; accepted: the results of one or more")
    successes = int(sum(result["is_success"] for result in results))
    names = sorted({name for result in results for name in result} - {*NOT_METRICS})
    return {
        "env": evaluation.env,
        "policy": evaluation.policy,
        "episodes": len(results),
        "success_rate": successes / len(results),
        "success_ci95": list(wilson_interval(successes, len(results))),
        "metrics": {name: _spread([result.get(name, np.nan) for result in results]) for name in names},
        "sensor": evaluation.sensor,
        "tier": evaluation.tier,
        "arm": evaluation.arm,
        "seed": evaluation.seed,
        "outcomes": "".join(str(int(result["is_success"])) for result in results),
    }


def _spread(values: list[float]) -> dict[str, float | list[float] | None]:
    """Of the values that are known (a path ratio is known on success only); null where none is."""
    known = np.array(values, float)
    known = known[np.isfinite(known)]
    if len(known) == 0:
        return {"median": None, "p05": None, "p95": None, "mean": None, "mean_ci95": None}
    low, high = (
        bootstrap_interval(known, np.random.default_rng(0)) if len(known) > 1 else (known[0], known[0])
    )
    p05, median, p95 = np.percentile(known, [5, 50, 95])
    return {
        "median": float(median),
        "p05": float(p05),
        "p95": float(p95),
        "mean": float(known.mean()),
        "mean_ci95": [float(low), float(high)],
    }
