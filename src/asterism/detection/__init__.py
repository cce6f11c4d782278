"""Marker blobs from images and video."""

from asterism.detection.blobs import Flag, Spots, automatic_threshold, find_blobs, static_mask
from asterism.detection.sequences import CameraImages, Detection, detect
from asterism.detection.static_lights import still_lights, without_still_lights

__all__ = [
    "CameraImages",
    "Detection",
    "Flag",
    "Spots",
    "automatic_threshold",
    "detect",
    "find_blobs",
    "static_mask",
    "still_lights",
    "without_still_lights",
]
