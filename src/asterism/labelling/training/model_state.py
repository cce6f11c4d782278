"""What a model has learned, as one frozen record; and its model file."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from asterism.labelling.body.anchors import Anchors
from asterism.labelling.body.labeller import FrameLabellingSettings
from asterism.labelling.body.model import BodyModel, BodyRules
from asterism.labelling.partial.matrix import PartialSolvers
from asterism.labelling.training.calibration import MAX_SLOPE, PIECES, Calibration, LabelCalibration
from asterism.labelling.training.learning import TrainingConfig, TrainingState
from asterism.labelling.training.model_file import reading, write_arrays
from asterism.labelling.training.sample import Sample
from asterism.labelling.whole.certainty import Certainty
from asterism.recording import Floats, Ints, MarkerSet

_SOLVER_PREFIXES = {"partial-solvers": "partial_", "thesis": "thesis_"}
"""How the arrays of a model's partial solvers begin, by the rules that use them."""


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

    @property
    def body_rules(self) -> BodyRules:
        """The rules by which the body was learned; the default ones for models of an earlier Asterism."""
        return BodyRules() if self.training is None else self.training.config.rules.body

    @property
    def frame_certainty(self) -> Certainty:
        """From the margins and fits of labels in single frames to their confidence, and the least one to accept."""
        return Certainty(self.calibrations if self.frame_calibration is None else self.frame_calibration, self.least_confidence)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a model file. Raises AsterismError where the place cannot be written."""
        write_arrays(path, self._head(), self._arrays())

    def _head(self) -> dict[str, Any]:
        """What is plain text in the file."""
        return {
            "marker_set": {
                "names": self.marker_set.names,
                "title": self.marker_set.title,
                "aliases": dict(self.marker_set.aliases),
                "pairs": self.marker_set.pairs,
                "segments": dict(self.marker_set.segments),
            },
            "usual_score": self.usual_score,
            "least_confidence": self.least_confidence,
            "least_confidence_in_time": self.certainty.least_confidence,
            "steep_in_time": self.certainty.max_slope,
            "look": asdict(self.frame_settings),
            "about": self.about,
            "recipe": None if self.training is None else self.training.config.to_dict(),
        }

    def _arrays(self) -> dict[str, Any]:
        """What is arrays in the file."""
        arrays: dict[str, Any] = {
            "markers": self.markers,
            **{f"body_{name}": array for name, array in self.body.to_arrays().items()},
            "anchor_triples": self.anchors.triples,
            "anchor_low": self.anchors.low,
            "anchor_high": self.anchors.high,
        }
        for rules, prefix in _SOLVER_PREFIXES.items():
            if rules in self.solvers:
                arrays |= {f"{prefix}{name}": array for name, array in self.solvers[rules].to_arrays().items()}
        for i, calibration in enumerate(self.calibrations):
            arrays[f"calibration_{i}"] = np.stack([calibration.margin, calibration.right])
        if self.frame_calibration is not None:
            arrays |= _calibration_arrays("frame", self.frame_calibration)
        if isinstance(self.certainty.calibration, LabelCalibration):
            arrays |= _calibration_arrays("time", self.certainty.calibration)
        else:
            for i, calibration in enumerate(self.certainty.calibration):
                arrays[f"time_calibration_{i}"] = np.stack([calibration.margin, calibration.right])
        if self.general_body is not None:
            arrays |= {f"general_{name}": array for name, array in self.general_body.to_arrays().items()}
        if self.training is not None:
            arrays |= {f"sample_{name}": array for name, array in self.training.sample.to_arrays().items()}
        return arrays

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> ModelState:
        """Read a model file. Raises AsterismError where it is missing, damaged, no model, or of a later version."""
        from asterism.labelling.training.model_schema import check_state

        with reading(path) as (head, arrays):
            marker_set = _marker_set(head["marker_set"])
            body = _body(arrays, "body_")
            anchors = Anchors(arrays["anchor_triples"], arrays["anchor_low"], arrays["anchor_high"])
            _check_shapes(len(marker_set), arrays["markers"], body, anchors)
            calibrations, least_confidence = _two_curves(arrays, "calibration"), float(head["least_confidence"])
            sample = _with_prefix(arrays, "sample_")
            training = None
            if sample:
                training = TrainingState(Sample.from_arrays(sample, len(marker_set)), TrainingConfig.from_dict(head["recipe"]))
            state = cls(
                marker_set=marker_set,
                markers=arrays["markers"],
                body=body,
                anchors=anchors,
                usual_score=float(head["usual_score"]),
                calibrations=calibrations,
                least_confidence=least_confidence,
                frame_settings=FrameLabellingSettings.from_dict(head["look"]),
                certainty=_certainty(head, arrays) or Certainty(calibrations, least_confidence),
                about=dict(head["about"]),
                solvers=_solvers(arrays),
                training=training,
                general_body=_body(arrays, "general_") if "general_mean" in arrays else None,
                frame_calibration=_label_calibration(arrays, "frame"),
            )
            check_state(state)
            return state


def _marker_set(plain: dict[str, Any]) -> MarkerSet:
    return MarkerSet(
        tuple(plain["names"]),
        plain["title"],
        {name: tuple(others) for name, others in plain["aliases"].items()},
        tuple((left, right) for left, right in plain["pairs"]),
        {name: tuple(members) for name, members in plain["segments"].items()},
    )


def _certainty(head: dict[str, Any], arrays: dict[str, Any]) -> Certainty | None:
    """The certainty of whole recordings; None in models of an earlier Asterism."""
    fitted = _label_calibration(arrays, "time")
    if fitted is None and "time_calibration_0" not in arrays:
        return None
    least, steep = float(head["least_confidence_in_time"]), float(head.get("steep_in_time", MAX_SLOPE))
    if fitted is not None:
        return Certainty(fitted, least)
    return Certainty(_two_curves(arrays, "time_calibration"), least, steep)


def _calibration_arrays(name: str, calibration: LabelCalibration) -> dict[str, Any]:
    return {f"{name}_weights": np.stack([calibration.own, calibration.prior]), f"{name}_own_share": np.array(calibration.share)}


def _label_calibration(arrays: dict[str, Any], name: str) -> LabelCalibration | None:
    """The inverse of `_calibration_arrays`; None where there is none."""
    if f"{name}_weights" not in arrays:
        return None
    weights, share = _finite(arrays[f"{name}_weights"]), float(arrays[f"{name}_own_share"])
    if weights.shape != (2, 2, 1 + PIECES) or not 0.0 <= share <= 1.0:
        raise ValueError("shapes disagree")
    return LabelCalibration(weights[0], weights[1], share)


def _solvers(arrays: dict[str, Any]) -> dict[str, PartialSolvers]:
    """The partial solvers of a model file, by the rules that use them."""
    found = {rules: _with_prefix(arrays, prefix) for rules, prefix in _SOLVER_PREFIXES.items()}
    return {rules: PartialSolvers.from_arrays(own) for rules, own in found.items() if own}


def _with_prefix(arrays: dict[str, Any], prefix: str) -> dict[str, Any]:
    return {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}


def _body(arrays: dict[str, Any], prefix: str) -> BodyModel:
    return BodyModel(**{name: _finite(array) for name, array in _with_prefix(arrays, prefix).items()})


def _two_curves(arrays: dict[str, Any], name: str) -> tuple[Calibration, Calibration]:
    return Calibration(*_finite(arrays[f"{name}_0"])), Calibration(*_finite(arrays[f"{name}_1"]))


def _finite(array: Floats) -> Floats:
    if not np.isfinite(array).all():
        raise ValueError("not finite")
    return array


def _check_shapes(names: int, markers: Ints, body: BodyModel, anchors: Anchors) -> None:
    """Raise ValueError where the kernels would leave the arrays of a body and its anchors."""
    poses, count, axes, latents = body.load.shape
    square = (poses, 3 * count, 3 * count)
    body_fits = (
        body.mean.shape == (poses, count, 3)
        and body.noise.shape == (poses, count, 3, 3)
        and body.log_weight.shape == (poses,)
        and axes == 3
        and latents > 0
        and all(part is None or part.shape == square for part in (body.within, body.between))
    )
    anchors_fit = (
        anchors.triples.ndim == 2
        and anchors.triples.shape[1] == 3
        and anchors.low.shape == anchors.high.shape == (len(anchors.triples), 6)
        and anchors.triples.min() >= 0
        and anchors.triples.max() < count
    )
    markers_fit = markers.shape == (count,) and markers.min() >= 0 and markers.max() < names
    if not (body_fits and anchors_fit and markers_fit):
        raise ValueError("shapes disagree")
