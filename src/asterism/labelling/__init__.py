"""The heart: clouds in, labels with a calibrated confidence out."""

from __future__ import annotations

from typing import Any

from asterism.labelling.audit import LabelError, audit, check_names, remove_errors
from asterism.labelling.evaluation import Condition, Evaluation, evaluate, leave_one_subject_out
from asterism.labelling.marker_model import MarkerModel, label_together
from asterism.labelling.naming import MarkerGroups, group_tracklets, name_groups
from asterism.labelling.partial.capturability import Capturability, CapturabilityRules, MarkerSetChange, capturability
from asterism.labelling.partial.solver import FullSolver, FullSolverRules
from asterism.labelling.recording_labeller import LabellingSettings, RecordingLabeller
from asterism.labelling.reliability import ConfidenceScore, ConfidenceTally, Reliability
from asterism.labelling.review import ReviewItem, apply_answers, review
from asterism.labelling.together import join_labellings
from asterism.labelling.training.learning import TrainingRules
from asterism.labelling.virtual_model import virtual_model
from asterism.labelling.whole.bodies import SeveralBodies

__all__ = [
    "Capturability",
    "CapturabilityRules",
    "Condition",
    "ConfidenceScore",
    "ConfidenceTally",
    "Evaluation",
    "FullSolver",
    "FullSolverRules",
    "LabelError",
    "LabellingSettings",
    "MarkerGroups",
    "MarkerModel",
    "MarkerSetChange",
    "RecordingLabeller",
    "Reliability",
    "ReviewItem",
    "SeveralBodies",
    "TrainingRules",
    "apply_answers",
    "audit",
    "capturability",
    "check_names",
    "evaluate",
    "group_tracklets",
    "join_labellings",
    "label_together",
    "leave_one_subject_out",
    "name_groups",
    "remove_errors",
    "review",
    "virtual_model",
]


def __getattr__(name: str) -> Any:
    """`SolverEnsemble`, as `MarkerModel` was called before 0.2."""
    if name != "SolverEnsemble":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    import warnings

    warnings.warn("SolverEnsemble is now called MarkerModel.", DeprecationWarning, stacklevel=2)
    return MarkerModel
