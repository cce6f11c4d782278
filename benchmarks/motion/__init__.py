"""Segments, joints and angles, with their uncertainty."""
