"""Train PPO to inspect: where to go, and when enough was seen. Needs `pip install "extremal[rl]"`.

    python docs/examples/ppo_inspect.py --steps 4096 --workers 2 --out out/ppo

The agent decides every half second how fast to go on sideways, and whether to answer now. The camera keeps the object in its
middle, and the estimator answers. Trained on training seeds, compared with random decisions on test seeds.
"""

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch
import tyro
from numpy.typing import NDArray
from rich.progress import track
from stable_baselines3 import PPO
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv

from extremal.tasks.metrics import bootstrap_interval, wilson_interval
from extremal.tasks.policies.navigation import best, pose_of, steered
from extremal.tasks.question import AHEAD
from extremal.tasks.spaces import SPEED, SeenFeatures
from extremal.tasks.tiers import TEST_SEEDS, TRAIN_SEEDS

HOLD = 5  # steps of the environment a decision
WAY = 0.4  # [m] by which displacements are divided


class Decisions(gym.Wrapper[Any, Any, Any, Any], gym.utils.RecordConstructorArgs):
    """Flat observations and two actions, of episodes from the training seeds.

    Action `Box((2,))`: speed to the contour's side (-1: none, 1: full), answer now (above 0.5). Observation `Box((10,))`: the way
    from the start, in the first camera's frame (3); time; the query (2); and of the best known feature on the contour asked
    about: whether there is one, R, sigma (logarithmic), looks.
    """

    def __init__(self, env: gym.Env[Any, Any], seed: int = 0) -> None:
        gym.utils.RecordConstructorArgs.__init__(self, seed=seed)
        gym.Wrapper.__init__(self, env)
        self.action_space = gym.spaces.Box(-1.0, 1.0, (2,), np.float32)
        self.observation_space = gym.spaces.Box(-5.0, 5.0, (10,), np.float32)
        self._rng = np.random.default_rng(seed)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        if seed is None:
            seed = int(self._rng.choice(TRAIN_SEEDS))
        else:
            self._rng = np.random.default_rng(seed)  # of the episodes that follow
        observation, info = self.env.reset(seed=seed, options=options)
        self._start = self._pose = pose_of(observation)
        side = 1.0 if observation["query"][0] > 0.5 else -1.0
        self._sideways = side * SPEED * self._start.rotation.apply([1.0, 0.0, 0.0])
        return self._flat(observation), info

    def step(self, action: NDArray[np.floating]):
        speed, answer = np.clip(np.asarray(action, float), -1, 1)
        velocity = (speed + 1) / 2 * self._sideways
        total, held = 0.0, 0
        while True:
            held += 1
            motion = steered(self._pose, velocity, self._start.apply([0.0, 0.0, AHEAD]))
            now = 1.0 if answer > 0.5 and held == HOLD else -1.0
            observation, reward, ended, truncated, info = self.env.step(np.append(motion, now))
            self._pose, total = pose_of(observation), total + float(reward)
            if ended or truncated or held == HOLD:
                return self._flat(observation), total, ended, truncated, info

    def _flat(self, observation: dict[str, Any]) -> NDArray[np.float32]:
        seen = SeenFeatures.of(observation)
        radius, sigma = best(seen)
        sigma = np.where(observation["target"][: len(sigma)] > 0, np.minimum(sigma, 1.0), 1.0)
        known = np.zeros(4)
        if len(sigma) and sigma.min() < 1.0:
            i = int(np.argmin(sigma))
            known = np.array([1.0, radius[i] / 0.1, -1 - np.log10(sigma[i]), seen.looks[i] / 40])
        way = self._start.inv().apply(self._pose.translation) / WAY
        flat = np.concatenate([way, observation["time"], observation["query"], known])
        return np.clip(flat, -5, 5).astype(np.float32)


@dataclass(frozen=True)
class Settings:
    steps: int = 4096
    """decisions to train on"""
    workers: int = 2
    """processes"""
    episodes: int = 100
    """test episodes, of the agent and of random decisions"""
    seed: int = 0
    out: Path = Path("out/ppo")
    """folder of the model"""


def decisions(seed: int) -> Decisions:
    return Decisions(gym.make("extremal.tasks:extremal/Inspect-v0", sensor="geometric", max_steps=80), seed)


def monitored(seed: int) -> gym.Env[Any, Any]:
    return Monitor(decisions(seed))


def train(settings: Settings) -> PPO:
    makers = [partial(monitored, settings.seed + i) for i in range(settings.workers)]
    envs = SubprocVecEnv(makers, start_method="spawn") if settings.workers > 1 else DummyVecEnv(makers)
    try:
        agent = PPO(
            "MlpPolicy", envs, n_steps=256 // settings.workers, batch_size=64, n_epochs=10, gamma=1.0, ent_coef=0.003,
            learning_rate=1e-3, policy_kwargs={"net_arch": [32, 32], "log_std_init": -0.5}, seed=settings.seed, device="cpu",
        )  # fmt: skip
        return agent.learn(settings.steps, progress_bar=True)
    finally:
        envs.close()


def tested(agent: PPO | None, settings: Settings) -> str:
    """Success and reward over test episodes, with 95 % intervals; of random decisions where there is no agent."""
    env, rng = decisions(0), np.random.default_rng(settings.seed)
    success, rewards = [], []
    for seed in track(TEST_SEEDS[: settings.episodes], "random" if agent is None else "PPO"):
        observation, info = env.reset(seed=seed)
        total, ended = 0.0, False
        while not ended:
            action = agent.predict(observation, deterministic=True)[0] if agent else rng.uniform(-1, 1, 2)
            observation, reward, done, truncated, info = env.step(action)
            total, ended = total + reward, done or truncated
        success.append(bool(info["is_success"]))
        rewards.append(total)
    env.close()
    low, high = wilson_interval(sum(success), len(success))
    least, most = bootstrap_interval(rewards, np.random.default_rng(0))
    return (
        f"success {100 * np.mean(success):.0f} % ({100 * low:.0f} to {100 * high:.0f} %), "
        f"reward {np.mean(rewards):.3f} ({least:.3f} to {most:.3f})"
    )


def main(settings: Settings) -> None:
    torch.set_num_threads(1)
    agent = train(settings)
    settings.out.mkdir(parents=True, exist_ok=True)
    agent.save(settings.out / "ppo_inspect")
    print("random:", tested(None, settings))
    print("PPO:   ", tested(agent, settings))


if __name__ == "__main__":
    main(tyro.cli(Settings))
