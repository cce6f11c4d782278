"""Marker blobs from images and video."""
