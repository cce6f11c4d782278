"""The heart: clouds in, labels with a calibrated confidence out."""

from asterism.labelling.audit import LabelError, audit, remove_errors
from asterism.labelling.capturability import Capturability, CapturabilityRules, Change, capturability
from asterism.labelling.ensemble import SolverEnsemble, TrainingRules, label_together
from asterism.labelling.evaluation import Condition, Evaluation, evaluate, leave_one_subject_out
from asterism.labelling.naming import MarkerGroups, group_tracklets, name_groups
from asterism.labelling.partial.solver import FullSolver, FullSolverRules
from asterism.labelling.reliability import ConfidenceScore, ConfidenceTally, Reliability
from asterism.labelling.review import ReviewItem, apply_answers, review
from asterism.labelling.together import join_labellings
from asterism.labelling.whole.bodies import SeveralBodies

__all__ = [
    "Capturability",
    "CapturabilityRules",
    "Change",
    "Condition",
    "ConfidenceScore",
    "ConfidenceTally",
    "Evaluation",
    "FullSolver",
    "FullSolverRules",
    "LabelError",
    "MarkerGroups",
    "Reliability",
    "ReviewItem",
    "SeveralBodies",
    "SolverEnsemble",
    "TrainingRules",
    "apply_answers",
    "audit",
    "capturability",
    "evaluate",
    "group_tracklets",
    "join_labellings",
    "label_together",
    "leave_one_subject_out",
    "name_groups",
    "remove_errors",
    "review",
]
