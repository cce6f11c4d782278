"""Marker blobs from images and video."""

from asterism.detection.blobs import Flag, Spots, automatic_threshold, find_blobs, static_mask
from asterism.detection.sequences import CameraImages, Detection, detect
from asterism.detection.static_lights import find_static_lights, without_static_lights

__all__ = [
    "CameraImages",
    "Detection",
    "Flag",
    "Spots",
    "automatic_threshold",
    "detect",
    "find_blobs",
    "find_static_lights",
    "static_mask",
    "without_static_lights",
]
