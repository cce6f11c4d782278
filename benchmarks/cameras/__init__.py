"""Calibration, detection and points."""
