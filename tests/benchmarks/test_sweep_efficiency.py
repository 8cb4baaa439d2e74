"""How much of two workers' time goes into trials: numbers for the record, none of them passes or fails a test."""

import json
import time
from functools import partial

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from extremal.scripts.sweep_config import read_config
from extremal.scripts.sweep_engine import run_locally
from extremal.scripts.sweep_trials import get_kind, run_trial

TRIALS, WORKERS = 60, 2


@pytest.mark.slow
def test_parallel_efficiency(benchmark: BenchmarkFixture) -> None:
    """Rate of two workers over twice that of one, once all have started; and the share of their time that is trials'."""
    trials = read_config({"kind": "estimate", "trials": TRIALS, "settings": {"views": 45}}).all_trials()
    rates = {}

    def measure() -> None:
        for workers in (1, WORKERS):
            ended, seconds = [], []
            outcomes = run_locally(run_trial, partial(get_kind, "estimate"), trials, workers, 600.0)
            for outcome in outcomes:
                assert outcome.result is not None
                ended.append(time.perf_counter())
                seconds.append(json.loads(outcome.result)["seconds"])
            first = TRIALS // 3
            wall = ended[-1] - ended[first]
            rates[workers] = (TRIALS - 1 - first) / wall
            benchmark.extra_info[f"busy_{workers}"] = sum(seconds[first + 1 :]) / (workers * wall)

    benchmark.pedantic(measure, rounds=1)
    benchmark.extra_info["efficiency"] = rates[WORKERS] / (WORKERS * rates[1])
