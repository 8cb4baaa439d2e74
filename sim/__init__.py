"""Scenes in, views out: the arm, its camera, its motion, its errors."""

from extremal.sim.frames import render_frames
from extremal.sim.kinematics import ArmKinematics, UnreachablePose
from extremal.sim.motion import LinearMotion, fixating
from extremal.sim.pose_error import PoseErrors
from extremal.sim.quality import QUALITIES, Quality
from extremal.sim.recording import Recording, record
from extremal.sim.rendering import FrameRenderer, scene_model
from extremal.sim.sensor import Sensor

__all__ = [
    "QUALITIES",
    "ArmKinematics",
    "FrameRenderer",
    "LinearMotion",
    "PoseErrors",
    "Quality",
    "Recording",
    "Sensor",
    "UnreachablePose",
    "fixating",
    "record",
    "render_frames",
    "scene_model",
]
