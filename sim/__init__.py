"""Scenes in, views out: the arm, its camera, its motion, its errors."""

from extremal.sim.arm_errors import ARMS, ArmErrors, get_arm
from extremal.sim.chain import NOMINAL, ArmGeometry
from extremal.sim.execution import ArmNotSettled, Drive
from extremal.sim.frames import render_frames
from extremal.sim.kinematics import ArmKinematics, UnreachablePose
from extremal.sim.motion import LinearMotion, Motion, fixating
from extremal.sim.quality import QUALITIES, Quality
from extremal.sim.recording import Recording, record
from extremal.sim.rendering import FrameRenderer, scene_model
from extremal.sim.sensor import Sensor

__all__ = [
    "ARMS",
    "NOMINAL",
    "QUALITIES",
    "ArmErrors",
    "ArmGeometry",
    "ArmKinematics",
    "ArmNotSettled",
    "Drive",
    "FrameRenderer",
    "LinearMotion",
    "Motion",
    "Quality",
    "Recording",
    "Sensor",
    "UnreachablePose",
    "fixating",
    "get_arm",
    "record",
    "render_frames",
    "scene_model",
]
