"""Simulated rigs, and what their cameras see of a wand or a person, with known truth."""

from asterism.simulation.cameras.images import MERGED, STRAY, ImagingSettings, simulate_blobs
from asterism.simulation.cameras.rendering import RenderSettings, render_images
from asterism.simulation.cameras.rigs import random_rig, ring_rig
from asterism.simulation.cameras.shadows import Capsules, walker_capsules
from asterism.simulation.cameras.wand import WandTruth, simulate_wand

__all__ = [
    "MERGED",
    "STRAY",
    "Capsules",
    "ImagingSettings",
    "RenderSettings",
    "WandTruth",
    "random_rig",
    "render_images",
    "ring_rig",
    "simulate_blobs",
    "simulate_wand",
    "walker_capsules",
]
