"""Cameras and rigs: the projection model, calibration, accuracy and sensitivity."""

from asterism.cameras.camera import Camera, rotation_from_vector, vector_from_rotation
from asterism.cameras.rig import Rig

__all__ = ["Camera", "Rig", "rotation_from_vector", "vector_from_rotation"]
