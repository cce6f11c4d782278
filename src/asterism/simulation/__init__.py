"""Simulated recordings of people, with known truth: for the demo, tests and benchmarks."""

from asterism.labelling.simulated_occlusions import hide_and_haunt, hide_in_gaps
from asterism.simulation.body import simulated_markers
from asterism.simulation.comparison import PointErrors, RigErrors, compare_points, compare_rigs
from asterism.simulation.walks import simulate_standing, simulate_walks

__all__ = [
    "PointErrors",
    "RigErrors",
    "compare_points",
    "compare_rigs",
    "hide_and_haunt",
    "hide_in_gaps",
    "simulate_standing",
    "simulate_walks",
    "simulated_markers",
]
