"""Wand calibration: blobs of a waved wand in; a rig, and whether it can be trusted, out."""

from asterism.calibration.wand.calibrate import calibrate_wand
from asterism.calibration.wand.checks import coverage
from asterism.calibration.wand.result import WandCalibration
from asterism.calibration.wand.world import in_world, world_from_floor_wand, world_from_l_frame, world_from_points

__all__ = [
    "WandCalibration",
    "calibrate_wand",
    "coverage",
    "in_world",
    "world_from_floor_wand",
    "world_from_l_frame",
    "world_from_points",
]
