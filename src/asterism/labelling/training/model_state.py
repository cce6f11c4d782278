"""What a model has learned, as one frozen record."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from asterism.labelling.body.anchors import Anchors
from asterism.labelling.body.labeller import FrameLabellingSettings
from asterism.labelling.body.model import BodyModel, BodyRules
from asterism.labelling.partial.matrix import PartialSolvers
from asterism.labelling.training.calibration import Calibration, LabelCalibration
from asterism.labelling.training.learning import TrainingState
from asterism.labelling.whole.certainty import Certainty
from asterism.labelling.whole.verdict import RigidDistances
from asterism.recording import Ints, MarkerSet


@dataclass(frozen=True)
class ModelState:
    """All that a model has learned.

    marker_set        names of the markers
    markers           (M,) those of them that the training showed, by place in the set
    body, anchors     model of the whole body, and the solvers of three markers that find it in a frame
    usual_score       nats per label that nearly every rightly labelled frame scores
    calibrations      from margins to confidence, for frames without and with points left over; what a stream uses
    frame_calibration from margins and fits to the confidence of labels in single frames; None in models of an earlier Asterism
    least_confidence  labels of single frames below this are taken back
    frame_settings    how single frames are labelled
    certainty         from margins to confidence, and the least confidence, for whole recordings
    about             what the model was trained on, in plain values
    solvers           partial solvers, by the rules that use them: "partial-solvers", "thesis"
    training          sample of the training and its configuration; None in models of an earlier Asterism
    general_body      body of people at large, where `body` was adapted to one subject
    distances         near-rigid distances of people who are not in the sample of the training: virtual ones; None where that has all
    """

    marker_set: MarkerSet
    markers: Ints
    body: BodyModel
    anchors: Anchors
    usual_score: float
    calibrations: tuple[Calibration, Calibration]
    least_confidence: float
    frame_settings: FrameLabellingSettings
    certainty: Certainty
    about: dict[str, Any]
    solvers: Mapping[str, PartialSolvers] = field(default_factory=dict)
    training: TrainingState | None = None
    general_body: BodyModel | None = None
    frame_calibration: LabelCalibration | None = None
    distances: RigidDistances | None = None

    @property
    def body_rules(self) -> BodyRules:
        """The rules by which the body was learned; the default ones for models of an earlier Asterism."""
        return BodyRules() if self.training is None else self.training.config.rules.body

    @property
    def frame_certainty(self) -> Certainty:
        """From the margins and fits of labels in single frames to their confidence, and the least one to accept."""
        return Certainty(self.calibrations if self.frame_calibration is None else self.frame_calibration, self.least_confidence)
