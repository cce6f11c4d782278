"""The types of the data: arrays in; recordings, clouds, blobs, labellings and marker sets out."""

from asterism.recording.arrays import Floats, Ints, as_vertical
from asterism.recording.blobs import Blobs
from asterism.recording.clouds import NULL, Clouds, Evidence, Labelling
from asterism.recording.marker_set import MarkerSet, canonical, is_unnamed, shipped_marker_sets, without_subject
from asterism.recording.processing import ProcessingStep, log_as_text, log_from_text
from asterism.recording.trajectories import Event, Recording, keep_labels
from asterism.recording.verdict import Verdict

__all__ = [
    "NULL",
    "Blobs",
    "Clouds",
    "Event",
    "Evidence",
    "Floats",
    "Ints",
    "Labelling",
    "MarkerSet",
    "ProcessingStep",
    "Recording",
    "Verdict",
    "as_vertical",
    "canonical",
    "is_unnamed",
    "keep_labels",
    "log_as_text",
    "log_from_text",
    "shipped_marker_sets",
    "without_subject",
]
