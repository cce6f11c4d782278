"""Bundle adjustment: cameras, and an object of known shape in each frame, fitted together to where the cameras saw its points."""

from asterism.cameras.bundle.adjust import Adjustment, AdjustSettings, adjust, free_parameters
from asterism.cameras.bundle.locate import locate
from asterism.cameras.bundle.sightings import PARAMETERS, Sightings, triangulate

__all__ = ["PARAMETERS", "AdjustSettings", "Adjustment", "Sightings", "adjust", "free_parameters", "locate", "triangulate"]
