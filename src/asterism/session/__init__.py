"""One way to label a file: people, standing trials, long recordings, and the names that its points have already."""

from asterism.labelling.recording_labeller import LabellingSettings
from asterism.session.finished import FinishedFiles
from asterism.session.labelled import LabelledFile
from asterism.session.labeller import FileLabeller, body_names, label_file
from asterism.session.live import LiveLabeller
from asterism.session.options import CHECK, IGNORE, KEEP, LabellingOptions
from asterism.session.worn import SetFinder, WornMarkers

__all__ = [
    "CHECK",
    "IGNORE",
    "KEEP",
    "FileLabeller",
    "FinishedFiles",
    "LabelledFile",
    "LabellingOptions",
    "LabellingSettings",
    "LiveLabeller",
    "SetFinder",
    "WornMarkers",
    "body_names",
    "label_file",
]
