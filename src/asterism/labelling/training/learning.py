"""A sample of labelled frames in; a body model, its anchors and a confidence calibrated on people left out, out."""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from asterism.errors import AsterismError
from asterism.labelling.body._score_kernels import best_pose
from asterism.labelling.body._workspace_kernels import make_body_workspace
from asterism.labelling.body.anchors import AnchorRules, Anchors, choose_anchors, with_intervals
from asterism.labelling.body.labeller import BodyLabeller, FrameLabellingSettings
from asterism.labelling.body.model import BodyModel, BodyRules, fit_body, subsample
from asterism.labelling.body.subject import SubjectRules
from asterism.labelling.partial.features import kinds_of, needs_motion
from asterism.labelling.partial.motion_points import frames_with_motion
from asterism.labelling.partial.solver import subject_of
from asterism.labelling.simulated_occlusions import simulate_occlusions
from asterism.labelling.training.calibration import Calibration
from asterism.labelling.training.sample import FEWEST_SHOWN, Sample
from asterism.labelling.whole.certainty import Certainty, TrialLabels
from asterism.labelling.whole.label import trial
from asterism.labelling.whole.scene import TimeRules
from asterism.progress import Progress
from asterism.recording import NULL, Floats, Ints, MarkerSet, Recording


@dataclass(frozen=True)
class TrainingRules:
    """How an ensemble is learned.

    carried_per_person frames of one person that a model carries, about, in clips of half a second
    carried            frames of all people that a model carries, about
    frames_per_person  of those, training frames of one person at most, evenly spread
    folds              groups of people left out in turn to calibrate the confidence
    trial_frames       frames on which each left-out person is tried
    usually_hidden     share of the markers hidden when the usual score is taken
    usual              share of the rightly labelled frames that score less than the "usual" score
    solver_widen       intervals of the partial solvers move out by this many standard deviations over the people
    trials             (occlusions, ghosts) of the trials, occlusions as a share of the markers
    time_trials        the same for whole stretches of recordings, with gaps and ghosts that last
    stretch            frames of one stretch that is tried, at most
    stretches          stretches of each left-out person that are tried, at most
    """

    carried_per_person: int = 3000
    carried: int = 40_000
    frames_per_person: int = 1500
    folds: int = 5
    trial_frames: int = 300
    usually_hidden: float = 0.25
    usual: float = 0.05
    solver_widen: float = 1.5
    trials: tuple[tuple[float, int], ...] = ((0.0, 0), (0.07, 0), (0.14, 0), (0.2, 0), (0.27, 0), (0.34, 0), (0.0, 3), (0.2, 3))
    time_trials: tuple[tuple[float, int], ...] = ((0.2, 0), (0.2, 3))
    stretch: int = 300
    stretches: int = 2


@dataclass(frozen=True)
class TrainingConfig:
    """All that a training depends on besides its recordings."""

    seed: int = 0
    target_hit_rate: float = 0.999
    miner: str | None = None
    body: BodyRules = field(default_factory=BodyRules)
    look: FrameLabellingSettings = field(default_factory=FrameLabellingSettings)
    training: TrainingRules = field(default_factory=TrainingRules)
    features: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        if self.features is not None:
            kinds_of(self.features)
        if not 0.5 <= self.target_hit_rate < 1.0:
            raise AsterismError(f"a target hit rate of {self.target_hit_rate} makes no sense; give one from 0.5 to below 1, such as 0.999.")

    @property
    def reads_motion(self) -> bool:
        """Whether partial solvers of this recipe look at the points' motion."""
        return self.features is not None and needs_motion(kinds_of(self.features))

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        return asdict(self)

    @classmethod
    def from_dict(cls, plain: dict[str, Any]) -> TrainingConfig:
        """The inverse of `to_dict`, also after a round through JSON."""
        features = None if plain.get("features") is None else tuple(plain["features"])
        training = TrainingRules(**plain["training"])
        trials, time_trials = (
            tuple((float(share), int(ghosts)) for share, ghosts in listed) for listed in (training.trials, training.time_trials)
        )
        training = replace(training, trials=trials, time_trials=time_trials)
        return cls(
            **{
                **plain,
                "body": BodyRules(**plain["body"]),
                "look": FrameLabellingSettings.from_dict(plain["look"]),
                "training": training,
                "features": features,
            }
        )


@dataclass(frozen=True)
class TrainingState:
    """What a model keeps of its training, so that it can learn on: a sample of the recordings, and how it was learned."""

    sample: Sample
    recipe: TrainingConfig

    def with_recordings(self, recordings: Sequence[Recording], subjects: Sequence[str] | None, marker_set: MarkerSet) -> TrainingState:
        """A memory of these recordings, too. Subjects by default as `person` says.

        Raises AsterismError where there is no recording, one shows nothing, or there is not one subject for each.
        """
        if not recordings:
            raise AsterismError("there is no recording to learn from; give at least one labelled file.")
        names = [subject_of(recording) for recording in recordings] if subjects is None else list(subjects)
        if len(names) != len(recordings):
            raise AsterismError(f"{len(names)} subjects for {len(recordings)} recordings; give one name per recording.")
        for recording in recordings:
            if (recording.visible.sum(axis=1) < FEWEST_SHOWN).all():
                raise AsterismError(
                    f"{recording.metadata.get('file', 'a recording')} has no frame that shows {FEWEST_SHOWN} labelled points; leave it out."
                )
        rules = self.recipe.training
        sample = self.sample.with_recordings(recordings, names, marker_set, rules.carried_per_person, rules.carried)
        return replace(self, sample=sample)

    def training_frames(self) -> tuple[Ints, Floats, Ints, list[tuple[int, Recording]]]:
        """What the body is learned from: markers that these frames show (M,), frames (N, M, 3) m, z up, whose each is (N,).

        The frames carry their motion, (N, M, WIDTH), where the recipe reads it. And the stretches of the recordings that they are
        from, with the person's number.

        Frames that show less than half of the markers are left out. Raises AsterismError where too little remains.
        """
        if not self.sample.clips:
            raise AsterismError("no frame shows three markers; check the marker set against the files' labels.")
        frames, people = self.sample.frames()
        if self.recipe.reads_motion:
            whole, _ = self.sample.stretches([str(marker) for marker in range(frames.shape[1])])
            frames = np.concatenate([frames_with_motion(stretch) for stretch in whole])
        shown = ~np.isnan(frames[:, :, 0])
        seen = shown.any(axis=0)
        usable = shown.sum(axis=1) >= max(3, 0.5 * seen.sum())
        if seen.sum() < 4 or usable.sum() < 10:
            raise AsterismError(
                f"{int(seen.sum())} markers are ever seen and {int(usable.sum())} frames show at least half of them; "
                "training needs 4 markers and 10 such frames: check the marker set against the files' labels."
            )
        frames, people = frames[usable], people[usable]
        rows = subsample(people, self.recipe.training.frames_per_person)
        markers = np.nonzero(shown[usable][rows].any(axis=0))[0]
        number = {self.sample.subjects[person]: i for i, person in enumerate(np.unique(people))}
        labels = tuple(str(m) for m in range(frames.shape[1]))
        stretches = [
            (number[name], stretch.select([labels[m] for m in markers]))
            for stretch, name in zip(*self.sample.stretches(labels), strict=True)
            if name in number
        ]
        return markers, np.ascontiguousarray(frames[rows][:, markers]), renumbered(people)[rows], stretches


@dataclass(frozen=True)
class LearnedBody:
    """What labels: see `learn_body`."""

    body: BodyModel
    anchors: Anchors
    usual_score: float
    calibrations: tuple[Calibration, Calibration]
    in_time: Certainty


def learn_body(
    frames: Floats, people: Ints, stretches: Sequence[tuple[int, Recording]], recipe: TrainingConfig, progress: Progress
) -> LearnedBody:
    """Learn from labelled frames: (N, M, 3) m, z up, NaN where missing; people (N,) whose each is; stretches of (person, recording).

    The body and its anchors are learned from all. Then people are left out in turn, what is learned from the others is tried on them with
    markers hidden and ghosts added, and all these trials together calibrate the confidence (frames without and with points left over).
    """
    seed = recipe.seed
    progress(0.0, "learning the body")
    body = fit_body(frames, people, recipe.body, seed)
    anchors = choose_anchors(frames, people, body, AnchorRules(), np.random.default_rng(seed))
    folds = _folds(people, recipe.training.folds)

    def try_fold(number: int) -> _FoldOutcome | None:
        return _try_fold(frames, people, stretches, folds[number], anchors.triples, recipe, seed + number, number)

    outcomes: list[_FoldOutcome] = []
    progress(0.2, "trying it on people left out")
    with ThreadPoolExecutor(min(len(folds), os.cpu_count() or 1)) as pool:
        for i, outcome in enumerate(pool.map(try_fold, range(len(folds)))):
            outcomes += [] if outcome is None else [outcome]
            progress(0.2 + 0.8 * (i + 1) / len(folds), "trying it on people left out")
    margin, right, spare = (np.concatenate(parts) for parts in zip(*(outcome.frames for outcome in outcomes), strict=True))
    calibrations = (Calibration.fit(margin[~spare], right[~spare]), Calibration.fit(margin[spare], right[spare]))
    in_time = TrialLabels.together([outcome.in_time for outcome in outcomes])
    certainty = Certainty.fit(in_time, recipe.target_hit_rate, len(np.unique(people)))
    return LearnedBody(body, anchors, float(np.median([outcome.usual_score for outcome in outcomes])), calibrations, certainty)


@dataclass(frozen=True)
class _FoldOutcome:
    """What a model learned from the other people showed on one group of people left out.

    usual_score  nats per label, see `TrainingRules.usual`
    frames       margin (nats), whether right, and whether points were left over in the frame, of each label given in single frames
    in_time      the labels of whole stretches
    """

    usual_score: float
    frames: tuple[Floats, Any, Any]
    in_time: TrialLabels


def _try_fold(
    frames: Floats,
    people: Ints,
    stretches: Sequence[tuple[int, Recording]],
    out: NDArray[np.bool_],
    triples: Ints,
    recipe: TrainingConfig,
    seed: int,
    number: int,
) -> _FoldOutcome | None:
    """Learn from the frames that are not `out` (N,), and label those that are; None where no frame of the people left out can be scored."""
    rules = recipe.training
    worn = np.nonzero(~np.isnan(frames[~out, :, 0]).all(axis=0))[0]
    others, whose = frames[np.ix_(~out, worn)], renumbered(people[~out])
    tested = frames[np.ix_(out, worn)]
    body = fit_body(others, whose, recipe.body, recipe.seed)
    scores = _scores_of_truth(body, tested, recipe.look, rules, np.random.default_rng([recipe.seed, number]))
    if len(scores) == 0:
        return None
    usual_score = float(np.quantile(scores, rules.usual))
    anchors = with_intervals(_among(triples, worn), others, whose, AnchorRules())
    model = BodyLabeller.from_model(body, anchors, recipe.look.with_usual_score(usual_score))
    in_frames = _trial(model, tested, people[out], rules, seed)
    chosen = _some_stretches(stretches, np.unique(people[out]), worn, rules)
    in_time = trial(model, chosen, rules.time_trials, TimeRules(), SubjectRules(), recipe.body, seed)
    return _FoldOutcome(usual_score, in_frames, in_time)


def least_confidence(target_hit_rate: float) -> float:
    """The confidence below which a label is taken back, so that about `target_hit_rate` of the labels given are right: most are far surer.

    A power law through what was measured on left-out people (docs/labelling.md): 0.80, 0.91, 0.96, 0.98 for 0.99 to 0.99999.
    """
    return 1.0 - (1.0 - target_hit_rate) ** 0.35


def common_marker_set(recordings: Sequence[Recording]) -> MarkerSet:
    """The labels that all recordings share, in one order. Raises AsterismError where they do not."""
    if not recordings:
        raise AsterismError("there is no recording to learn from; give at least one labelled file.")
    labels = recordings[0].labels
    for recording in recordings[1:]:
        if recording.labels != labels:
            raise AsterismError(
                f"{recording.metadata.get('file', 'a recording')} has other markers than "
                f"{recordings[0].metadata.get('file', 'the first one')}; read all of them with the same `markers`."
            )
    return MarkerSet(labels, title="the recordings' own labels")


def renumbered(people: Ints) -> Ints:
    """People numbered from 0 without a gap, in the same order."""
    return np.unique(people, return_inverse=True)[1].astype(np.int64)


def _folds(people: Ints, folds: int) -> list[Any]:
    """Masks of the frames left out: by person, in at most `folds` groups; by blocks of ten frames where there is one person only."""
    count = int(people.max()) + 1
    if count > 1:
        return [people % folds == i for i in range(min(folds, count))]
    block = np.arange(len(people)) // 10
    return [block % 2 == i for i in range(2)]


def _some_stretches(stretches: Sequence[tuple[int, Recording]], people: Ints, worn: Ints, rules: TrainingRules) -> list[Recording]:
    """The longest stretches of these people, cut to length, with the markers that the model knows."""
    chosen = []
    for someone in people:
        own = sorted((stretch for who, stretch in stretches if who == someone), key=len, reverse=True)[: rules.stretches]
        chosen += [stretch.select([stretch.labels[m] for m in worn]).frames(slice(0, rules.stretch)) for stretch in own]
    return chosen


def _among(triples: Ints, worn: Ints) -> Ints:
    """The triples of markers that are all in `worn`, numbered as there."""
    return np.searchsorted(worn, triples[np.isin(triples, worn).all(axis=1)]).astype(np.int64)


def _scores_of_truth(
    body: BodyModel, frames: Floats, look: FrameLabellingSettings, rules: TrainingRules, rng: np.random.Generator
) -> Floats:
    """Score per label, in nats, of rightly labelled frames of people left out, some of their markers hidden."""
    arrays, settings = body.arrays(), look.with_usual_score(0.0)
    scores = []
    for frame in frames[rng.choice(len(frames), min(300, len(frames)), replace=False)]:
        shown = ~np.isnan(frame[:, 0]) & (rng.random(len(frame)) >= rules.usually_hidden)
        if shown.sum() >= 3:
            rows = np.where(shown, np.cumsum(shown) - 1, NULL)
            workspace = make_body_workspace(int(shown.sum()), len(rows), arrays.load.shape[3])
            scores.append(best_pose(arrays, np.ascontiguousarray(frame[shown]), rows, settings, workspace)[1] / shown.sum())
    return np.array(scores)


def _trial(tried: BodyLabeller, frames: Floats, people: Ints, rules: TrainingRules, seed: int) -> tuple[Floats, Any, Any]:
    """Hide and haunt left-out frames and label them: margins, rightness and whether points were left over, of all labels given."""
    rng = np.random.default_rng(seed)
    margins, rights, spares = [], [], []
    rows_of = subsample(people, rules.trial_frames)
    labels = tuple(str(m) for m in range(frames.shape[1]))
    for share, ghosts in rules.trials:
        recording = Recording(frames[rows_of], labels, 100.0)
        clouds, truth = simulate_occlusions(recording, round(share * len(labels)), ghosts, rng)
        rows, margin, _, spare = tried.label(clouds)
        given = rows >= 0
        margins.append(margin[given])
        rights.append((rows == truth)[given])
        spares.append(np.repeat(spare, given.sum(axis=1)))
    return np.concatenate(margins), np.concatenate(rights), np.concatenate(spares)
