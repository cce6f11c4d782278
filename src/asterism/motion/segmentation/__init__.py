"""Trajectories of points in; which points move together as one limb, and how many limbs there are, out."""

from asterism.motion.segmentation.limbs import Segmentation, SegmentationRules, segment_limbs

__all__ = ["Segmentation", "SegmentationRules", "segment_limbs"]
