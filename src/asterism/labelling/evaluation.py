"""How well a model labels: recordings with known labels in; the thesis' rates, how good the confidence is, and speed out (5.2, 5.3)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from time import perf_counter
from typing import Any
from weakref import WeakSet

import numpy as np

from asterism.errors import AsterismError
from asterism.findings import Finding, Severity
from asterism.labelling.marker_model import METHODS, MarkerModel
from asterism.labelling.reliability import ConfidenceScore, ConfidenceTally
from asterism.labelling.shared_work import each_shared, is_shared
from asterism.labelling.simulated_occlusions import simulate_gaps_and_ghosts, simulate_occlusions
from asterism.progress import Progress
from asterism.recording import LABEL_STATES, Clouds, Floats, Ints, Labelling, LabelShares, Recording, label_states, subject_of

BINS = 20
"""Bins of equal width in which confidence is compared with the share that was right. Not tuned."""


@dataclass(frozen=True)
class Condition:
    """What came of labelling with so many markers hidden and so many ghosts there at every moment. Rates are shares, 0 to 1.

    frames, visible, given  counts: frames, markers that could be seen, labels given
    shares                  what `asterism label` says of these recordings, which knows no truth
    right                   right labels among the visible markers
    fa                      false assignments: wrong among the labels given (thesis, section 5.3)
    fo                      false occlusions: nulls for visible markers among all nulls (thesis, section 5.3)
    missed                  visible markers that got no label
    perfect                 frames in which every visible marker is right and nothing else is given
    ece                     expected calibration error of the confidence of the labels given
    reliability             (mean confidence, share right, count) of each bin of confidence that has labels
    confidence              reliability by level, log score and Brier score of the confidence of the labels given
    per_marker              name -> fa, fo, missed, assignments, nulls
    frames_per_second       one core, this machine
    evaluations_per_frame   feature evaluations; NaN for recordings labelled as a whole, where they are not counted
    """

    occlusions: int
    ghosts: int
    frames: int
    visible: int
    given: int
    shares: LabelShares
    right: float
    fa: float
    fo: float
    missed: float
    perfect: float
    ece: float
    reliability: list[tuple[float, float, int]]
    confidence: ConfidenceScore
    per_marker: dict[str, dict[str, float]]
    frames_per_second: float
    evaluations_per_frame: float


@dataclass(frozen=True)
class Evaluation:
    """Conditions tried on the same recordings.

    markers     names of the markers
    conditions  what came of each number of hidden markers and ghosts
    subjects    whose recordings these are
    rules       how the points were labelled
    time        whether recordings were labelled as a whole, else each frame by itself
    confidence  how good the confidence is in all conditions together
    """

    markers: tuple[str, ...]
    conditions: list[Condition]
    subjects: list[str]
    rules: str
    time: bool
    confidence: ConfidenceScore

    def findings(self) -> list[Finding]:
        """What to know about the confidence: levels of which fewer labels are right than stated, beyond chance."""
        return [
            Finding(
                "evaluate-overconfident",
                Severity.NOTE,
                f"confidence {level.least:g} to {level.below:g}",
                f"labels with a mean confidence of {100 * level.confidence:.2f} % are right in {100 * level.right:.2f} % of cases "
                f"(95 % interval {100 * level.low:.2f} to {100 * level.high:.2f} %).",
                "Train on more people, and on movements such as these.",
            )
            for level in self.confidence.levels
            if level.too_high
        ]

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return asdict(self)


@dataclass
class _Tally:
    """Labels beside the truth, collected over recordings: (T, M) each, and their subjects."""

    truth: list[Ints] = field(default_factory=list)
    given: list[Ints] = field(default_factory=list)
    confidence: list[Floats] = field(default_factory=list)
    subjects: list[str] = field(default_factory=list)
    states: Counter[str] = field(default_factory=Counter)
    seconds: float = 0.0
    evaluations: float = 0.0

    def add(self, other: _Tally) -> None:
        """Take in the labels of other recordings."""
        self.truth += other.truth
        self.given += other.given
        self.confidence += other.confidence
        self.subjects += other.subjects
        self.states.update(other.states)
        self.seconds += other.seconds
        self.evaluations += other.evaluations

    def by_confidence(self) -> ConfidenceTally:
        """The labels counted by their confidence, grouped by subject; by recording where all are of one subject."""
        tally, several = ConfidenceTally(), len(set(self.subjects)) > 1
        groups = self.subjects if several else map(str, range(len(self.subjects)))
        for truth, given, confidence, group in zip(self.truth, self.given, self.confidence, groups, strict=True):
            tally.add(confidence, given >= 0, given == truth, group)
        return tally


def evaluate(
    model: MarkerModel,
    recordings: Sequence[Recording],
    *,
    occlusions: Sequence[int] = (0, 1, 2, 3, 4, 5),
    ghosts: Sequence[int] = (0,),
    seed: int = 0,
    rules: str = "whole-body",
    time: bool | None = None,
    progress: Progress | None = None,
) -> Evaluation:
    """Hide labels, some markers and add ghosts; label; compare with the truth.

    recordings: labelled, with the model's markers as columns. By default recordings are labelled
    as a whole, as `asterism label` does, and each frame by itself where the rules know no time. At every moment exactly so many visible
    markers are hidden, and so many ghosts lie within 0.15 m of a marker; which, `seed` decides. For whole recordings gaps last 0.1 to 1 s
    and ghosts 0.05 to 0.5 s; for single frames both are drawn anew in every frame.
    Within `shared_by`, others do parts of the work; all but the times is the same.
    Raises AsterismError where a recording's columns are not the model's markers, more markers should be hidden than there are, or `time`
    is asked of other rules than "whole-body".
    """
    plan = _EvaluationPlan(occlusions, ghosts, seed, rules, _in_time(time, rules))
    tallies = _run_conditions(model, recordings, _subjects(recordings, None), plan, progress)
    return _evaluation(tallies, model.marker_set.names, _subjects(recordings, None), plan)


def leave_one_subject_out(
    recordings: Sequence[Recording],
    *,
    subjects: Sequence[str] | None = None,
    occlusions: Sequence[int] = (0, 1, 2, 3, 4, 5),
    ghosts: Sequence[int] = (0,),
    seed: int = 0,
    rules: str = "whole-body",
    time: bool | None = None,
    progress: Progress | None = None,
    **fit_options: Any,
) -> Evaluation:
    """Train on all people but one, label that one, for each in turn: how well people are labelled whom nobody trained on.

    The other arguments are those of `evaluate`. `fit_options` go to `MarkerModel.fit`;
    `miner` is "bottom-up" where the rules need partial solvers and no miner is named.
    Raises AsterismError where there are fewer than two people, or more markers should be hidden than there are.
    """
    whose = _subjects(recordings, subjects)
    people = list(dict.fromkeys(whose))
    if len(people) < 2:
        raise AsterismError("leaving one subject out needs recordings of at least two; name them with `subjects`, or put each in a folder.")
    _check_occlusions(occlusions, len(recordings[0].labels))
    plan = _EvaluationPlan(occlusions, ghosts, seed, rules, _in_time(time, rules))
    if rules != "whole-body" and fit_options.get("miner") is None:
        fit_options["miner"] = "bottom-up"
    total: dict[tuple[int, int], _Tally] = {}
    names: tuple[str, ...] = ()
    # in one process, each person's part of the work tells how far it is
    report = None if is_shared() else progress
    found = each_shared(partial(_without_one, recordings, whose, people, plan, fit_options, report), range(len(people)), map)
    for done, (names, tallies) in enumerate(found):  # noqa: B007
        for condition, tally in tallies.items():
            total.setdefault(condition, _Tally()).add(tally)
        if progress is not None and report is None:
            progress((done + 1) / len(people), f"without {people[done]}")
    return _evaluation(total, names, people, plan)


def _without_one(
    recordings: Sequence[Recording],
    whose: Sequence[str],
    people: Sequence[str],
    plan: _EvaluationPlan,
    fit_options: Mapping[str, Any],
    progress: Progress | None,
    number: int,
) -> tuple[tuple[str, ...], dict[tuple[int, int], _Tally]]:
    """The names of a model of all people but one, and what its labels of that one are worth."""
    out = people[number]
    report = _sub_progress(progress, number, len(people), f"without {out}")
    kept = [j for j, name in enumerate(whose) if name != out]
    model = MarkerModel.fit(
        [recordings[j] for j in kept],
        subjects=[whose[j] for j in kept],
        seed=plan.seed,
        progress=_sub_progress(report, 0, 2, "training"),
        **fit_options,
    )
    own = [recordings[j] for j, name in enumerate(whose) if name == out]
    tallies = _run_conditions(model, own, [out] * len(own), plan, _sub_progress(report, 1, 2, "labelling"))
    return model.marker_set.names, tallies


def expected_calibration_error(confidence: Floats, right: Any) -> tuple[float, list[tuple[float, float, int]]]:
    """Mean distance between confidence and the share that was right, over `BINS` bins weighted by their labels; and the bins."""
    bin_of = np.minimum((confidence * BINS).astype(int), BINS - 1)
    bins, error = [], 0.0
    for b in range(BINS):
        own = bin_of == b
        if own.any():
            stated, measured = float(confidence[own].mean()), float(right[own].mean())
            bins.append((stated, measured, int(own.sum())))
            error += abs(stated - measured) * own.mean()
    return float(error), bins


def _subjects(recordings: Sequence[Recording], subjects: Sequence[str] | None) -> list[str]:
    return list(subjects) if subjects is not None else [subject_of(recording) for recording in recordings]


def _check_occlusions(occlusions: Sequence[int], markers: int) -> None:
    for k in occlusions:
        if not 0 <= k <= markers:
            raise AsterismError(f"cannot hide {k} of {markers} markers; ask for 0 to {markers} occlusions.")


def _sub_progress(progress: Progress | None, index: int, count: int, what: str) -> Progress | None:
    """A progress that fills one of `count` equal parts of another."""
    if progress is None:
        return None
    outer: Progress = progress
    return lambda fraction, _: outer((index + fraction) / count, what)


@dataclass(frozen=True)
class _EvaluationPlan:
    """What is tried: every number of occlusions with every number of ghosts; see `evaluate`."""

    occlusions: Sequence[int]
    ghosts: Sequence[int]
    seed: int
    rules: str
    time: bool

    def clouds(self, recording: Recording, number: int, hidden: int, ghosts: int) -> tuple[Clouds, Ints]:
        """The recording without its labels, and the truth; number: its place among the recordings."""
        rng = np.random.default_rng([self.seed, number, hidden, ghosts])
        return (simulate_gaps_and_ghosts if self.time else simulate_occlusions)(recording, hidden, ghosts, rng)

    def label(self, model: MarkerModel, clouds: Clouds) -> tuple[Labelling, float]:
        """What `asterism label` would give, and the feature evaluations, NaN for whole recordings."""
        if not self.time:
            labelling, evaluations = model.label_frames_with_cost(clouds, method=self.rules)
            return labelling, float(evaluations.sum())
        return model.label(clouds), float("nan")


def _in_time(time: bool | None, rules: str) -> bool:
    """Whether recordings are labelled as a whole. Raises AsterismError for unknown rules, and where the rules know no time."""
    if rules not in METHODS:
        raise AsterismError(f"there are no rules {rules!r}; choose from {', '.join(METHODS)}.")
    if time and rules != "whole-body":
        raise AsterismError(f"whole recordings are labelled by the rules whole-body, not {rules}; leave out time or the rules.")
    return rules == "whole-body" if time is None else time


def _run_conditions(
    model: MarkerModel,
    recordings: Sequence[Recording],
    subjects: Sequence[str],
    plan: _EvaluationPlan,
    progress: Progress | None,
) -> dict[tuple[int, int], _Tally]:
    names = model.marker_set.names
    for recording in recordings:
        if recording.labels != names:
            raise AsterismError(
                f"{recording.metadata.get('file', 'a recording')} has other columns than the model's {len(names)} markers; "
                "read it with the model's marker set."
            )
    _check_occlusions(plan.occlusions, len(names))
    tallies = {(k, g): _Tally() for g in plan.ghosts for k in plan.occlusions}
    items = [(condition, r) for condition in tallies for r in range(len(recordings))]
    found = each_shared(partial(_try, model, recordings, subjects, plan), items, map)
    for done, ((condition, _), tally) in enumerate(zip(items, found, strict=True)):
        tallies[condition].add(tally)
        if progress:
            progress((done + 1) / len(items), "labelling")
    return tallies


def _try(
    model: MarkerModel, recordings: Sequence[Recording], subjects: Sequence[str], plan: _EvaluationPlan, item: tuple[tuple[int, int], int]
) -> _Tally:
    """The labels of one recording under one condition, hidden markers and ghosts, beside the truth."""
    (hidden, ghosts), number = item
    recording = recordings[number]
    # two frames, so that compiling is not counted as labelling
    if len(recording) and model not in _COMPILED:
        _COMPILED.add(model)
        plan.label(model, recording.frames(slice(0, 2)).clouds())
    clouds, truth = plan.clouds(recording, number, hidden, ghosts)
    start = perf_counter()
    labelling, evaluations = plan.label(model, clouds)
    seconds = perf_counter() - start
    states: Counter[str] = Counter({name: int(held.sum()) for name, held in vars(label_states(labelling, clouds)).items()})
    return _Tally([truth], [labelling.indices], [labelling.confidence], [subjects[number]], states, seconds, evaluations)


_COMPILED: WeakSet[MarkerModel] = WeakSet()
"""The models that have labelled in this process."""


def _evaluation(tallies: dict[tuple[int, int], _Tally], names: tuple[str, ...], subjects: list[str], plan: _EvaluationPlan) -> Evaluation:
    conditions, pooled = [], ConfidenceTally()
    for (k, g), tally in tallies.items():
        by_confidence = tally.by_confidence()
        pooled += by_confidence
        conditions.append(_condition(k, g, tally, by_confidence.score(), names))
    return Evaluation(names, conditions, list(dict.fromkeys(subjects)), plan.rules, plan.time, pooled.score())


def _condition(occlusions: int, ghosts: int, tally: _Tally, score: ConfidenceScore, names: tuple[str, ...]) -> Condition:
    truth, given = np.concatenate(tally.truth), np.concatenate(tally.given)
    confidence = np.concatenate(tally.confidence)
    label, visible = given >= 0, truth >= 0
    right = label & (given == truth)
    stated = label & ~np.isnan(confidence)
    ece, reliability = expected_calibration_error(confidence[stated], right[stated])

    def rates(which: Any) -> dict[str, float]:
        assignments, nulls, seen = label[:, which].sum(), (~label[:, which]).sum(), visible[:, which].sum()
        missed = (visible & ~label)[:, which].sum()
        return {
            "fa": float((label & ~right)[:, which].sum() / max(1, assignments)),
            "fo": float(missed / max(1, nulls)),
            "missed": float(missed / max(1, seen)),
            "assignments": int(assignments),
            "nulls": int(nulls),
        }

    everyone = rates(slice(None))
    return Condition(
        occlusions=occlusions,
        ghosts=ghosts,
        frames=len(truth),
        visible=int(visible.sum()),
        given=int(label.sum()),
        shares=LabelShares(**{name: tally.states[name] / label.size if label.size else float("nan") for name in LABEL_STATES}),
        right=float(right.sum() / max(1, visible.sum())),
        fa=everyone["fa"],
        fo=everyone["fo"],
        missed=everyone["missed"],
        perfect=float((given == truth).all(axis=1).mean()) if len(truth) else 0.0,
        ece=ece,
        reliability=reliability,
        confidence=score,
        per_marker={name: rates([m]) for m, name in enumerate(names)},
        frames_per_second=len(truth) / max(tally.seconds, 1e-9),
        evaluations_per_frame=tally.evaluations / max(1, len(truth)),
    )
