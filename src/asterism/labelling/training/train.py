"""The state of a training in; all that a model learns from it out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from asterism.errors import AsterismError
from asterism.labelling.body.model import BodyModel, length_scale
from asterism.labelling.features.registry import MANY_MARKERS, THESIS
from asterism.labelling.partial.matrix import PartialSolvers
from asterism.labelling.partial.search_strategies import search_partial_solvers
from asterism.labelling.partial.solver_search import PRINTED, PRINTED_FEATURES, SearchSettings
from asterism.labelling.training.calibration import BESIDE_VIRTUAL_IN_FRAMES, BESIDE_VIRTUAL_IN_TIME, stream_curves_of_virtual
from asterism.labelling.training.learning import (
    TrainingConfig,
    TrainingState,
    beside,
    fit_whole,
    learn_body,
    least_confidence,
    usual_score_of,
)
from asterism.labelling.training.model_state import ModelState
from asterism.labelling.training.sample import Sample
from asterism.labelling.training.virtual import STRANGERS, STRANGERS_SEED, VirtualFrames, check_places, virtual_frames
from asterism.labelling.whole.certainty import Certainty, least_confidence_in_time
from asterism.labelling.whole.verdict import RigidDistances, VerdictRules
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
    searching = config.miner is not None and earlier is None
    virtual, known = None, None
    # Virtual people who lack most of the markers would teach little beside them.
    if config.rules.virtual_people and 2 * len(marker_set.places) >= len(marker_set):
        virtual = virtual_frames(marker_set, config.rules.virtual_people, config.seed)
        # Partial solvers are searched on real people, who must show their markers.
        known = None if config.miner is not None else np.nonzero(~np.isnan(virtual.frames[:, :, 0]).all(axis=0))[0]
    markers, frames_with_motion, people, stretches = training.training_frames(known)
    # The body has no motion in it: only the partial solvers read it.
    frames = np.ascontiguousarray(frames_with_motion[..., :3])
    # The search for solvers takes about as long as all else together.
    share = 0.5 if searching else 1.0
    if virtual is not None:
        virtual = VirtualFrames(np.ascontiguousarray(virtual.frames[:, markers]), virtual.people)
    learned = learn_body(frames, people, stretches, config, lambda fraction, what: report(share * fraction, what), virtual)
    about = {**_about(training, len(frames), left_out), "virtual_people": 0 if virtual is None else config.rules.virtual_people}
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
        distances=None
        if virtual is None
        else _distances(learned.body, *beside(virtual, frames, people, config.rules, config.seed)[:2], config),
    )


def train_on_virtual_people(marker_set: MarkerSet, config: TrainingConfig, progress: Progress | None = None) -> ModelState:
    """A model of `config.rules.virtual_people` virtual people alone, for a set that says of every marker where it sits.

    Its confidence is that of models of virtual people on real ones, see `BESIDE_VIRTUAL_IN_FRAMES`: nobody is left out and tried.
    Raises AsterismError where a marker has no place.
    """
    report = progress or (lambda fraction, what: None)
    check_places(marker_set)
    rules, count = config.rules, config.rules.virtual_people
    report(0.0, "drawing virtual people")
    shown = virtual_frames(marker_set, count, config.seed)
    strangers = virtual_frames(marker_set, STRANGERS, config.seed + STRANGERS_SEED)
    report(0.2, "learning the body")
    body, anchors = fit_whole(shown.frames, shown.people, config)
    report(0.9, "taking the usual score")
    usual_score = usual_score_of(body, strangers.frames, rules, np.random.default_rng(config.seed))
    if usual_score is None:
        raise AsterismError(f"{marker_set.title or 'the marker set'} has too few markers to score a labelled frame by; give four or more.")
    about = {
        **_about(TrainingState(Sample(), config), len(shown.frames), ()),
        "partial_solvers": {},
        "virtual_people": count,
    }
    report(1.0, "done")
    return ModelState(
        marker_set=marker_set,
        markers=np.arange(len(marker_set), dtype=np.int64),
        body=body,
        anchors=anchors,
        usual_score=usual_score,
        calibrations=stream_curves_of_virtual(),
        least_confidence=least_confidence(config.target_hit_rate),
        frame_settings=rules.frames,
        certainty=Certainty(BESIDE_VIRTUAL_IN_TIME.alone(), least_confidence_in_time(config.target_hit_rate)),
        about=about,
        training=TrainingState(Sample(), config),
        frame_calibration=BESIDE_VIRTUAL_IN_FRAMES.alone(),
        distances=_distances(body, shown.frames, shown.people, config),
    )


def _distances(body: BodyModel, frames: Floats, people: Ints, config: TrainingConfig) -> RigidDistances:
    """The near-rigid distances of people of whom no sample is kept."""
    return RigidDistances.of_training(frames, people, length_scale(body.mean[0], config.rules.body), VerdictRules())


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
