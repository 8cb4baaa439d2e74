"""The baselines of every environment by their names."""

from collections.abc import Callable
from typing import Any

from extremal.tasks.policies import grasping, inspection, navigation
from extremal.tasks.policies.policy import Policy

BASELINES: dict[str, dict[str, Callable[[], Policy]]] = {
    "Inspect": inspection.BASELINES,
    "Navigate": navigation.BASELINES,
    "Grasp": grasping.BASELINES,
}
# what every policy of an environment is given to decide
ARGUMENTS: dict[str, dict[str, Any]] = {"Inspect": {"answer": "policy"}}
