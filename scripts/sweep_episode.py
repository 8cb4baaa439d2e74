"""A trial that acts: one episode of a policy in a task, as `extremal evaluate` runs it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from extremal.estimator.errors import InvalidInput
from extremal.scripts.sweep_trials import Value
from extremal.sim.arm_errors import ArmName
from extremal.tasks.evaluation import Evaluation, run_episode
from extremal.tasks.tiers import Crease, Looks, get_tier

WITHHELD = ()
FILES = ()
FIRST = 2_000_000  # episodes that neither training nor the test of `extremal evaluate` uses
OPTIONS = ("arm_bias", "arm_noise", "edge_noise", "crease", "appearance", "clutter")


@dataclass(frozen=True)
class Settings:
    """Attributes: env, policy, sensor, tier and arm as for `extremal evaluate`; the seed of the episode, by default the trial's own:
    a grid or draw of it has all else compared on the same episodes; and what replaces fields of the tier."""

    env: Literal["Inspect", "Navigate", "Grasp"] = "Navigate"
    policy: str = "active"
    sensor: Literal["geometric", "rendered"] = "geometric"
    tier: str = "standard-v0"
    arm: ArmName | None = None
    episode: int | None = None
    arm_bias: ArmName | None = None
    arm_noise: ArmName | None = None
    edge_noise: float | None = None
    crease: Crease | None = None
    appearance: Looks | None = None
    clutter: int | None = None

    def __post_init__(self) -> None:
        if self.episode is not None and self.episode < 0:
            raise InvalidInput(f"episode is {self.episode}; accepted: a whole number from 0")
        get_tier(self.tier).with_options(self.options)
        self.evaluation  # noqa: B018  raises for unknown names

    @property
    def evaluation(self) -> Evaluation:
        """Of one episode."""
        return Evaluation(self.env, self.policy, 1, self.sensor, self.tier, self.arm)

    @property
    def options(self) -> dict[str, object]:
        """What replaces fields of the tier."""
        own = {name: getattr(self, name) for name in OPTIONS}
        return {name: value for name, value in own.items() if value is not None}


def run(settings: Settings, seed: int) -> Mapping[str, Value]:
    """The last `info` of the episode, its steps and the sum of its rewards."""
    number = FIRST + seed % 2**31 if settings.episode is None else settings.episode
    found: dict[str, Value] = dict(run_episode(settings.evaluation, number, settings.options))
    return found | {"episode_seed": number, "is_success": bool(found["is_success"])}
