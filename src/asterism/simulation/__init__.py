"""A number of subjects in; out come recordings of people who never lived, with known truth: for the demo, tests and benchmarks."""

from asterism.labelling.simulated_occlusions import hide_and_haunt
from asterism.simulation.body import simulated_markers
from asterism.simulation.walks import simulate_standing, simulate_walks

__all__ = ["hide_and_haunt", "simulate_standing", "simulate_walks", "simulated_markers"]
