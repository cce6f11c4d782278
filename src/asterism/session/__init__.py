"""One way to label a file: people, standing trials, long recordings, and the names that its points have already."""

from asterism.labelling.recording_labeller import LabellingSettings
from asterism.session.finished import FinishedFiles
from asterism.session.labelled import LabelledFile
from asterism.session.labeller import FileLabeller, body_names, label_file
from asterism.session.live import LiveLabeller
from asterism.session.lock import LOCK, Held, held
from asterism.session.options import CHECK, IGNORE, KEEP, LabellingOptions
from asterism.session.plan import FolderSettings, PlannedPerson, PlannedTrial, plan_session
from asterism.session.spread import Outcome, each_of, in_order, spread
from asterism.session.standing import is_standing_name, stands
from asterism.session.trials import has_gaps, read_trial, read_trials, trials_of
from asterism.session.worn import SetFinder, WornMarkers

__all__ = [
    "CHECK",
    "IGNORE",
    "KEEP",
    "LOCK",
    "FileLabeller",
    "FinishedFiles",
    "FolderSettings",
    "Held",
    "LabelledFile",
    "LabellingOptions",
    "LabellingSettings",
    "LiveLabeller",
    "Outcome",
    "PlannedPerson",
    "PlannedTrial",
    "SetFinder",
    "WornMarkers",
    "body_names",
    "each_of",
    "has_gaps",
    "held",
    "in_order",
    "is_standing_name",
    "label_file",
    "plan_session",
    "read_trial",
    "read_trials",
    "spread",
    "stands",
    "trials_of",
]
