"""The heart: clouds in, labels with a calibrated confidence out."""

from asterism.labelling.audit import LabelError, audit, without
from asterism.labelling.capturability import Capturability, Change, capturability
from asterism.labelling.ensemble import SolverEnsemble, TrainingRules, label_together
from asterism.labelling.evaluation import Condition, Evaluation, evaluate, leave_one_subject_out
from asterism.labelling.naming import Groups, name_groups, own_tracks
from asterism.labelling.partial.solver import FullSolver, FullSolverRules
from asterism.labelling.review import Item, review, settle
from asterism.labelling.together import join_labellings
from asterism.labelling.whole.bodies import SeveralBodies

__all__ = [
    "Capturability",
    "Change",
    "Condition",
    "Evaluation",
    "FullSolver",
    "FullSolverRules",
    "Groups",
    "Item",
    "LabelError",
    "SeveralBodies",
    "SolverEnsemble",
    "TrainingRules",
    "audit",
    "capturability",
    "evaluate",
    "join_labellings",
    "label_together",
    "leave_one_subject_out",
    "name_groups",
    "own_tracks",
    "review",
    "settle",
    "without",
]
