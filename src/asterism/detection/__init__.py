"""Marker blobs from images and video."""

from asterism.detection.blobs import Flag, Spots, automatic_threshold, find_blobs, static_mask

__all__ = ["Flag", "Spots", "automatic_threshold", "find_blobs", "static_mask"]
