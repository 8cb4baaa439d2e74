"""What a policy is, and how one is found by its name."""

import importlib
from collections.abc import Callable, Mapping
from typing import Any, Protocol

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from extremal.estimator.errors import InvalidInput
from extremal.tasks import plugins

GROUP = "extremal.policies"
CHOICES = ("obs_mode", "action_mode")


class Policy(Protocol):
    """Acts in one environment, one episode after the other.

    It may have an attribute `arguments`, a dict: the `obs_mode` and the `action_mode` that it wants.
    """

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
    """A baseline by its name, one that an installed package registers in the entry-point group `extremal.policies`, or one of your
    own as "module:Class". It is called without arguments.

    Raises InvalidInput where there is none of that name.
    """
    if not isinstance(name, str):
        raise InvalidInput(f"policy is {name!r}; accepted: a name")
    if name in baselines:
        return baselines[name]()
    registered, (module, colon, attribute) = plugins.offered(GROUP), name.partition(":")
    if name not in registered and not (module and colon):
        known = ", ".join([*baselines, *registered])
        raise InvalidInput(
            f"policy is {name!r}; accepted: {known} (entry points of the group {GROUP} included), or module:Class of your own"
        )
    try:
        own = name not in registered
        made = (getattr(importlib.import_module(module), attribute) if own else plugins.load(GROUP, name))()
    except (ImportError, AttributeError, TypeError) as error:
        raise InvalidInput(
            f"policy {name!r} can't be made: {error}; accepted: a class that needs no arguments"
        ) from None
    if not (callable(getattr(made, "reset", None)) and callable(getattr(made, "act", None))):
        raise InvalidInput(f"policy {name!r} is a {type(made).__name__}; accepted: one with reset and act")
    return made


def arguments_of(policy: Policy) -> dict[str, Any]:
    """How a policy wants to observe and to act: its attribute `arguments`, if it has one.

    Raises InvalidInput for other arguments of the environment than `CHOICES`: what is evaluated is not the policy's to choose.
    """
    wanted = dict(getattr(policy, "arguments", {}))
    for key in wanted:
        if key not in CHOICES:
            raise InvalidInput(f"a policy's arguments hold {key!r}; accepted: {', '.join(CHOICES)}")
    return wanted
