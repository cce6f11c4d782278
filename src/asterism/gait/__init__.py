"""Labelled markers, and forces where plates are, in; gait events, cycles and parameters out."""

from asterism.gait.analysis import GaitAnalysis, analyse_gait, analyses_without_turns
from asterism.gait.bands import Band, ProfileScore, band_of, profile_scores
from asterism.gait.comparison import ParameterChange, compare_sessions
from asterism.gait.cycles import POINTS, Cycle, cycles_of, midstances, over_cycle, without_turns
from asterism.gait.emg import EmgChannel, EmgRules, emg_of, envelope, muscles_by_channel, named_channels
from asterism.gait.events import EventRules, GaitEvent, Walking, find_events, plate_contacts
from asterism.gait.feet import Feet, feet_of
from asterism.gait.intervals import AngleBand, angle_bands
from asterism.gait.outputs import analysis_values, model_points, write_gait_c3d
from asterism.gait.parameters import PARAMETERS, Parameter, ParameterSummary, Symmetry, parameters_of, summarise, symmetries
from asterism.gait.tables import gait_table

__all__ = [
    "PARAMETERS",
    "POINTS",
    "AngleBand",
    "Band",
    "Cycle",
    "EmgChannel",
    "EmgRules",
    "EventRules",
    "Feet",
    "GaitAnalysis",
    "GaitEvent",
    "Parameter",
    "ParameterChange",
    "ParameterSummary",
    "ProfileScore",
    "Symmetry",
    "Walking",
    "analyse_gait",
    "analyses_without_turns",
    "analysis_values",
    "angle_bands",
    "band_of",
    "compare_sessions",
    "cycles_of",
    "emg_of",
    "envelope",
    "feet_of",
    "find_events",
    "gait_table",
    "midstances",
    "model_points",
    "muscles_by_channel",
    "named_channels",
    "over_cycle",
    "parameters_of",
    "plate_contacts",
    "profile_scores",
    "summarise",
    "symmetries",
    "without_turns",
    "write_gait_c3d",
]
