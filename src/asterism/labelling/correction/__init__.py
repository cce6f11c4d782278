"""A person corrects labels: a model and a recording in; touches, their consequences and a log of them out."""

from asterism.labelling.correction.answers import Answer, question_row, read_answers, table_text, touches_of
from asterism.labelling.correction.correct import Correction, CorrectionChange, FirstLabels, PieceChange
from asterism.labelling.correction.event_log import CorrectionLog, log_path
from asterism.labelling.correction.pieces import Pieces
from asterism.labelling.correction.readiness import Readiness, ReadinessRules, readiness
from asterism.labelling.correction.touches import Cut, Ghost, Name, PointInFrame, Right, Swap, SwapMarkers, Touch, request_of

__all__ = [
    "Answer",
    "Correction",
    "CorrectionChange",
    "CorrectionLog",
    "Cut",
    "FirstLabels",
    "Ghost",
    "Name",
    "PieceChange",
    "Pieces",
    "PointInFrame",
    "Readiness",
    "ReadinessRules",
    "Right",
    "Swap",
    "SwapMarkers",
    "Touch",
    "log_path",
    "question_row",
    "read_answers",
    "readiness",
    "request_of",
    "table_text",
    "touches_of",
]
