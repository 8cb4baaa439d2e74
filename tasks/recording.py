"""Episodes of a policy as a Minari dataset, for learning from records. Needs the extra `minari`."""

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np

from extremal.estimator.errors import ExtremalError, InvalidInput
from extremal.tasks.policies.policy import Policy

if TYPE_CHECKING:
    from minari import MinariDataset
    from minari.data_collector import EpisodeBuffer


class MinariMissing(ExtremalError, ImportError):
    """The package that writes datasets is not installed."""


def record(
    env: gym.Env[Any, Any], policy: Policy, seeds: Iterable[int], dataset_id: str, **about: Any
) -> "MinariDataset":
    """Run a policy for an episode of each seed, and write them to the dataset `dataset_id`, which must be new.

    Observations, actions, rewards and how episodes end are kept; pictures without loss; of `info` whether the task is done,
    `is_success`. Minari keeps datasets where its MINARI_DATASETS_PATH says.

    Args:
        env: made by `gymnasium.make`, so that the dataset tells how to make it again.
        seeds: of the episodes: `TRAIN_SEEDS`, for what is learned from.
        dataset_id: "navigate/active-v0" for instance.
        about: `author`, `description`, ...: see `minari.create_dataset_from_buffers`.

    Raises:
        MinariMissing: Minari is not installed.
        InvalidInput: there is a dataset of that name, or it is no name, or there are no seeds.
    """
    try:
        import minari
    except ImportError:
        raise MinariMissing(
            "recording needs Minari, which is not installed: pip install 'extremal[minari]'"
        ) from None
    if dataset_id in minari.list_local_datasets():
        raise InvalidInput(f"dataset is {dataset_id!r}, which is there already; accepted: a new name")
    episodes = [_episode(env, policy, seed, i) for i, seed in enumerate(seeds)]
    if not episodes:
        raise InvalidInput("seeds are empty; accepted: one or more")
    try:
        return minari.create_dataset_from_buffers(
            dataset_id, buffer=episodes, env=env, jpeg_encoding=False, **about
        )
    except ValueError as error:
        raise InvalidInput(f"dataset is {dataset_id!r}, which Minari refuses: {error}") from None


def _episode(env: gym.Env[Any, Any], policy: Policy, seed: int, number: int) -> "EpisodeBuffer":
    """What happens in the episode of a seed."""
    from minari.data_collector import EpisodeBuffer

    observation, info = env.reset(seed=seed)
    policy.reset(env, np.random.default_rng([seed, 3]))
    observations, infos = [observation], [info]
    actions, rewards, ended, truncated = [], [], [False], [False]
    while not (ended[-1] or truncated[-1]):
        actions.append(np.asarray(policy.act(observation), env.action_space.dtype))
        observation, reward, over, out_of_time, info = env.step(actions[-1])
        observations.append(observation)
        infos.append(info)
        rewards.append(float(reward))
        ended.append(bool(over))
        truncated.append(bool(out_of_time))
    return EpisodeBuffer(
        id=number,
        seed=seed,
        observations=_in_columns(observations),
        actions=actions,
        rewards=rewards,
        terminations=ended[1:],
        truncations=truncated[1:],
        infos={"is_success": [bool(each["is_success"]) for each in infos]},
    )


def _in_columns(rows: list[Mapping[str, Any]]) -> dict[str, list[Any]]:
    return {name: [row[name] for row in rows] for name in rows[0]}
