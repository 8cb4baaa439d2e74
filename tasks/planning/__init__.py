"""Planners: from beliefs about what was seen to motions, without ground truth."""
