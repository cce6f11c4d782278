"""An analysed recording and sources of error in; angles with coverage intervals and a budget by source, out (GUM and its Supplement 1)."""

from asterism.motion.uncertainty.budget import AngleUncertainty, UncertaintyResult, estimate_uncertainty
from asterism.motion.uncertainty.first_order import FirstOrder, first_order_angles
from asterism.motion.uncertainty.monte_carlo import MonteCarlo, MonteCarloRules, run_monte_carlo, shortest_interval
from asterism.motion.uncertainty.sources import (
    CalibrationErrors,
    ErrorSources,
    MeasurementNoise,
    SoftTissueErrors,
    noise_from_rig,
)

__all__ = [
    "AngleUncertainty",
    "CalibrationErrors",
    "ErrorSources",
    "FirstOrder",
    "MeasurementNoise",
    "MonteCarlo",
    "MonteCarloRules",
    "SoftTissueErrors",
    "UncertaintyResult",
    "estimate_uncertainty",
    "first_order_angles",
    "noise_from_rig",
    "run_monte_carlo",
    "shortest_interval",
]
