"""The points of one limb in; its rotation and translation over time out: plain, by point clusters, or robust to soft tissue."""

from asterism.motion.rigid.limb import METHODS, LimbMotion, LimbRules, estimate_limb_motion
from asterism.motion.rigid.rotations import (
    HelicalAxes,
    angular_velocity,
    helical_axes,
    quaternions,
    relative_rotations,
    rotation_vectors,
)

__all__ = [
    "METHODS",
    "HelicalAxes",
    "LimbMotion",
    "LimbRules",
    "angular_velocity",
    "estimate_limb_motion",
    "helical_axes",
    "quaternions",
    "relative_rotations",
    "rotation_vectors",
]
