"""Rigs that never hung and what their cameras would have seen of a wand or a person, with known truth."""

from asterism.simulation.cameras.images import MERGED, STRAY, images_of
from asterism.simulation.cameras.render import render
from asterism.simulation.cameras.rigs import random_rig, ring_rig
from asterism.simulation.cameras.shadows import Capsules, walker_capsules
from asterism.simulation.cameras.wand import WandTruth, wave_wand

__all__ = [
    "MERGED",
    "STRAY",
    "Capsules",
    "WandTruth",
    "images_of",
    "random_rig",
    "render",
    "ring_rig",
    "walker_capsules",
    "wave_wand",
]
