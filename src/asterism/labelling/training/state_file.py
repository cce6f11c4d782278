"""What a model has learned in; its model file out, and back."""

from __future__ import annotations

import os
from dataclasses import asdict
from typing import Any

import numpy as np

from asterism.labelling.body.anchors import Anchors
from asterism.labelling.body.labeller import FrameLabellingSettings
from asterism.labelling.body.model import BodyModel
from asterism.labelling.partial.matrix import PartialSolvers
from asterism.labelling.training.calibration import MAX_SLOPE, PIECES, Calibration, LabelCalibration
from asterism.labelling.training.learning import TrainingConfig, TrainingState
from asterism.labelling.training.model_file import VIRTUAL_SINCE, reading, write_arrays
from asterism.labelling.training.model_state import ModelState
from asterism.labelling.training.sample import Sample
from asterism.labelling.training.state_checks import check_state
from asterism.labelling.whole.certainty import Certainty
from asterism.labelling.whole.verdict import RigidDistances, VerdictRules
from asterism.recording import Floats, Ints, MarkerSet, Place

_SOLVER_PREFIXES = {"partial-solvers": "partial_", "thesis": "thesis_"}
"""How the arrays of a model's partial solvers begin, by the rules that use them."""

_DISTANCES = ("first", "second", "median", "moving", "limit", "unit")
"""What of `RigidDistances` is in the file."""


def save_state(state: ModelState, path: str | os.PathLike[str]) -> None:
    """Write a model file. Raises AsterismError where the place cannot be written."""
    write_arrays(path, _head(state), _arrays(state))


def _head(state: ModelState) -> dict[str, Any]:
    """What is plain text in the file."""
    return {
        "marker_set": _plain_marker_set(state.marker_set),
        "usual_score": state.usual_score,
        "least_confidence": state.least_confidence,
        "least_confidence_in_time": state.certainty.least_confidence,
        "steep_in_time": state.certainty.max_slope,
        "look": asdict(state.frame_settings),
        "about": state.about,
        "recipe": None if state.training is None else state.training.config.to_dict(),
    }


def _arrays(state: ModelState) -> dict[str, Any]:
    """What is arrays in the file."""
    arrays: dict[str, Any] = {
        "markers": state.markers,
        **{f"body_{name}": array for name, array in state.body.to_arrays().items()},
        "anchor_triples": state.anchors.triples,
        "anchor_low": state.anchors.low,
        "anchor_high": state.anchors.high,
    }
    for rules, prefix in _SOLVER_PREFIXES.items():
        if rules in state.solvers:
            arrays |= {f"{prefix}{name}": array for name, array in state.solvers[rules].to_arrays().items()}
    for i, calibration in enumerate(state.calibrations):
        arrays[f"calibration_{i}"] = np.stack([calibration.margin, calibration.right])
    if state.frame_calibration is not None:
        arrays |= _calibration_arrays("frame", state.frame_calibration)
    # Models of an earlier Asterism have two curves instead of weights.
    if isinstance(state.certainty.calibration, LabelCalibration):
        arrays |= _calibration_arrays("time", state.certainty.calibration)
    else:
        for i, calibration in enumerate(state.certainty.calibration):
            arrays[f"time_calibration_{i}"] = np.stack([calibration.margin, calibration.right])
    if state.general_body is not None:
        arrays |= {f"general_{name}": array for name, array in state.general_body.to_arrays().items()}
    # Virtual people are in no sample: whoever knows the marker set can make them again.
    if state.training is not None and state.training.sample.clips:
        arrays |= {f"sample_{name}": array for name, array in state.training.sample.to_arrays().items()}
    if state.distances is not None:
        arrays |= {f"distances_{name}": np.asarray(getattr(state.distances, name)) for name in _DISTANCES}
    return arrays


def load_state(path: str | os.PathLike[str]) -> ModelState:
    """Read a model file. Raises AsterismError where it is missing, damaged, no model, or of a later version."""
    with reading(path) as (head, arrays):
        marker_set = _marker_set(head["marker_set"])
        body = _body(arrays, "body_")
        anchors = Anchors(arrays["anchor_triples"], arrays["anchor_low"], arrays["anchor_high"])
        # Shapes first: the kernels do not check what they index.
        _check_shapes(len(marker_set), arrays["markers"], body, anchors)
        calibrations, least_confidence = _two_curves(arrays, "calibration"), float(head["least_confidence"])
        sample = _with_prefix(arrays, "sample_")
        config = TrainingConfig.from_dict(head["recipe"]) if head.get("recipe") else None
        training = None
        # A model of virtual people alone has no sample, and learns on; one of an earlier Asterism does not.
        if config is not None and (sample or head["version"] >= VIRTUAL_SINCE):
            training = TrainingState(Sample.from_arrays(sample, len(marker_set)) if sample else Sample(), config)
        state = ModelState(
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
            distances=_distances(arrays, len(arrays["markers"])),
        )
        # Then what only the whole can show, such as solvers of other markers.
        check_state(state)
        return state


def _plain_marker_set(marker_set: MarkerSet) -> dict[str, Any]:
    return {
        "names": marker_set.names,
        "title": marker_set.title,
        "aliases": dict(marker_set.aliases),
        "pairs": marker_set.pairs,
        "segments": dict(marker_set.segments),
        "places": {name: asdict(place) for name, place in marker_set.places.items()},
        "optional": marker_set.optional,
    }


def _marker_set(plain: dict[str, Any]) -> MarkerSet:
    return MarkerSet(
        tuple(plain["names"]),
        plain["title"],
        {name: tuple(others) for name, others in plain["aliases"].items()},
        tuple((left, right) for left, right in plain["pairs"]),
        {name: tuple(members) for name, members in plain["segments"].items()},
        # Models of an earlier Asterism do not say where markers sit, nor which are often left out.
        {name: _place(place) for name, place in plain.get("places", {}).items()},
        tuple(plain.get("optional", ())),
    )


def _place(plain: dict[str, Any]) -> Place:
    ahead, left, up = plain["at"]
    return Place(plain["segment"], (float(ahead), float(left), float(up)), float(plain["spread"]), bool(plain["wand"]), str(plain["plate"]))


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


def _distances(arrays: dict[str, Any], markers: int) -> RigidDistances | None:
    """The near-rigid distances of a model file; None where they are those of its sample."""
    given = _with_prefix(arrays, "distances_")
    if not given:
        return None
    first, second, median = given["first"], given["second"], given["median"]
    pairs_fit = first.shape == second.shape == median.shape[1:] and len(median) > 0 and not np.isinf(median).any()
    if not pairs_fit or not ((first >= 0) & (first < second) & (second < markers)).all() or not float(given["unit"]) > 0:
        raise ValueError("its distances disagree")
    return RigidDistances(
        first, second, median, bool(given["moving"]), float(given["limit"]), float(given["unit"]), VerdictRules()
    ).with_limit()


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
