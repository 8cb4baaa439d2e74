"""What a policy is, and how one is found by its name."""

import importlib
from collections.abc import Callable, Mapping
from typing import Any, Protocol

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from extremal.estimator.errors import InvalidInput


class Policy(Protocol):
    """Acts in one environment, one episode after the other."""

    def reset(self, env: gym.Env[Any, Any], rng: np.random.Generator) -> None:
        """A new episode begins; `rng` is the only randomness. Only an oracle looks into `env.unwrapped.setup`."""
        ...

    def act(self, observation: Mapping[str, Any]) -> NDArray[np.floating]:
        """The next action."""
        ...


class RandomPolicy:
    """Any action of the space."""

    def reset(self, env: gym.Env[Any, Any], rng: np.random.Generator) -> None:
        self._space, self._rng = env.action_space, rng

    def act(self, observation: Mapping[str, Any]) -> NDArray[np.floating]:
        return self._rng.uniform(self._space.low, self._space.high)  # pyright: ignore[reportAttributeAccessIssue]


def load_policy(name: str, baselines: Mapping[str, Callable[[], Policy]]) -> Policy:
    """A baseline by its name, or one of your own as "module:Class" (called without arguments).

    Raises InvalidInput where there is none of that name.
    """
    if name in baselines:
        return baselines[name]()
    if ":" not in name:
        raise InvalidInput(
            f"policy is {name!r}; accepted: {', '.join(baselines)}, or module:Class of your own"
        )
    module, _, attribute = name.partition(":")
    try:
        made = getattr(importlib.import_module(module), attribute)()
    except (ImportError, AttributeError, TypeError) as error:
        raise InvalidInput(f"policy {name!r} can't be made: {error}") from None
    if not (callable(getattr(made, "reset", None)) and callable(getattr(made, "act", None))):
        raise InvalidInput(f"policy {name!r} is a {type(made).__name__}; accepted: one with reset and act")
    return made
