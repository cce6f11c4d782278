"""The types of the data: arrays in; recordings, clouds, blobs, labellings and marker sets out."""

from asterism.recording.arrays import Floats, Ints, as_vertical, axis_name
from asterism.recording.blobs import Blobs
from asterism.recording.clouds import NULL, Clouds, Evidence, Labelling
from asterism.recording.filled import filled_samples
from asterism.recording.force_plate import ForcePlate
from asterism.recording.known_labels import Disagreement, check_labels, is_partly_labelled
from asterism.recording.marker_set import MarkerSet, canonical, is_unnamed, plain_name, shipped_marker_sets, shipped_sets, without_subject
from asterism.recording.place import Place, landmarks
from asterism.recording.processing import LABELLED_LIVE, ProcessingStep, labelled_live, log_as_text, log_from_text
from asterism.recording.shares import LABEL_STATES, SURE, LabelShares, LabelStates, label_shares, label_states
from asterism.recording.skeleton_motion import SkeletonMotion
from asterism.recording.trajectories import Event, Recording, keep_labels, subject_of
from asterism.recording.verdict import Verdict
from asterism.recording.worn_set import WornSet, worn_marker_sets

__all__ = [
    "LABELLED_LIVE",
    "LABEL_STATES",
    "NULL",
    "SURE",
    "Blobs",
    "Clouds",
    "Disagreement",
    "Event",
    "Evidence",
    "Floats",
    "ForcePlate",
    "Ints",
    "LabelShares",
    "LabelStates",
    "Labelling",
    "MarkerSet",
    "Place",
    "ProcessingStep",
    "Recording",
    "SkeletonMotion",
    "Verdict",
    "WornSet",
    "as_vertical",
    "axis_name",
    "canonical",
    "check_labels",
    "filled_samples",
    "is_partly_labelled",
    "is_unnamed",
    "keep_labels",
    "label_shares",
    "label_states",
    "labelled_live",
    "landmarks",
    "log_as_text",
    "log_from_text",
    "plain_name",
    "shipped_marker_sets",
    "shipped_sets",
    "subject_of",
    "without_subject",
    "worn_marker_sets",
]
