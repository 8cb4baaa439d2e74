"""Recorded episodes on the disk: a file each, there whole or not at all, whatever is killed."""

import io
import json
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from extremal.estimator.errors import InvalidInput
from extremal.estimator.kept_files import keep_first

ABOUT = "recording.json"
SEEN = "observation/"  # how names of arrays begin that are observations


@dataclass(frozen=True, eq=False)
class Episode:
    """What happened in an episode of n steps.

    Attributes:
        observations: by name (n + 1, ...).
        actions: (n, ...). rewards: (n,). terminations, truncations: (n,) whether it ended, or ran out of time, with the step.
        is_success: (n + 1,) whether the task was done, after the reset and after each step.
    """

    observations: Mapping[str, NDArray[Any]]
    actions: NDArray[Any]
    rewards: NDArray[np.floating]
    terminations: NDArray[np.bool_]
    truncations: NDArray[np.bool_]
    is_success: NDArray[np.bool_]


ARRAYS = tuple(field.name for field in fields(Episode) if field.name != "observations")


class EpisodeFolder:
    """A folder of episodes of one policy in one environment, by their seeds."""

    def __init__(self, folder: Path, env: gym.Env[Any, Any], policy: object) -> None:
        """Open or make the folder; raises InvalidInput where it can't be written, or holds episodes of something else."""
        self._folder = folder
        kind = type(policy)
        about = {
            "env": env.spec.to_json() if env.spec else repr(env),
            "policy": f"{kind.__module__}:{kind.__qualname__}",
        }
        own = json.dumps(about, indent=1, sort_keys=True).encode()
        try:
            folder.mkdir(parents=True, exist_ok=True)
            keep_first(folder / ABOUT, own)
            found = (folder / ABOUT).read_bytes()
        except OSError as error:
            raise InvalidInput(
                f"folder {folder} can't be written: {error}; accepted: a writable folder"
            ) from None
        if found != own:
            raise InvalidInput(
                f"folder {folder} holds episodes of another environment or policy; accepted: a new one"
            )

    def has(self, seed: int) -> bool:
        """Whether the seed's episode is kept."""
        return self._path(seed).exists()

    def keep(self, seed: int, episode: Episode) -> None:
        """Keep an episode: when this returns, it stays. The first one of a seed wins."""
        arrays: dict[str, Any] = {name: getattr(episode, name) for name in ARRAYS}
        content = io.BytesIO()
        arrays |= {SEEN + name: values for name, values in episode.observations.items()}
        np.savez_compressed(content, **arrays)
        keep_first(self._path(seed), content.getvalue())

    def load(self, seed: int) -> Episode:
        """The episode of a seed. Raises InvalidInput where there is none, or the file is no episode."""
        path = self._path(seed)
        try:
            with path.open("rb") as file, np.load(file, allow_pickle=False) as found:
                seen = {k.removeprefix(SEEN): found[k] for k in found.files if k.startswith(SEEN)}
                return Episode(seen, *(found[name] for name in ARRAYS))
        except (OSError, ValueError, KeyError, EOFError, BadZipFile) as error:
            raise InvalidInput(f"{path} can't be read: {error}; accepted: an episode that was kept") from None

    def _path(self, seed: int) -> Path:
        return self._folder / f"{seed}.npz"
