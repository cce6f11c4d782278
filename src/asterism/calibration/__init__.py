"""Images and blobs of something known in; rigs out: from a waved wand, a board, or any recording of a rig that has moved."""

from asterism.calibration.boards import calibrate_board
from asterism.calibration.refine import CameraCheck, Refinement, refine_rig
from asterism.calibration.wand import calibrate_wand

__all__ = ["CameraCheck", "Refinement", "calibrate_board", "calibrate_wand", "refine_rig"]
