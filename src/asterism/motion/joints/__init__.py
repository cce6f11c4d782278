"""The motions of limbs in; which limbs are joined, where and about which axis, and the joints' angles, out."""

from asterism.motion.joints.anatomy import AnatomicalFrames, leg_frames
from asterism.motion.joints.angles import cardan_angles, functional_flexion, grood_suntay, joint_rotation
from asterism.motion.joints.joint import JOINT_METHODS, Joint, JointRules, Motion, fit_joint
from asterism.motion.joints.skeleton import Skeleton, find_skeleton

__all__ = [
    "JOINT_METHODS",
    "AnatomicalFrames",
    "Joint",
    "JointRules",
    "Motion",
    "Skeleton",
    "cardan_angles",
    "find_skeleton",
    "fit_joint",
    "functional_flexion",
    "grood_suntay",
    "joint_rotation",
    "leg_frames",
]
