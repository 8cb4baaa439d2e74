"""How fast the environments step: numbers for the record, none of them passes or fails a test."""

import time

import gymnasium as gym
import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

import extremal.tasks  # noqa: F401  registers the environments

pytestmark = pytest.mark.slow

SEEDS, STEPS = range(500_000, 500_006), 60
NAMES = ("Navigate", "Inspect", "Grasp")


def action(env: gym.Env, policy: str, step: int, rng: np.random.Generator) -> np.ndarray:
    """Any motion, or a sweep to and fro along the world's y at the highest speed; no answer and no grasp."""
    space = env.action_space
    assert isinstance(space, gym.spaces.Box)
    values = rng.uniform(space.low, space.high)
    if policy == "sweep":
        values[:6] = 0.0
        values[1] = 1.0 if step // 20 % 2 == 0 else -1.0
    if len(values) > 6:
        values[6] = -1.0
    return values


def seconds(name: str, policy: str, sensor: str) -> np.ndarray:
    """Time (n,) of the steps of a few episodes; resets are left out."""
    env = gym.make(f"extremal/{name}-v0", sensor=sensor, disable_env_checker=True)
    spent = []
    for seed in SEEDS:
        env.reset(seed=seed)
        rng = np.random.default_rng(seed)
        for step in range(STEPS):
            wanted = action(env, policy, step, rng)
            started = time.perf_counter()
            _, _, ended, cut, _ = env.step(wanted)
            spent.append(time.perf_counter() - started)
            if ended or cut:
                break
    env.close()
    return np.array(spent)


@pytest.mark.parametrize("sensor", ["geometric", "rendered"])
@pytest.mark.parametrize("policy", ["random", "sweep"])
@pytest.mark.parametrize("name", NAMES)
def test_features(benchmark: BenchmarkFixture, name: str, policy: str, sensor: str) -> None:
    """To be at least 1000 steps a second of a process on idle cores with the geometric sensor, 25 with the rendered one."""
    spent = benchmark.pedantic(seconds, (name, policy, sensor), rounds=1, warmup_rounds=1)
    benchmark.extra_info["steps_per_second"] = len(spent) / float(spent.sum())
    benchmark.extra_info["median_ms"] = 1e3 * float(np.median(spent))
    benchmark.extra_info["slowest_ms"] = 1e3 * float(spent.max())
    assert len(spent) >= len(SEEDS)
