"""A labelled walk, a standing trial and a generic model in; the files with which OpenSim scales and moves that model, out."""

from asterism.opensim.export import OpenSimExport, OpenSimTrial, write_opensim
from asterism.opensim.person import PersonInTrial, bodies_of, person_of
from asterism.opensim.scaling import BodyScale, PlacedMarker, generic_model, placed_markers, scale_factors

__all__ = [
    "BodyScale",
    "OpenSimExport",
    "OpenSimTrial",
    "PersonInTrial",
    "PlacedMarker",
    "bodies_of",
    "generic_model",
    "person_of",
    "placed_markers",
    "scale_factors",
    "write_opensim",
]
