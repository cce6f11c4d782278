"""A wearer of a coded garment: a body of tubes that walks or raises its arms, photographed by a rig, with the truth of each circle."""

from asterism.simulation.garment.photograph import CircleTruth, Lamp, Photo, PhotoSettings, photograph, ring_of_lamps
from asterism.simulation.garment.reading import SimulatedCircles, simulated_reading
from asterism.simulation.garment.rigs import garment_rig
from asterism.simulation.garment.suit import Mesh, Wearer, WornGarment, sheet_of, suit_masks, wear
from asterism.simulation.garment.target import WavedTarget, wave_target
from asterism.simulation.garment.tubes import Folds

__all__ = [
    "CircleTruth",
    "Folds",
    "Lamp",
    "Mesh",
    "Photo",
    "PhotoSettings",
    "SimulatedCircles",
    "WavedTarget",
    "Wearer",
    "WornGarment",
    "garment_rig",
    "photograph",
    "ring_of_lamps",
    "sheet_of",
    "simulated_reading",
    "suit_masks",
    "wave_target",
    "wear",
]
