"""Episodes of a policy, recorded one by one, and as a Minari dataset, for learning from records (extra `minari`)."""

import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np

from extremal.estimator.errors import ExtremalError, InvalidInput
from extremal.tasks.episode_files import Episode, EpisodeFolder
from extremal.tasks.policies.policy import Policy

if TYPE_CHECKING:
    from minari import MinariDataset  # pyright: ignore[reportMissingImports]
    from minari.data_collector import EpisodeBuffer  # pyright: ignore[reportMissingImports]

ROOT = "MINARI_DATASETS_PATH"


class MinariMissing(ExtremalError, ImportError):
    """The package that writes datasets is not installed."""


def record_episodes(
    env: gym.Env[Any, Any], policy: Policy, seeds: Iterable[int], folder: Path
) -> Iterator[int]:
    """Run a policy for an episode of each seed that the folder doesn't hold; gives the seeds as their episodes are kept.

    An episode whose seed was given stays, and starting again goes on, whatever was killed. Several processes may record to one
    folder at a time.

    Args:
        env: made by `gymnasium.make`, so that the dataset tells how to make it again.
        seeds: of the episodes: `TRAIN_SEEDS`, for what is learned from.
        folder: of this policy in this environment alone.

    Raises InvalidInput where the folder can't be written, or holds episodes of something else.
    """
    kept = EpisodeFolder(folder, env, policy)
    for seed in seeds:
        if not kept.has(seed):
            kept.keep(seed, _episode(env, policy, seed))
        yield seed


def record(
    env: gym.Env[Any, Any],
    policy: Policy,
    seeds: Sequence[int],
    dataset_id: str,
    folder: Path,
    **about: Any,
) -> "MinariDataset":
    """Record as `record_episodes` does, and write the episodes to the dataset `dataset_id`, which must be new.

    Observations, actions, rewards and how episodes end are kept; pictures without loss; of `info` whether the task is done,
    `is_success`. Minari keeps datasets where its MINARI_DATASETS_PATH says; this one appears there whole or not at all.

    Args:
        dataset_id: "navigate/active-v0" for instance.
        about: `author`, `description`, ...: see `minari.create_dataset_from_buffers`.

    Raises:
        MinariMissing: Minari is not installed.
        InvalidInput: there is a dataset of that name, or it is no name, or there are no seeds; and as `record_episodes`.
    """
    try:
        import minari  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise MinariMissing(
            "recording needs Minari, which is not installed: pip install 'extremal[minari]'"
        ) from None
    if dataset_id in minari.list_local_datasets():
        raise InvalidInput(f"dataset is {dataset_id!r}, which is there already; accepted: a new name")
    if len(seeds) == 0:
        raise InvalidInput("seeds are empty; accepted: one or more")
    done = list(record_episodes(env, policy, seeds, folder))
    kept = EpisodeFolder(folder, env, policy)
    episodes = [_buffer(kept.load(seed), seed, i) for i, seed in enumerate(done)]
    try:
        with _aside(dataset_id):
            minari.create_dataset_from_buffers(
                dataset_id, buffer=episodes, env=env, jpeg_encoding=False, **about
            )
    except ValueError as error:
        raise InvalidInput(f"dataset is {dataset_id!r}, which Minari refuses: {error}") from None
    return minari.load_dataset(dataset_id)


@contextmanager
def _aside(dataset_id: str) -> Iterator[None]:
    """Have Minari write a dataset to a hidden folder, and put it in its place when all went well."""
    from minari.namespace import create_namespace, list_local_namespaces  # pyright: ignore[reportMissingImports]
    from minari.storage.datasets_root_dir import get_dataset_path  # pyright: ignore[reportMissingImports]

    place, before = get_dataset_path(dataset_id), os.environ.get(ROOT)
    hidden = Path(tempfile.mkdtemp(prefix=".recording-", dir=get_dataset_path()))
    try:
        os.environ[ROOT] = str(hidden)
        try:
            yield
        finally:
            if before is None:
                del os.environ[ROOT]
            else:
                os.environ[ROOT] = before
        namespace = dataset_id.rpartition("/")[0]
        if namespace and namespace not in list_local_namespaces():
            create_namespace(namespace)
        place.parent.mkdir(parents=True, exist_ok=True)
        (hidden / dataset_id).rename(place)
    finally:
        shutil.rmtree(hidden, ignore_errors=True)


def _episode(env: gym.Env[Any, Any], policy: Policy, seed: int) -> Episode:
    """What happens in the episode of a seed."""
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
    return Episode(
        _in_columns(observations),
        np.array(actions),
        np.array(rewards),
        np.array(ended[1:]),
        np.array(truncated[1:]),
        np.array([bool(each["is_success"]) for each in infos]),
    )


def _in_columns(rows: list[Mapping[str, Any]]) -> dict[str, np.ndarray]:
    return {name: np.stack([row[name] for row in rows]) for name in rows[0]}


def _buffer(episode: Episode, seed: int, number: int) -> "EpisodeBuffer":
    """An episode as Minari takes it."""
    from minari.data_collector import EpisodeBuffer  # pyright: ignore[reportMissingImports]

    return EpisodeBuffer(
        id=number,
        seed=seed,
        observations={name: list(values) for name, values in episode.observations.items()},
        actions=list(episode.actions),
        rewards=episode.rewards.tolist(),
        terminations=episode.terminations.tolist(),
        truncations=episode.truncations.tolist(),
        infos={"is_success": episode.is_success.tolist()},
    )
