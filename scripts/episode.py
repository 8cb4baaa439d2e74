"""One episode of a task, shown: a film of it, its last picture, and its scores."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import cv2
import gymnasium as gym
import numpy as np
from rich.box import SIMPLE
from rich.console import Console
from rich.progress import track
from rich.table import Table

from extremal.estimator import InvalidInput
from extremal.scripts.episode_report import Look, episode_report
from extremal.scripts.output import output_folder
from extremal.sim.arm_errors import ArmName
from extremal.tasks.policies.baselines import ARGUMENTS, BASELINES
from extremal.tasks.policies.policy import arguments_of, load_policy

FRAMES_A_SECOND = 10


@dataclass(frozen=True)
class EpisodeSettings:
    """One episode: writes report.html, episode.mp4, episode.png and episode.json."""

    policy: str = "active"
    """random, oracle, active, parallax, absolute, blind, or module:Class of your own"""
    sensor: Literal["geometric", "rendered"] = "geometric"
    """exact contours with a model of edge errors, or frames through the vision pipeline"""
    tier: str = "standard-v0"
    """what the episode is drawn from"""
    arm: ArmName | None = None
    """replaces the tier's calibration"""
    seed: int = 1_000_000
    """of the episode; 1,000,000 and following are the test episodes"""
    out: Path = Path("out/episode")
    """folder that is written"""


def show_episode(task: str, settings: EpisodeSettings) -> None:
    """Run an episode of "Navigate" or "Grasp" and write it to `settings.out`."""
    if settings.seed < 0:
        raise InvalidInput(f"--seed is {settings.seed}; accepted: a whole number from 0")
    console = Console()
    policy = load_policy(settings.policy, BASELINES[task])
    env = gym.make(
        f"extremal.tasks:extremal/{task}-v0",
        render_mode="rgb_array",
        sensor=settings.sensor,
        tier=settings.tier,
        arm=settings.arm,
        **ARGUMENTS.get(task, {}),
        **arguments_of(policy),
    )
    try:
        looks, info = _run(env, policy, settings.seed, console)
        acted: Any = env.unwrapped
        frames = [look.picture for look in looks] + list(acted.afterwards())
    finally:
        env.close()
    scores = {name: float(value) for name, value in info.items()}
    table = _table(task, settings, scores)
    with output_folder(settings.out) as folder:
        _film(folder / "episode.mp4", frames)
        cv2.imwrite(str(folder / "episode.png"), cv2.cvtColor(frames[-1], cv2.COLOR_RGB2BGR))
        content = {"task": task, "policy": settings.policy, "seed": settings.seed, "scores": scores}
        (folder / "episode.json").write_text(json.dumps(content, indent=1) + "\n")
        report = episode_report(task, acted.scene, acted.camera, looks, table, asdict(settings))
        report.save(folder / "report.html")
    console.print(table)
    console.print(f"wrote {settings.out}/: report.html, episode.mp4, episode.png and episode.json")


def _table(task: str, settings: EpisodeSettings, scores: dict[str, float]) -> Table:
    table = Table(title=f"{task}, {settings.policy}, seed {settings.seed}", box=SIMPLE)
    table.add_column("score", no_wrap=True)
    table.add_column("value", justify="right")
    for name, value in scores.items():
        table.add_row(name, f"{value:.3g}")
    return table


def _run(
    env: gym.Env[Any, Any], policy: Any, seed: int, console: Console
) -> tuple[list[Look], dict[str, Any]]:
    """What was seen and known at each step of an episode, and its last info."""
    acted: Any = env.unwrapped

    def look() -> Look:
        return Look(acted.actual, acted.features, env.render())  # pyright: ignore[reportArgumentType]

    observation, info = env.reset(seed=seed)
    policy.reset(env, np.random.default_rng([seed, 3]))
    looks = [look()]
    for _ in track(range(acted.max_steps), "steps", console=console, transient=True):
        observation, _, terminated, truncated, info = env.step(policy.act(observation))
        looks.append(look())
        if terminated or truncated:
            break
    return looks, info


def _film(path: Path, frames: list[np.ndarray]) -> None:
    height, width = frames[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), FRAMES_A_SECOND, (width, height))
    if not writer.isOpened():
        raise InvalidInput("this OpenCV writes no MP4; accepted: opencv-python-headless from PyPI")
    for frame in frames:
        writer.write(cv2.cvtColor(frame, cv2.COLOR_RGB2BGR))
    writer.release()
