"""Marker blobs from images and video."""

from asterism.detection.blobs import BlobSettings, Flag, ImageBlobs, find_blobs, static_mask
from asterism.detection.camera_images import CameraImages
from asterism.detection.running import RunningBlobs, RunningDetection
from asterism.detection.sequences import Detection, DetectionSettings, detect
from asterism.detection.static_lights import find_static_lights, without_static_lights
from asterism.detection.thresholds import automatic_threshold

__all__ = [
    "BlobSettings",
    "CameraImages",
    "Detection",
    "DetectionSettings",
    "Flag",
    "ImageBlobs",
    "RunningBlobs",
    "RunningDetection",
    "automatic_threshold",
    "detect",
    "find_blobs",
    "find_static_lights",
    "static_mask",
    "without_static_lights",
]
