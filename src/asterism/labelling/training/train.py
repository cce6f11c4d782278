"""The state of a training in; all that a model learns from it out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from asterism.labelling.features.registry import MANY_MARKERS, THESIS
from asterism.labelling.partial.matrix import PartialSolvers
from asterism.labelling.partial.solver_search import PRINTED, PRINTED_FEATURES, SearchSettings, search_partial_solvers
from asterism.labelling.training.learning import TrainingConfig, TrainingState, learn_body, least_confidence
from asterism.labelling.training.model_state import ModelState
from asterism.progress import Progress
from asterism.recording import Floats, Ints, MarkerSet


def train_model(
    marker_set: MarkerSet,
    training: TrainingState,
    progress: Progress | None = None,
    *,
    earlier: ModelState | None = None,
    left_out: Sequence[str] = (),
) -> ModelState:
    """Learn the body, the confidence and, where the configuration names a miner, partial solvers.

    earlier   a state whose partial solvers are kept instead of searching new ones
    left_out  markers of the recordings that the marker set lacks, for `about`
    Raises AsterismError where the sample shows too little.
    """
    report = progress or (lambda fraction, what: None)
    config = training.config
    markers, frames_with_motion, people, stretches = training.training_frames()
    # The body has no motion in it: only the partial solvers read it.
    frames = np.ascontiguousarray(frames_with_motion[..., :3])
    searching = config.miner is not None and earlier is None
    # The search for solvers takes about as long as all else together.
    share = 0.5 if searching else 1.0
    learned = learn_body(frames, people, stretches, config, lambda fraction, what: report(share * fraction, what))
    about = _about(training, len(frames), left_out)
    solvers: dict[str, PartialSolvers] = {}
    names = [marker_set.names[marker] for marker in markers]
    if searching:
        targets = config.targets_of(names)
        solvers = _search(config, frames_with_motion, people, targets, lambda fraction, what: report(0.5 + 0.5 * fraction, what))
        about["partial_solvers_from"] = about["recordings"]
    elif earlier is not None and earlier.solvers:
        # they know the markers by their place among those that the earlier training showed
        solvers = dict(earlier.solvers) if np.array_equal(markers, earlier.markers) else {}
        before = earlier.about.get("partial_solvers_from", earlier.about.get("mined_from", 0))
        about["partial_solvers_from"] = before if solvers else 0
    # Also where solvers were kept: the summary is by the names of this model's markers.
    about["partial_solvers"] = {rules: model.summary(names) for rules, model in solvers.items()}
    report(1.0, "done")
    return ModelState(
        marker_set=marker_set,
        markers=markers,
        body=learned.body,
        anchors=learned.anchors,
        usual_score=learned.usual_score,
        calibrations=learned.calibrations,
        least_confidence=least_confidence(config.target_hit_rate),
        frame_settings=config.rules.frames,
        certainty=learned.certainty,
        about=about,
        solvers=solvers,
        training=training,
        frame_calibration=learned.frame_calibration,
    )


def _about(training: TrainingState, frames: int, left_out: Sequence[str]) -> dict[str, Any]:
    config = training.config
    return {
        "seed": config.seed,
        "target_hit_rate": config.target_hit_rate,
        "miner": config.miner,
        "features": None if config.rules.features is None else list(config.rules.features),
        "subjects": list(training.sample.subjects),
        "recordings": len(training.sample.recordings),
        "frames": frames,
        "left_out_markers": list(left_out),
    }


def _search(config: TrainingConfig, frames: Floats, people: Ints, targets: Floats, progress: Progress) -> dict[str, PartialSolvers]:
    """The partial solvers of a training, by the rules that use them; frames (N, M, 3) m, z up, or with their motion; targets (M,)."""
    own, features = config.rules.solver_rules, config.rules.features
    # Features of four points are too many to try with large sets.
    printed = PRINTED_FEATURES if frames.shape[1] <= MANY_MARKERS else THESIS
    how = {
        "partial-solvers": (features, replace(SearchSettings(), widen=config.rules.solver_widen)),
        "thesis": (printed if features is None else features, PRINTED),
    }
    found = {}
    for number, rules in enumerate(own):
        # Bound as a default: a closure would see the number of a later turn.
        def report(fraction: float, what: str, done: int = number) -> None:
            progress((done + fraction) / len(own), what)

        read, settings = how[rules]
        found[rules] = search_partial_solvers(
            frames,
            people,
            features=read,
            targets=targets,
            miner=str(config.miner),
            settings=settings,
            seed=config.seed,
            progress=report,
        )
    return found
