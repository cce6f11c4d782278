"""A sample of labelled frames in; a body model, its anchors and a confidence calibrated on people left out, out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from asterism.errors import AsterismError
from asterism.geometry import align_about_z
from asterism.labelling.body._score_kernels import best_pose
from asterism.labelling.body._workspace_kernels import make_body_workspace
from asterism.labelling.body.anchors import AnchorRules, Anchors, choose_anchors, with_intervals
from asterism.labelling.body.labeller import BodyLabeller, FrameLabellingSettings, usual_fits
from asterism.labelling.body.model import BodyModel, BodyRules, fit_body, subsample
from asterism.labelling.body.subject import SubjectRules
from asterism.labelling.features.motion_points import frames_with_motion
from asterism.labelling.features.registry import kinds_of, needs_motion
from asterism.labelling.partial.search_strategies import check_miner
from asterism.labelling.shared_work import each_shared, in_threads
from asterism.labelling.training.calibration import (
    BESIDE_VIRTUAL_IN_FRAMES,
    BESIDE_VIRTUAL_IN_TIME,
    IN_FRAMES,
    IN_TIME,
    Calibration,
    LabelCalibration,
    LabelTrials,
)
from asterism.labelling.training.sample import FEWEST_SHOWN, Sample
from asterism.labelling.training.trials import TrainingTrial
from asterism.labelling.training.virtual import VIRTUAL_PEOPLE, VirtualFrames, placed_by_neighbours
from asterism.labelling.whole.certainty import Certainty, least_confidence_in_time
from asterism.labelling.whole.label import run_trials
from asterism.labelling.whole.settings import RecordingLabellingSettings
from asterism.progress import Progress
from asterism.recording import NULL, Floats, Ints, MarkerSet, Recording, subject_of
from asterism.recording.arrays import nan_mean, nan_var

ONE_PLACE = 1e-3
"""m: a usual frame whose points lie within it shows no body. The smallest markers are 3 mm wide; half and double of it are the same."""

SOLVER_RULES = ("partial-solvers", "thesis")
"""The rules that label by partial solvers. Each has its own, because the thesis' intervals are those that training showed."""

SHARE_BESIDE_VIRTUAL = 0.5
"""Share of the frames of all trials that are tried where training starts from virtual people: their confidence is known from ten sets, and
a model's own trials only move it (`LabelCalibration`). All trials take as long as the rest of the training; half of this
share saves a tenth more."""

EARLIER_NAMES = {
    "carried_per_person": "sample_frames_per_person",
    "carried": "sample_frames",
    "usually_hidden": "usual_hidden_share",
    "usual": "usual_quantile",
    "stretch": "stretch_frames",
}
"""What fields of `TrainingRules` are called in models written before."""


@dataclass(frozen=True)
class TrainingRules:
    """How a model is learned. Chosen by hand on the gait subjects, each left out in turn, where no other source is named.

    sample_frames_per_person  frames of one person that a model keeps, about, in clips of half a second. Not tuned: bounds the file
    sample_frames       frames of all people that a model keeps, about. Not tuned: bounds the file
    frames_per_person   of those, training frames of one person at most, evenly spread
    folds               groups of people left out in turn to calibrate the confidence
    trial_frames        frames on which each left-out person is tried in each of `trials`, at most
    trial_labels        fewer where their markers would give more labels than this: frames of many markers take long, and tell more
    min_trial_frames    but not fewer than this. Both not tuned: bound the time of training 40 markers and more
    usual_hidden_share  share of the markers hidden when the usual score is taken
    usual_quantile      share of the rightly labelled frames that score less than the usual score
    virtual_people      virtual people who teach the body before real ones do, where the marker set says where its markers sit; 0 for none
    virtual_weight      how many real people all of them together count for. Chosen on `movement`, one person or movement taught: 1 gives
                        98.3 % of the labels of pig39, and 4, 16 and 80 give 100; 1 and 4 give 99.8 % of cmu41, and 80 gives 99.4
    solver_widen        intervals of the partial solvers move out by this many standard deviations over the people. 1.5 measured best on
                        people left out, see `SearchSettings.widen`
    trials              what single frames are tried with
    ghost_trial_weight  how much a frame with ghosts or clutter counts among these, for few real frames have any. Of 1, 0.4 and 0.15 the
                        first cost 1.7 % of the right labels of clean frames, the last 2 % of those in clutter
    time_trials         what whole stretches of recordings are tried with, in gaps and ghosts that last
    stretch_frames      frames of one stretch that is tried, at most
    stretches           stretches of each left-out person that are tried, at most
    body                how the body is learned
    frames              how single frames are labelled
    features            what partial solvers read, by name; None for `solver_search.FEATURES`, all of single frames, and for the rules
                        "thesis" `solver_search.PRINTED_FEATURES`
    solver_rules        rules whose partial solvers a miner searches, of `SOLVER_RULES`
    marker_targets      hit rates that partial solvers must reach for single markers, by name; for the others `target_hit_rate`
    """

    sample_frames_per_person: int = 3000
    sample_frames: int = 40_000
    frames_per_person: int = 1500
    folds: int = 5
    trial_frames: int = 140
    trial_labels: int = 2100
    min_trial_frames: int = 60
    usual_hidden_share: float = 0.25
    usual_quantile: float = 0.05
    virtual_people: int = VIRTUAL_PEOPLE
    virtual_weight: float = 4.0
    solver_widen: float = 1.5
    trials: tuple[TrainingTrial, ...] = (
        *(TrainingTrial(share) for share in (0.0, 0.07, 0.14, 0.2, 0.27, 0.34)),
        *(TrainingTrial(share, 3) for share in (0.0, 0.2, 0.34)),
        *(TrainingTrial(0.2, clutter=3.0, spread=spread) for spread in (0.08, 0.03)),
    )
    ghost_trial_weight: float = 0.2
    time_trials: tuple[TrainingTrial, ...] = (
        TrainingTrial(0.27),
        TrainingTrial(0.2, 3),
        TrainingTrial(0.34, 6),
        TrainingTrial(0.2, clutter=3.0, spread=0.03),
    )
    stretch_frames: int = 300
    stretches: int = 2
    body: BodyRules = field(default_factory=BodyRules)
    frames: FrameLabellingSettings = field(default_factory=FrameLabellingSettings)
    features: Sequence[str] | None = None
    solver_rules: Sequence[str] = SOLVER_RULES
    marker_targets: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "solver_rules", tuple(self.solver_rules))
        if self.virtual_people < 0 or not self.virtual_weight > 0.0:
            raise AsterismError(
                f"{self.virtual_people} virtual people who count for {self.virtual_weight:g} cannot teach; "
                "give 0 people or more, and a weight above 0."
            )
        # Checked here, where the name is given, and not hours later in the search.
        for rules in self.solver_rules:
            if rules not in SOLVER_RULES:
                raise AsterismError(f"the rules {rules!r} have no partial solvers; choose among {', '.join(SOLVER_RULES)}.")
        for marker, target in self.marker_targets.items():
            if not 0.0 < target <= 1.0:
                raise AsterismError(f"a target hit rate of {target} for {marker} cannot be reached; give one above 0, at most 1.")
        if self.features is not None:
            kinds_of(self.features)
            object.__setattr__(self, "features", tuple(self.features))


@dataclass(frozen=True)
class TrainingConfig:
    """All that a training depends on besides its recordings.

    miner  strategy of the search for partial solvers (`search_strategies.MINERS`), None for none; "bottom-up" where `rules.features` are
           named
    """

    seed: int = 0
    target_hit_rate: float = 0.999
    miner: str | None = None
    rules: TrainingRules = field(default_factory=TrainingRules)

    def __post_init__(self) -> None:
        # Naming features asks for partial solvers, which need a strategy.
        if self.miner is None and self.rules.features is not None:
            object.__setattr__(self, "miner", "bottom-up")
        check_miner(self.miner)
        if not 0.5 <= self.target_hit_rate < 1.0:
            raise AsterismError(
                f"a target hit rate of {self.target_hit_rate} cannot be reached or trusted; give one from 0.5 to below 1, such as 0.999."
            )

    def targets_of(self, names: Sequence[str]) -> Floats:
        """(M,) the target hit rates of these markers. Raises AsterismError where a target names none of them."""
        for marker in self.rules.marker_targets:
            if marker not in names:
                raise AsterismError(f"a target hit rate is given for {marker}, which is not among the markers {', '.join(names)}.")
        return np.array([self.rules.marker_targets.get(name, self.target_hit_rate) for name in names])

    @property
    def reads_motion(self) -> bool:
        """Whether the partial solvers read the points' motion."""
        return self.rules.features is not None and needs_motion(kinds_of(self.rules.features))

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for a model file."""
        rules = asdict(self.rules)
        parts = {"body": rules.pop("body"), "look": rules.pop("frames"), "features": rules.pop("features")}
        return {"seed": self.seed, "target_hit_rate": self.target_hit_rate, "miner": self.miner, **parts, "training": rules}

    @classmethod
    def from_dict(cls, plain: dict[str, Any]) -> TrainingConfig:
        """The inverse of `to_dict`, also after a round through JSON, and of models written before."""
        # Models written before knew no virtual people, and learn on without them.
        training = {"virtual_people": 0, **{EARLIER_NAMES.get(name, name): value for name, value in plain["training"].items()}}
        for name in ("trials", "time_trials"):
            # earlier models name the share hidden and the ghosts only
            training[name] = tuple(
                TrainingTrial(**t) if isinstance(t, dict) else TrainingTrial(float(t[0]), int(t[1])) for t in training[name]
            )
        rules = TrainingRules(
            **training,
            body=BodyRules(**plain["body"]),
            frames=FrameLabellingSettings.from_dict(plain["look"]),
            features=plain.get("features"),
        )
        return cls(int(plain["seed"]), float(plain["target_hit_rate"]), plain["miner"], rules)


@dataclass(frozen=True)
class TrainingState:
    """What a model keeps of its training, so that it can learn on: a sample of the recordings, and the configuration."""

    sample: Sample
    config: TrainingConfig

    def with_recordings(self, recordings: Sequence[Recording], subjects: Sequence[str] | None, marker_set: MarkerSet) -> TrainingState:
        """The state after these recordings, too. Subjects by default as `subject_of` says.

        Raises AsterismError where there is no recording, one shows nothing or all in one place, or there is not one subject for each.
        """
        if not recordings:
            raise AsterismError("there is no recording to learn from; give at least one labelled file.")
        names = [subject_of(recording) for recording in recordings] if subjects is None else list(subjects)
        if len(names) != len(recordings):
            raise AsterismError(f"{len(names)} subjects for {len(recordings)} recordings; give one name per recording.")
        for recording in recordings:
            # One that shows nothing would be learned as silence, and say so nowhere.
            if (recording.visible.sum(axis=1) < FEWEST_SHOWN).all():
                raise AsterismError(f"{_file_of(recording)} has no frame that shows {FEWEST_SHOWN} labelled points; leave it out.")
        rules = self.config.rules
        sample = self.sample.with_recordings(recordings, names, marker_set, rules.sample_frames_per_person, rules.sample_frames)
        for recording in recordings:
            # A body without extent would be every body, made small.
            some = recording.positions[recording.visible.sum(axis=1) >= FEWEST_SHOWN]
            extent = np.linalg.norm(np.nanmax(some, axis=1) - np.nanmin(some, axis=1), axis=1)
            if float(np.median(extent)) < ONE_PLACE:
                raise AsterismError(f"{_file_of(recording)} shows its labelled points all in one place; export it again, or leave it out.")
        return replace(self, sample=sample)

    def training_frames(self, known: Ints | None = None) -> tuple[Ints, Floats, Ints, list[tuple[int, Recording]]]:
        """What the body is learned from: markers that these frames show (M,), frames (N, M, 3) m, z up, whose each is (N,).

        known: markers that are learned though no frame may show them, since virtual people do.

        The frames carry their motion, (N, M, WIDTH), where the partial solvers read it. And the stretches of the
        recordings that they are from, with the person's number.

        Frames that show less than half of the markers are left out. Raises AsterismError where too little remains.
        """
        if not self.sample.clips:
            raise AsterismError("no frame shows three markers; check the marker set against the files' labels.")
        frames, people = self.sample.frames()
        # Motion is of whole stretches: a single frame has none.
        if self.config.reads_motion:
            whole, _ = self.sample.stretches([str(marker) for marker in range(frames.shape[1])])
            frames = np.concatenate([frames_with_motion(stretch) for stretch in whole])
        shown = ~np.isnan(frames[:, :, 0])
        seen = shown.any(axis=0)
        # A frame with few markers teaches a body with most of them missing.
        usable = shown.sum(axis=1) >= max(3, 0.5 * seen.sum())
        if seen.sum() < 4 or usable.sum() < 10:
            raise AsterismError(
                f"{int(seen.sum())} markers are ever seen and {int(usable.sum())} frames show at least half of them; "
                "training needs 4 markers and 10 such frames: check the marker set against the files' labels."
            )
        frames, people = frames[usable], people[usable]
        # The same number of frames of each person, so that nobody's body dominates.
        rows = subsample(people, self.config.rules.frames_per_person)
        markers = np.union1d(np.nonzero(shown[usable][rows].any(axis=0))[0], [] if known is None else known).astype(np.int64)
        # People are counted anew, since some may have no usable frame.
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
    frame_calibration: LabelCalibration
    certainty: Certainty


def learn_body(
    frames: Floats,
    people: Ints,
    stretches: Sequence[tuple[int, Recording]],
    config: TrainingConfig,
    progress: Progress,
    virtual: VirtualFrames | None = None,
) -> LearnedBody:
    """Learn from labelled frames: (N, M, 3) m, z up, NaN where missing; people (N,) whose each is; stretches of (person, recording).

    The body and its anchors are learned from all, and from the frames of `virtual` people (of the same markers). Then people are left out
    in turn, what is learned from the others is tried on them with markers hidden and ghosts added, and all these trials together calibrate
    the confidence (frames without and with points left over). Nothing is tried on virtual people: these teach, and judge nobody.
    """
    progress(0.0, "learning the body")
    folds = _folds(people, config.rules.folds, alone=virtual is None)
    # All bodies are learned side by side: the whole one, and that without each group of people.
    whole, *parts = each_shared(partial(_fit, frames, people, folds, config, virtual), range(-1, len(folds)), in_threads)
    body, anchors = whole
    progress(0.2, "trying it on people left out")
    learned = [part for part in parts if part is not None]
    in_frames, in_time = _try_on_left_out(learned, stretches, anchors.triples, config, progress, few=virtual is not None)
    sides = [in_frames.left_over == side for side in (0, 1)]
    none, some = (Calibration.fit(in_frames.margin[side], in_frames.right[side]) for side in sides)
    count = len(np.unique(people))
    of_frames, of_time = (IN_FRAMES, IN_TIME) if virtual is None else (BESIDE_VIRTUAL_IN_FRAMES, BESIDE_VIRTUAL_IN_TIME)
    certainty = Certainty(LabelCalibration.fitted(in_time, count, of_time), least_confidence_in_time(config.target_hit_rate))
    usual_score = float(np.median([part.usual_score for part in learned]))
    # The median of several smaller models is steadier than the whole model's own score on its training.
    return LearnedBody(body, anchors, usual_score, (none, some), LabelCalibration.fitted(in_frames, count, of_frames), certainty)


def _fit(
    frames: Floats, people: Ints, folds: Sequence[NDArray[np.bool_]], config: TrainingConfig, virtual: VirtualFrames | None, number: int
) -> Any:
    """`fit_whole` for the number -1, else `_fit_without` the fold of this number."""
    if number < 0:
        return fit_whole(frames, people, config, virtual)
    return _fit_without(frames, people, folds[number], config, number, virtual)


def fit_whole(frames: Floats, people: Ints, config: TrainingConfig, virtual: VirtualFrames | None = None) -> tuple[BodyModel, Anchors]:
    """The body and its anchors from all frames."""
    frames, people, weights = beside(virtual, frames, people, config.rules, config.seed)
    body = fit_body(frames, people, config.rules.body, config.seed, weights)
    return body, choose_anchors(frames, people, body, AnchorRules(), np.random.default_rng(config.seed))


def beside(
    virtual: VirtualFrames | None, frames: Floats, people: Ints, rules: TrainingRules, seed: int
) -> tuple[Floats, Ints, Floats | None]:
    """Frames of real people, then of virtual ones; whose each is; and how much each person counts, None where all count alike."""
    if virtual is None:
        return frames, people, None
    # Only of these people's frames: a place taken from somebody who is left out would have seen them.
    virtual = placed_by_neighbours(virtual, frames, seed)
    count = int(people.max()) + 1 if len(people) else 0
    others = int(virtual.people.max()) + 1
    together, whose = np.concatenate([frames, virtual.frames]), np.concatenate([people, count + virtual.people])
    weights = np.concatenate([_shares_of_postures(together, whose, count), np.full(others, rules.virtual_weight / others)])
    return together, whose, weights


def _shares_of_postures(frames: Floats, people: Ints, count: int) -> Floats:
    """How much each of the first `count` people tells, (count,), at most 1 for one who moves as much as the others of `people` (N,) do.

    A person's mean body is off by how people differ and by the postures that were not shown: a standing trial is one posture, and must not
    become everybody's habit. So the weight is (d + s) / (d + 1): s the share of the others' variance over time that the person shows, d
    the variance between people by that over time. O(N M).
    """
    placed = align_about_z(frames, frames[np.argmax((~np.isnan(frames[:, :, 0])).sum(axis=1))])
    means, moved = np.empty((2, int(people.max()) + 1, *frames.shape[1:]))
    for person in range(len(means)):
        # NaN for a marker that the person does not show
        own = placed[people == person]
        means[person], moved[person] = nan_mean(own, axis=0), nan_var(own, axis=0)
    # zero for a marker that none of the others wears: it tells nothing of how people move
    usual, differ = (np.nan_to_num(of_others) for of_others in (nan_mean(moved[count:], axis=0), nan_var(means[count:], axis=0)))
    worn = np.where(np.isnan(moved[:count]), 0.0, usual)
    shown = np.nansum(np.minimum(moved[:count], usual), axis=(1, 2)) / worn.sum(axis=(1, 2))
    apart = float(differ.sum() / usual.sum())
    return (apart + shown) / (apart + 1.0)


@dataclass(frozen=True)
class _LearnedFromOthers:
    """What is learned from all people but one group, and that group's frames.

    number       of the group
    body         learned from the others' frames
    markers      (M,) those that the others show, of all
    frames       (n, M, 3) m, the others', and whose they are: people (n,)
    tested       (m, M, 3) m, of the people left out, and whose they are: tested_people (m,)
    usual_score  nats per label, see `TrainingRules.usual_quantile`
    """

    number: int
    body: BodyModel
    markers: Ints
    frames: Floats
    people: Ints
    tested: Floats
    tested_people: Ints
    usual_score: float


def _fit_without(
    frames: Floats, people: Ints, out: NDArray[np.bool_], config: TrainingConfig, number: int, virtual: VirtualFrames | None = None
) -> _LearnedFromOthers | None:
    """Learn from the frames that are not `out` (N,); None where no frame of the people left out can be scored."""
    rules = config.rules
    # A marker that only the people left out wear cannot be learned from the others.
    others, whose, weights = beside(virtual, frames[~out], renumbered(people[~out]), rules, config.seed)
    markers = np.nonzero(~np.isnan(others[:, :, 0]).all(axis=0))[0]
    others, tested = others[:, markers], frames[np.ix_(out, markers)]
    body = fit_body(others, whose, rules.body, config.seed, weights)
    usual_score = usual_score_of(body, tested, rules, np.random.default_rng([config.seed, number]))
    # Nobody of this group can be scored, so that it calibrates nothing.
    if usual_score is None:
        return None
    return _LearnedFromOthers(number, body, markers, others, whose, tested, people[out], usual_score)


def _try_on_left_out(
    learned: Sequence[_LearnedFromOthers],
    stretches: Sequence[tuple[int, Recording]],
    triples: Ints,
    config: TrainingConfig,
    progress: Progress,
    *,
    few: bool,
) -> tuple[LabelTrials, LabelTrials]:
    """Label the frames, and the stretches, of all people left out, each by what is learned from the others; triples (A, 3) of all markers.

    few: whether fewer trials do, see `SHARE_BESIDE_VIRTUAL`.

    Each group's frames and stretches are tasks of their own, so that no thread waits for the last group.
    """
    items = [(number, in_time) for number in range(len(learned)) for in_time in (False, True)]
    found = []
    for trials in each_shared(partial(_try_group, learned, stretches, triples, config, few), items, in_threads):
        found.append(trials)
        progress(0.2 + 0.8 * len(found) / len(items), "trying it on people left out")
    # Tasks alternate between frames and stretches, in the order in which they were handed in.
    return LabelTrials.together(found[::2]), LabelTrials.together(found[1::2])


def _try_group(
    learned: Sequence[_LearnedFromOthers],
    stretches: Sequence[tuple[int, Recording]],
    triples: Ints,
    config: TrainingConfig,
    few: bool,
    item: tuple[int, bool],
) -> LabelTrials:
    """The trials of one group of people left out, in frames or in time."""
    rules = _fewer_trials(config.rules) if few else config.rules
    part, in_time = learned[item[0]], item[1]
    # Intervals of the whole training would have seen the people left out.
    anchors = with_intervals(_triples_within(triples, part.markers), part.frames, part.people, AnchorRules())
    model = BodyLabeller.from_model(part.body, anchors, rules.frames.with_usual_score(part.usual_score))
    # Each group draws its own occlusions, whatever the order in which tasks end.
    seed = config.seed + part.number
    if not in_time:
        return _try_frames(model, part.tested, part.tested_people, rules, seed, few)
    chosen = _some_stretches(stretches, np.unique(part.tested_people), part.markers, rules)
    return run_trials(model, chosen, rules.time_trials, RecordingLabellingSettings(), SubjectRules(), rules.body, seed)


def least_confidence(target_hit_rate: float) -> float:
    """The confidence below which a label is taken back, so that about `target_hit_rate` of the labels given are right.

    A power law through what was measured on left-out people (docs/labelling.md): 0.72, 0.85, 0.92, 0.96 for 0.99 to 0.99999.
    """
    return 1.0 - (1.0 - target_hit_rate) ** 0.275


def renumbered(people: Ints) -> Ints:
    """People numbered from 0 without a gap, in the same order."""
    return np.unique(people, return_inverse=True)[1].astype(np.int64)


def _folds(people: Ints, folds: int, *, alone: bool) -> list[Any]:
    """Masks of the frames left out: by person, in at most `folds` groups; by blocks of ten frames of one person who teaches `alone`."""
    count = int(people.max()) + 1
    if count > 1 or not alone:
        return [people % folds == i for i in range(min(folds, count))]
    # With one person, blocks in turn are the nearest to an unseen recording.
    block = np.arange(len(people)) // 10
    return [block % 2 == i for i in range(2)]


def _fewer_trials(rules: TrainingRules) -> TrainingRules:
    """The rules with the share of their trials that models need which start from virtual people."""
    fields = ("trial_frames", "trial_labels", "min_trial_frames", "stretch_frames")
    return replace(rules, **{name: max(1, round(SHARE_BESIDE_VIRTUAL * getattr(rules, name))) for name in fields})


def _some_stretches(stretches: Sequence[tuple[int, Recording]], people: Ints, shown: Ints, rules: TrainingRules) -> list[Recording]:
    """The longest stretches of these people, cut to length, with the markers that the model knows."""
    chosen = []
    for someone in people:
        # Long stretches hold the gaps and ghosts that last, which short ones cut off.
        own = sorted((stretch for who, stretch in stretches if who == someone), key=len, reverse=True)[: rules.stretches]
        chosen += [stretch.select([stretch.labels[m] for m in shown]).frames(slice(0, rules.stretch_frames)) for stretch in own]
    return chosen


def _triples_within(triples: Ints, shown: Ints) -> Ints:
    """The triples of markers that are all in `shown`, numbered by their places there."""
    return np.searchsorted(shown, triples[np.isin(triples, shown).all(axis=1)]).astype(np.int64)


def usual_score_of(body: BodyModel, frames: Floats, rules: TrainingRules, rng: np.random.Generator) -> float | None:
    """Score per label, in nats, that nearly all rightly labelled frames of people left out reach, some of their markers hidden.

    None where no frame can be scored.
    """
    arrays, settings = body.arrays(), rules.frames.with_usual_score(0.0)
    scores = []
    for frame in frames[rng.choice(len(frames), min(300, len(frames)), replace=False)]:
        # Hidden markers lower the score of the others: the usual score must hold with them hidden.
        shown = ~np.isnan(frame[:, 0]) & (rng.random(len(frame)) >= rules.usual_hidden_share)
        if shown.sum() >= 3:
            rows = np.where(shown, np.cumsum(shown) - 1, NULL)
            workspace = make_body_workspace(int(shown.sum()), len(rows), arrays.load.shape[3])
            scores.append(best_pose(arrays, np.ascontiguousarray(frame[shown]), rows, settings, workspace)[1] / shown.sum())
    return float(np.quantile(scores, rules.usual_quantile)) if scores else None


def _try_frames(tried: BodyLabeller, frames: Floats, people: Ints, rules: TrainingRules, seed: int, few: bool) -> LabelTrials:
    """The labels that frames of people left out get in all trials; few: fewer frames with ghosts or clutter, each of which counts more."""
    rng = np.random.default_rng(seed)
    parts = []
    # A frame of many markers gives many labels: fewer frames say as much.
    most = min(rules.trial_frames, max(rules.min_trial_frames, rules.trial_labels // frames.shape[1]))
    labels = tuple(str(m) for m in range(frames.shape[1]))
    for trial in rules.trials:
        # Ghosts are rarer in real frames than in the trials, must not rule the calibration, and take the most time.
        weight = rules.ghost_trial_weight if trial.adds_points else 1.0
        count = max(1, round(weight * most)) if few else most
        # The rate does not matter: frames are tried one by one.
        clouds, truth = trial.in_frames(Recording(frames[subsample(people, count)], labels, 100.0), rng)
        found = tried.label(clouds)
        given = found.point_of >= 0
        fits = usual_fits(found, clouds, tried.settings.usual_score)
        left_over = np.repeat(found.points_left, given.sum(axis=1)).astype(np.int64)
        right = (found.point_of == truth)[given].astype(np.float64)
        parts.append(LabelTrials(found.margins[given], fits[given], left_over, right, np.full(len(right), 1.0 if few else weight)))
    return LabelTrials.together(parts)


def _file_of(recording: Recording) -> str:
    return str(recording.metadata.get("file", "a recording"))
