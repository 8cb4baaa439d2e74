"""Tasks: gymnasium environments around the estimator, planners and policies, scored against ground truth."""
