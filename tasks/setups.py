"""What episodes start from, drawn from a seed and a tier: one kind of set-up a task."""

from extremal.tasks.grasp_setup import GraspSetup
from extremal.tasks.inspect_setup import InspectSetup, InspectTruth, inspect_truth
from extremal.tasks.level_string import Side
from extremal.tasks.navigate_setup import NavigateSetup

__all__ = ["GraspSetup", "InspectSetup", "InspectTruth", "NavigateSetup", "Side", "inspect_truth"]
