"""Files in, recordings out and back: C3D, TRC, CSV, QTM TSV and MAT, MOT and STO, NPZ; XDF in; by content and suffix. Blobs: CSV."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from asterism.formats._confidence import LabelConfidence
from asterism.formats._dispatch import (
    check_suffix,
    convert,
    convert_and_tell,
    describe,
    is_recording_file,
    read,
    read_clouds,
    read_confidence,
    read_evidence,
    write,
    write_points,
)

if TYPE_CHECKING:
    from asterism.formats._bones import SkeletonFile, fill_missing_bones
    from asterism.formats._columns import wanted_columns
    from asterism.formats._computed import computed_labels, without_computed
    from asterism.formats._programs import PROGRAMS, for_program, write_for_program
    from asterism.formats._units import metres_per_unit, unlike_a_person
    from asterism.formats._vertical import vertical_from_positions
    from asterism.formats.c3d.analog import AnalogChannel, analog_channels
    from asterism.formats.c3d.outputs import AnalysisValue, ModelPoint, write_model_outputs
    from asterism.formats.c3d.plates import force_plates
    from asterism.formats.csv_blobs import read_blobs, write_blobs
    from asterism.formats.opensim_forces import companions
    from asterism.formats.opensim_model import OsimModel, read_osim
    from asterism.formats.skeletons import check_skeleton_form, is_skeleton_file, read_skeleton, write_skeleton
    from asterism.formats.storage import TimeSeriesTable, read_table, write_table

__all__ = [
    "PROGRAMS",
    "AnalogChannel",
    "AnalysisValue",
    "LabelConfidence",
    "ModelPoint",
    "OsimModel",
    "SkeletonFile",
    "TimeSeriesTable",
    "analog_channels",
    "check_skeleton_form",
    "check_suffix",
    "companions",
    "computed_labels",
    "convert",
    "convert_and_tell",
    "describe",
    "fill_missing_bones",
    "for_program",
    "force_plates",
    "is_recording_file",
    "is_skeleton_file",
    "metres_per_unit",
    "read",
    "read_blobs",
    "read_clouds",
    "read_confidence",
    "read_evidence",
    "read_osim",
    "read_skeleton",
    "read_table",
    "unlike_a_person",
    "vertical_from_positions",
    "wanted_columns",
    "without_computed",
    "write",
    "write_blobs",
    "write_for_program",
    "write_model_outputs",
    "write_points",
    "write_skeleton",
    "write_table",
]

_MODULE_OF = {
    "AnalogChannel": "c3d.analog",
    "analog_channels": "c3d.analog",
    "force_plates": "c3d.plates",
    **dict.fromkeys(("AnalysisValue", "ModelPoint", "write_model_outputs"), "c3d.outputs"),
    **dict.fromkeys(("metres_per_unit", "unlike_a_person"), "_units"),
    "vertical_from_positions": "_vertical",
    "wanted_columns": "_columns",
    **dict.fromkeys(("computed_labels", "without_computed"), "_computed"),
    **dict.fromkeys(("PROGRAMS", "for_program", "write_for_program"), "_programs"),
    "companions": "opensim_forces",
    **dict.fromkeys(("OsimModel", "read_osim"), "opensim_model"),
    **dict.fromkeys(("read_blobs", "write_blobs"), "csv_blobs"),
    **dict.fromkeys(("SkeletonFile", "fill_missing_bones"), "_bones"),
    **dict.fromkeys(("check_skeleton_form", "is_skeleton_file", "read_skeleton", "write_skeleton"), "skeletons"),
    **dict.fromkeys(("TimeSeriesTable", "read_table", "write_table"), "storage"),
}


def __getattr__(name: str) -> Any:
    """Import a name when it is first used: a command that reads one format loads no other."""
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value = getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
    return value
