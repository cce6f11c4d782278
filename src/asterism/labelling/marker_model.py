"""The model of a marker set: labelled recordings in; labels of unlabelled recordings, with calibrated confidence, out."""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from asterism.errors import AsterismError
from asterism.findings import Finding, Severity
from asterism.geometry import rotate_z_up
from asterism.labelling import recording_labeller
from asterism.labelling.body.labeller import BodyLabeller, usual_fits
from asterism.labelling.body.model import length_scale
from asterism.labelling.body.subject import SubjectRules
from asterism.labelling.partial.matrix import label_by_matrix
from asterism.labelling.recording_labeller import METHODS, LabellingSettings, RecordingLabeller
from asterism.labelling.training.learning import TrainingConfig, TrainingRules, TrainingState
from asterism.labelling.training.markers import learned_marker_set
from asterism.labelling.training.model_state import ModelState
from asterism.labelling.training.people import one_person_each
from asterism.labelling.training.sample import Sample
from asterism.labelling.training.state_file import load_state, save_state
from asterism.labelling.training.train import train_model
from asterism.labelling.training.virtual import with_known_places
from asterism.labelling.whole.label import subject_body, subject_body_gain
from asterism.labelling.whole.point_labels import BodyInRecording
from asterism.labelling.whole.verdict import RigidDistances, VerdictRules, judge
from asterism.progress import Progress
from asterism.recording import NULL, Clouds, Floats, Ints, Labelling, MarkerSet, Recording, subject_of

if TYPE_CHECKING:
    from asterism.labelling.live.stream import Stream
    from asterism.labelling.live.study import Studies, StudyPlace

OTHER_SUBJECT_FIT = 0.2
"""`subject_fit` below which another person is assumed. Walks of the gait subjects, after a standing trial: 0.27 to 0.41 for the same
person, below 0.2 for 96 % of other people's."""


class MarkerModel:
    """Labels recordings of a marker set that it has learned.

    `fit` learns from labelled recordings. `label` labels whole recordings, `label_frames` each frame by itself, and `stream` live points.
    `save` and `load` write and read a model file. A model never changes: `learn` and `adapt` return new ones.

    >>> from asterism.labelling import TrainingRules
    >>> from asterism.simulation import simulate_walks
    >>> *people, ann = simulate_walks(4, frames=60, markers="helen-hayes", seed=0)
    >>> quick = TrainingRules(virtual_people=0, folds=2, trial_frames=10, stretches=1, stretch_frames=30)  # for the example only
    >>> model = MarkerModel.fit(people, training=quick)
    >>> labelling = model.label(ann)
    >>> right = labelling.indices == np.arange(15)  # the clouds have the points in the order of the markers
    >>> bool(right.mean() > 0.9), bool(labelling.confidence[right].mean() > 0.9)
    (True, True)
    """

    def __init__(self, state: ModelState) -> None:
        self.state = state

    @property
    def marker_set(self) -> MarkerSet:
        """Names of the markers."""
        return self.state.marker_set

    @property
    def about(self) -> dict[str, Any]:
        """What the model was trained on, in plain values: seed, subjects, counts of recordings and frames, markers left out, ..."""
        return self.state.about

    @property
    def least_confidence(self) -> float:
        """Confidence below which a label of a single frame is taken back."""
        return self.state.least_confidence

    @cached_property
    def body_labeller(self) -> BodyLabeller:
        """The model in the form that the kernels of single frames read."""
        state, distances = self.state, self.rigid_distances
        names = [self.marker_set.names[marker] for marker in state.markers]
        return BodyLabeller.from_model(
            state.body,
            state.anchors,
            state.frame_settings.with_usual_score(state.usual_score),
            many_people=distances is not None and distances.spread is not None,
            often_left_out=np.isin(names, self.marker_set.optional),
        )

    @cached_property
    def rigid_distances(self) -> RigidDistances | None:
        """The near-rigid distances of the training, by which a recording is judged; None in a model that keeps no sample of it."""
        training, state = self.state.training, self.state
        if state.distances is not None:
            return state.distances
        if training is None or not training.sample.clips:
            return None
        frames, people = training.sample.frames()
        unit = length_scale(state.body.mean[0], state.body_rules)
        return RigidDistances.of_training(frames[:, state.markers], people, unit, VerdictRules())

    @classmethod
    def fit(
        cls,
        recordings: Sequence[Recording],
        *,
        seed: int = 0,
        target_hit_rate: float = 0.999,
        miner: str | None = None,
        subjects: Sequence[str] | None = None,
        marker_set: MarkerSet | None = None,
        training: TrainingRules | None = None,
        progress: Progress | None = None,
    ) -> MarkerModel:
        """Learn from labelled recordings, starting from virtual people where it is known where the markers sit.

        Virtual people (`virtual_model`) know bodies, postures and movements that the recordings do not show; the recordings know how these
        people wear the markers. `training.virtual_people` is their number, 0 for none. The places are those of the marker set, else of the
        shipped set that knows at least half of its names; a marker without a place is put where the recordings show it.
        `about["virtual_people"]` says from how many the model started. The confidence is calibrated on real people only.

        target_hit_rate  share of the labels given that should be right, from 0.5 to below 1
        miner            "bottom-up", "top-down" or "genetic" also searches the partial solvers that the rules "partial-solvers" and
                         "thesis" need, which takes most of the training's time. `TrainingRules.features` asks for them too: the miner
                         is then "bottom-up" where it is None
        subjects         the person of each recording; by default what its metadata says, else its folder. The confidence is calibrated on
                         people left out in turn, so a model of several people has an honest one. A recording of several people is split by
                         the prefixes of its labels ("Ann:LKNE", "Bob:LKNE")
        marker_set       markers to learn; by default the recordings' labels. Where these differ, the markers that enough people show, see
                         `learned_markers`; `about["left_out_markers"]` names the others. A marker is learned from the recordings that
                         have it

        The same recordings and seed give the same model, bit for bit.
        Raises AsterismError where there is nothing to learn from, or the recordings share fewer than four markers.
        """
        config = TrainingConfig(seed, target_hit_rate, miner, training or TrainingRules())
        recordings, subjects = _of_one_person_each(recordings, subjects)
        left_out: tuple[str, ...] = ()
        if marker_set is None:
            marker_set, left_out = learned_marker_set(recordings, subjects)
        if config.rules.virtual_people:
            marker_set = with_known_places(marker_set)
        state = TrainingState(Sample(), config).with_recordings(recordings, subjects, marker_set)
        return cls(train_model(marker_set, state, progress, left_out=left_out))

    def learn(
        self,
        recordings: Sequence[Recording],
        *,
        subjects: Sequence[str] | None = None,
        search_again: bool = False,
        progress: Progress | None = None,
    ) -> MarkerModel:
        """A new model that has learned these labelled recordings, too; this one stays as it is.

        The model carries a sample of its training, so the old files are not needed. Learning is training on all recordings ever given, and
        their order does not matter, bit for bit. A recording given twice counts once. Recordings may lack markers, and be of new people or
        of known ones (`subjects`, one name each; by default as for `fit`). The confidence is calibrated anew on people left out, so a model
        of one person becomes honest as other people are added. Partial solvers stay as they were found, unless `search_again`, which takes
        as long as in `fit`.
        Raises AsterismError where there is nothing to learn from, a recording has none of the markers, the model was written by an
        Asterism that kept no sample, or `search_again` is given and the model was trained without partial solvers.
        """
        if self.state.training is None:
            raise AsterismError("this model was written by an earlier Asterism and keeps nothing to learn on from; train it again.")
        if search_again and self.state.training.config.miner is None:
            raise AsterismError(
                "this model was trained without partial solvers; train it again with --partial-solvers bottom-up to add them."
            )
        recordings, subjects = _of_one_person_each(recordings, subjects)
        training = self.state.training.with_recordings(recordings, subjects, self.marker_set)
        earlier = None if search_again else self.state
        return MarkerModel(
            train_model(self.marker_set, training, progress, earlier=earlier, left_out=self.about.get("left_out_markers", ()))
        )

    def adapt(self, static: Recording, rules: SubjectRules | None = None) -> MarkerModel:
        """A new model for one subject: its body model is narrowed to this person's by one recording, usually of the person standing.

        static: labelled with at least half of the model's markers, else it is labelled first, as a whole recording. Markers may be
        missing. rules: how a body is narrowed to a person.
        Raises AsterismError where too few markers are visible or the labels fit no body that the model knows.
        """
        state, rules = self.state, rules or SubjectRules()
        columns = self.marker_set.columns_of(static.labels)[state.markers]
        if (columns >= 0).sum() >= 0.5 * len(columns):
            frames = np.where(columns[:, None] >= 0, static.positions[:, columns], np.nan)
        else:
            clouds = static.clouds()
            frames = self.label_one_body(clouds).positions(clouds)[:, state.markers]
        frames = rotate_z_up(frames, static.vertical)
        settings = self.body_labeller.settings
        body = subject_body(settings, state.body, frames, static.rate, rules, state.body_rules)
        gain = subject_body_gain(settings, body, state.body, frames, static.rate, rules)
        about = {**state.about, "adapted_to": subject_of(static), "adapted_gain": gain}
        return MarkerModel(replace(state, body=body, general_body=state.body, about=about))

    def subject_fit(self, clouds: Clouds, labelling: Labelling, rules: SubjectRules | None = None) -> float:
        """How much better the subject's own body explains these labels than the body of people at large does.

        1 means as much better as in the recording that the model was adapted by. Below `OTHER_SUBJECT_FIT` it is another person, or the
        markers were placed anew. NaN where the model is not adapted, or no frame shows enough labelled markers.
        """
        state = self.state
        if state.general_body is None:
            return float("nan")
        frames = rotate_z_up(labelling.positions(clouds)[:, state.markers], clouds.vertical)
        gain = subject_body_gain(self.body_labeller.settings, state.body, state.general_body, frames, clouds.rate, rules or SubjectRules())
        return gain / max(float(self.about["adapted_gain"]), 1.0)

    def label(self, recording: Clouds | Recording, *, workers: int = 1, progress: Progress | None = None, **earlier: Any) -> Labelling:
        """Label a recording as `asterism label` does: as a whole, by its tracks.

        recording: T frames of points; names that its points have already play no part. Gives indices (T, M), -1 where it does not know,
        and confidence (T, M): a probability. Points are linked to tracklets (`Clouds.tracks` help, and are cut where they swap). The
        tracklets are labelled together, and the most certain ones adapt the model to the person (`labelling/whole`). More than two million
        points are labelled in stretches of minutes (`labelling/stretches.py`). Where the recording certainly shows two people with these
        markers, the one who shows more is labelled; `Labelling.findings` says so, and `label_together` labels both. The result depends
        neither on the order of the points nor on `workers`. Other settings are given to `RecordingLabeller`. O(T); a frame of n points
        costs O(n M) beyond the search, which has a budget. Raises NoMarkers where no frame has a point.
        """
        if earlier:
            return self._label_as_earlier(recording, earlier, workers, progress)
        clouds = recording.clouds() if isinstance(recording, Recording) else recording
        return RecordingLabeller(self, LabellingSettings(workers=workers)).label(clouds, progress)

    def label_one_body(self, clouds: Clouds, progress: Progress | None = None, *, settings: LabellingSettings | None = None) -> Labelling:
        """Label clouds as those of one body, all at once. Raises SeveralBodies where they certainly show two."""
        return recording_labeller.label_together([self], clouds, settings or LabellingSettings(), progress)[0]

    def _label_as_earlier(
        self, recording: Clouds | Recording, options: dict[str, Any], workers: int, progress: Progress | None
    ) -> Labelling:
        """`label` with the options that it had before 0.2: `time` and `rules`."""
        unknown = options.keys() - {"time", "rules"}
        if unknown:
            raise TypeError(f"MarkerModel.label takes workers and progress, not {', '.join(sorted(unknown))}.")
        time, method = options.get("time", False), options.get("rules", METHODS[0])
        if time and method != METHODS[0]:
            raise AsterismError(
                f"whole recordings are labelled by the method whole-body, not {method}; use label_frames for single frames."
            )
        if time:
            return self.label(recording, workers=workers, progress=progress)
        message = "label() labels whole recordings; label_frames(clouds, method=...) labels each frame by itself."
        warnings.warn(message, DeprecationWarning, stacklevel=3)
        return self.label_frames(recording, method=method, workers=workers, progress=progress)

    def label_frames(
        self, recording: Clouds | Recording, *, method: str = METHODS[0], workers: int = 1, progress: Progress | None = None
    ) -> Labelling:
        """Label each frame by itself, without time and tracks.

        recording: T frames of points. method: "whole-body", or by the votes of partial solvers "partial-solvers" or "thesis". Gives indices
        (T, M) and confidence (T, M): a probability by "whole-body". By the others it is the share of votes, NaN for a label that no solver
        proposed. Labels whole recordings less well than `label`.
        Raises AsterismError for an unknown method, or where the model lacks the partial solvers that the method needs.
        """
        return self.label_frames_with_cost(recording, method=method, workers=workers, progress=progress)[0]

    def label_frames_with_cost(
        self, recording: Clouds | Recording, *, method: str = METHODS[0], workers: int = 1, progress: Progress | None = None
    ) -> tuple[Labelling, Ints]:
        """`label_frames`, and the number of feature evaluations of each frame (T,)."""
        clouds = recording.clouds() if isinstance(recording, Recording) else recording
        if method not in METHODS:
            raise AsterismError(f"there is no method {method!r}; choose from {', '.join(METHODS)}.")
        if method != METHODS[0]:
            return self._label_by_votes(clouds, method)
        rows, confidence, counters = self._best_labels(clouds, workers, progress)
        verdict = None
        if self.rigid_distances is not None:  # what all frames say changes no label; what each of them says has limited its own
            best = Labelling(rows, confidence, self.marker_set.names)
            verdict = judge(best.positions(clouds)[:, self.state.markers], clouds.counts, self.rigid_distances)
        indices = np.where(confidence >= self.least_confidence, rows, NULL)
        verdict = verdict.without_labels() if verdict is not None and not (indices != NULL).any() else verdict
        return Labelling(indices, confidence, self.marker_set.names, verdict=verdict), counters[:, 0]

    def _label_by_votes(self, clouds: Clouds, method: str) -> tuple[Labelling, Ints]:
        """Label by the partial solvers' proposals: the matrix of section 4.5.4 ("thesis"), or completed by the strong classifier."""
        solvers = self.state.solvers.get(method)
        if solvers is None:
            raise AsterismError(
                f"this model has no partial solvers, which the method {method!r} needs; train it again with --partial-solvers bottom-up."
            )
        votes = label_by_matrix(clouds, solvers, rules="completed" if method == "partial-solvers" else "printed")
        # what no solver proposed, a label that completion gave or a marker that none reached, has no share of votes
        share = np.where(votes.votes > 0, votes.votes, np.nan)
        confidence = np.where(votes.indices < 0, 0.5 * share, share)
        return Labelling(*self._in_marker_set(votes.indices, confidence, np.nan), self.marker_set.names), votes.evaluations

    def _best_labels(self, clouds: Clouds, workers: int = 1, progress: Progress | None = None) -> tuple[Ints, Floats, Ints]:
        """The best labelling of each frame before doubtful labels are taken back: indices, confidence (T, M), counters (T, 4)."""
        found = self.body_labeller.label(clouds, workers, progress)
        rows, margins, counters, left_over = found.point_of, found.margins, found.counters, found.points_left
        state = self.state
        if state.frame_calibration is not None:
            fits = usual_fits(found, clouds, state.usual_score)
            confidence = state.frame_calibration.confidence(margins, fits, np.broadcast_to(left_over[:, None], margins.shape))
        else:
            without, with_left_over = state.calibrations
            confidence = np.where(left_over[:, None], with_left_over.confidence(margins), without.confidence(margins))
        if self.rigid_distances is not None:
            positions = Labelling(rows, confidence, tuple(self.marker_set.names[m] for m in state.markers)).positions(clouds)
            confidence = np.minimum(confidence, self.rigid_distances.confidence_limits(self.rigid_distances.scatters(positions))[:, None])
        # a null has no margin of its own: the best free point's chance of being the marker, never above one half
        confidence = np.where(rows >= 0, confidence, 0.5 * np.exp(np.minimum(margins, 0.0)))
        return *self._in_marker_set(rows, confidence), counters

    def _in_marker_set(self, rows: Ints, confidence: Floats, unknown: float = 0.0) -> tuple[Ints, Floats]:
        """Indices and confidence (T, learned markers) as columns of all markers of the set; `unknown`: the confidence of the others."""
        shape = (len(rows), len(self.marker_set))
        indices, whole = np.full(shape, NULL, dtype=np.int64), np.full(shape, unknown)
        indices[:, self.state.markers], whole[:, self.state.markers] = rows, confidence
        return indices, whole

    def stream(self, rate: float, delay: int = 0, vertical: ArrayLike | str = "z", studies: StudyPlace | Studies | None = None) -> Stream:
        """A labeller for live points: `stream.push(points)` gives the labels of the frame `delay` pushes ago.

        rate: frames per second; delay: frames to wait for, which make the labels more certain; vertical: the axis that points up.
        studies: where the last seconds are labelled as a whole, as `label` does, again and again; what this says of the person and of the
        tracks is taken over. "process": in a process beside this one, which `stream.close()` ends; "push": in `push`, which then takes as
        long; "none". Without, labels of the first second and of markers that come and go are less sure.
        Raises AsterismError for a rate or delay that is not positive, or an unknown axis.
        """
        from asterism.labelling.live.stream import Stream, StreamModel, check_timing
        from asterism.labelling.live.study_process import make_studies

        check_timing(rate, delay)
        if isinstance(studies, str):
            studies = make_studies(studies, rate, self)
        state = self.state
        model = StreamModel(
            self.body_labeller,
            state.markers,
            len(self.marker_set),
            state.calibrations,
            self.least_confidence,
            state.body_rules,
            self.rigid_distances,
        )
        return Stream(model, rate, delay, vertical, studies=studies)

    def findings(self, where: str = "the model") -> list[Finding]:
        """What a person should know of the model before they use it. where: its file."""
        if self.state.training is not None:
            return []
        sentence = f"{where} was written by an earlier Asterism: it labels, but learns nothing, and does not judge recordings."
        return [Finding("model-earlier-version", Severity.NOTE, where, sentence, "Train it again with `asterism train`.")]

    def in_recording(self) -> BodyInRecording:
        """This model as one of the bodies that `label_whole` looks for."""
        state = self.state
        return BodyInRecording(
            self.body_labeller, self.marker_set.names, state.markers, state.certainty, state.frame_certainty, self.rigid_distances
        )

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the model: one NPZ file of plain arrays and a JSON text, no pickle. Written under a temporary name, then renamed.

        Raises AsterismError where the place cannot be written.
        """
        save_state(self.state, path)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> MarkerModel:
        """Read a model. Raises AsterismError where the file is missing, damaged, no model, or of a later version."""
        return cls(load_state(path))


def _of_one_person_each(
    recordings: Sequence[Recording], subjects: Sequence[str] | None
) -> tuple[Sequence[Recording], Sequence[str] | None]:
    """See `one_person_each`; what does not give one subject for each recording is left to `TrainingState.with_recordings` to refuse."""
    if subjects is not None and len(subjects) != len(recordings):
        return recordings, subjects
    return one_person_each(recordings, subjects)


def label_together(models: Sequence[MarkerModel], clouds: Clouds, *, workers: int = 1, progress: Progress | None = None) -> list[Labelling]:
    """Label a recording with several bodies in it: one labelling per model, each point given to one of them at most.

    clouds: T frames. A model may be given twice, for two people who wear the same markers. The recording is labelled as a
    whole, see `MarkerModel.label`. Raises SeveralBodies where one model is given, and the recording certainly shows two such bodies.
    """
    return recording_labeller.label_together(models, clouds, LabellingSettings(workers=workers), progress)
