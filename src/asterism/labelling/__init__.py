"""The heart: clouds in, labels with a calibrated confidence out."""

from asterism.labelling.ensemble import SolverEnsemble
from asterism.labelling.evaluation import Condition, Evaluation, evaluate, leave_one_subject_out

__all__ = ["Condition", "Evaluation", "SolverEnsemble", "evaluate", "leave_one_subject_out"]
