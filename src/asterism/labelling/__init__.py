"""The heart: clouds in, labels with a calibrated confidence out."""

from asterism.labelling.capturability import Capturability, Change, capturability
from asterism.labelling.ensemble import SolverEnsemble, TrainingRules
from asterism.labelling.evaluation import Condition, Evaluation, evaluate, leave_one_subject_out
from asterism.labelling.review import Item, review, settle
from asterism.labelling.solver import FullSolver

__all__ = [
    "Capturability",
    "Change",
    "Condition",
    "Evaluation",
    "FullSolver",
    "Item",
    "SolverEnsemble",
    "TrainingRules",
    "capturability",
    "evaluate",
    "leave_one_subject_out",
    "review",
    "settle",
]
