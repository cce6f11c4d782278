"""Motion of points along their paths through time: smooth paths; limbs, joints and angles with their uncertainty."""

from asterism.motion.analysis import JointAngles, MotionAnalysis, MotionRules, analyse_motion, joint_angles
from asterism.motion.smoothing import SmoothingRules, SmoothPaths, smooth_paths

__all__ = [
    "JointAngles",
    "MotionAnalysis",
    "MotionRules",
    "SmoothPaths",
    "SmoothingRules",
    "analyse_motion",
    "joint_angles",
    "smooth_paths",
]
