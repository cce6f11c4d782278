"""Cameras and rigs: the projection model, calibration, accuracy and sensitivity."""

from asterism.cameras.camera import Camera
from asterism.cameras.rig import Rig

__all__ = ["Camera", "Rig"]
