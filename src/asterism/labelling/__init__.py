"""The heart: clouds in, labels with a calibrated confidence out."""

from asterism.labelling.ensemble import SolverEnsemble, upright

__all__ = ["SolverEnsemble", "upright"]
