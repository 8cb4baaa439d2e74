"""Tasks: gymnasium environments around the estimator, planners and policies, scored against ground truth.

Importing this package registers `extremal/Inspect-v0`, `extremal/Navigate-v0` and `extremal/Grasp-v0`: `gymnasium.make("extremal.tasks:extremal/Navigate-v0")`.
"""

import gymnasium

ENVIRONMENTS = {
    "extremal/Grasp-v0": "extremal.tasks.grasp:GraspEnv",
    "extremal/Inspect-v0": "extremal.tasks.inspect:InspectEnv",
    "extremal/Navigate-v0": "extremal.tasks.navigate:NavigateEnv",
}

for _name, _entry in ENVIRONMENTS.items():
    if _name not in gymnasium.registry:
        gymnasium.register(_name, _entry)
