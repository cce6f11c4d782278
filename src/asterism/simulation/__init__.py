"""Simulated recordings of people, with known truth: for the demo, tests and benchmarks."""

from asterism.labelling.simulated_clutter import Clutter, add_clutter, displace_marker
from asterism.labelling.simulated_occlusions import simulate_gaps_and_ghosts, simulate_occlusions
from asterism.simulation.body import simulated_markers
from asterism.simulation.comparison import PointErrors, RigErrors, compare_points, compare_rigs
from asterism.simulation.walks import simulate_standing, simulate_walks

__all__ = [
    "Clutter",
    "PointErrors",
    "RigErrors",
    "add_clutter",
    "compare_points",
    "compare_rigs",
    "displace_marker",
    "simulate_gaps_and_ghosts",
    "simulate_occlusions",
    "simulate_standing",
    "simulate_walks",
    "simulated_markers",
]
