"""Labelled markers, and forces where plates are, in; gait events, cycles and parameters out."""

from asterism.gait.analysis import GaitAnalysis, analyse_gait, measures_by_name
from asterism.gait.cycles import POINTS, Cycle, cycles_of, over_cycle
from asterism.gait.events import EventRules, GaitEvent, Walking, find_events
from asterism.gait.feet import Feet, feet_of
from asterism.gait.parameters import PARAMETERS, Parameter, ParameterSummary, parameters_of, summarise

__all__ = [
    "PARAMETERS",
    "POINTS",
    "Cycle",
    "EventRules",
    "Feet",
    "GaitAnalysis",
    "GaitEvent",
    "Parameter",
    "ParameterSummary",
    "Walking",
    "analyse_gait",
    "cycles_of",
    "feet_of",
    "find_events",
    "measures_by_name",
    "over_cycle",
    "parameters_of",
    "summarise",
]
