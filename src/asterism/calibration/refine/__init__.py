"""Refinement: a rig and any recording of markers in; which camera was moved, and the corrected rig, out."""

from asterism.calibration.refine.refine import refine_rig
from asterism.calibration.refine.result import CameraCheck, Refinement

__all__ = ["CameraCheck", "Refinement", "refine_rig"]
