"""Motion of points along their paths through time: smooth paths; limbs, joints and angles with their uncertainty."""

from asterism.motion.analysis import JointAngles, MotionAnalysis, MotionRules, analyse_motion, joint_angles
from asterism.motion.filters import FilterChoice, FilteredRecording, filter_trajectories
from asterism.motion.smoothing import SmoothingRules, SmoothPaths, smooth_paths

__all__ = [
    "FilterChoice",
    "FilteredRecording",
    "JointAngles",
    "MotionAnalysis",
    "MotionRules",
    "SmoothPaths",
    "SmoothingRules",
    "analyse_motion",
    "filter_trajectories",
    "joint_angles",
    "smooth_paths",
]
