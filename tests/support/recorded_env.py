"""A small environment to record, and a process that records it until it is killed."""

from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from extremal.tasks.policies.policy import RandomPolicy
from extremal.tasks.recording import record_episodes


class Walk(gym.Env[Any, Any]):
    """A random walk along a line, with a picture of noise; `episodes` counts the resets."""

    def __init__(self) -> None:
        self.action_space = gym.spaces.Box(-1.0, 1.0, (1,), np.float32)
        self.episodes = 0

    def __repr__(self) -> str:
        return "Walk"

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.episodes, self.place, self.steps = self.episodes + 1, 0.0, 0
        return self._observation(), {"is_success": False}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self.place += float(action[0])
        self.steps += 1
        there = abs(self.place) > 3
        return self._observation(), self.place, there, self.steps == 20, {"is_success": there}

    def _observation(self) -> dict[str, Any]:
        picture = self.np_random.integers(0, 256, (64, 64, 3), np.uint8)
        return {"place": np.array([self.place], np.float32), "picture": picture}


def run(folder: Path, connection: Connection) -> None:
    """Record episode after episode, and acknowledge each by its seed."""
    for seed in record_episodes(Walk(), RandomPolicy(), range(1_000_000), folder):
        connection.send(seed)
