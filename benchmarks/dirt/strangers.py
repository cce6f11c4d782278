"""Models of few people on others, of one movement on another, of one body on another: labels, and the verdict on each recording."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import combinations

import numpy as np

from asterism.errors import AsterismError
from asterism.recording import Clouds, Ints, Labelling, MarkerSet, Recording
from asterism.recording.verdict import FITS, OTHER_BODY
from asterism.simulation import simulate_gaps_and_ghosts
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import CHOOSING_SETS, OWN_TRIALS, PEOPLE, evenly, everything, file_of, gait, is_unnamed
from benchmarks.dirt.walks import ensemble_of
from benchmarks.figures import Figure
from benchmarks.recordings.movement import silence
from benchmarks.score import Tally

LONGEST = 500
"""Frames of each recording that are labelled, from its middle."""
HIDDEN = 3
SETS = ("clinical-lower", "pig39", "qtm-fullbody", "running42", "lab51-multiactivity", "fullbody61", "sprint53")
MOUSE = "mouse-qtm/MOS1aD_S2_M5_MC2_T2_TRM_5MMIN_E.mat"
SURE = 0.99


@dataclass(frozen=True)
class Pair:
    """A training and a recording of someone or something else; `wear` names the markers that all of them share."""

    name: str
    train: tuple[Recording, ...]
    people: tuple[str, ...]
    test: Recording


@dataclass
class Outcome:
    """Labels and verdicts, summed over recordings: how many were said not to fit, and how many labels at 0.99 or more were wrong."""

    tally: Tally
    recordings: int = 0
    foreign: int = 0
    sure_and_wrong: int = 0

    def add(self, labelling: Labelling, truth: Ints, recording: str = "") -> None:
        """Count one recording's labels (T, M); its name where several models label the same one."""
        self.tally.add(labelling, truth, recording=recording)
        self.recordings += 1
        self.foreign += labelling.verdict is not None and labelling.verdict.kind != FITS
        sure = (labelling.indices >= 0) & (labelling.confidence >= SURE)
        self.sure_and_wrong += int((sure & (labelling.indices != truth)).sum())

    def join(self, other: Outcome) -> None:
        """Count what another one has counted."""
        self.tally += other.tally
        self.recordings += other.recordings
        self.foreign += other.foreign
        self.sure_and_wrong += other.sure_and_wrong


def strangers(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Every pair of the sets, walks against standing trials, ordinary recordings of gait, a mouse, two people as one body."""
    for name in SETS[:1] if benchmark.quick else SETS:
        outcomes: dict[str, Outcome] = {}
        for found in benchmark.each(_measured, [(name, number) for number in range(1 if benchmark.quick else len(_by_training(name)))]):
            for condition, outcome in found.items():
                outcomes.setdefault(condition, Outcome(Tally())).join(outcome)
        chosen = " (chosen on)" if name in CHOOSING_SETS else ""
        for condition, outcome in outcomes.items():
            yield from _figures(f"strangers, {name}{chosen}, {condition}", outcome, asked="as recorded" not in condition)
    yield from _standing_and_walking(benchmark)
    yield from _ordinary(benchmark)
    yield from _other_bodies(benchmark)


def _figures(row: str, outcome: Outcome, *, asked: bool) -> Iterator[Figure]:
    tally = outcome.tally
    yield tally.figure(f"{row}: right", ">= 0.9" if asked else "none", tally.right_share)
    yield tally.figure(f"{row}: wrong", "<= 0.005" if asked else "none", tally.false_assignments)
    yield Figure(f"{row}: labels sure and wrong", "none", outcome.sure_and_wrong, "labels", tally.distinct)
    yield Figure(f"{row}: said not to fit", "none", outcome.foreign / outcome.recordings, "fraction", outcome.recordings)


def _pairs(name: str) -> Iterator[Pair]:
    """Every training of some of a set's people with each recording of another; one trial with each other where there is one person."""
    if name in PEOPLE:
        people = PEOPLE[name]
        for count in range(1, len(people)):
            for some in combinations(people, count):
                train = [(person, file) for person in some for file in people[person]]
                for other in people:
                    if other not in some:
                        yield from (pair for file in people[other] if (pair := _pair(train, file)) is not None)
        return
    files = [file for group in OWN_TRIALS[name] for file in group]
    for one in files:
        for other in files:
            if one != other and (pair := _pair([(name, one)], other)) is not None:
                yield pair


@cache
def _by_training(name: str) -> list[list[Pair]]:
    """The pairs of a set, those together that one model serves."""
    found: dict[tuple[str, tuple[str, ...]], list[Pair]] = {}
    for pair in _pairs(name):
        found.setdefault((pair.name.partition(": ")[0], pair.test.labels), []).append(pair)
    return list(found.values())


def _measured(benchmark: BenchmarkRun, item: tuple[str, int]) -> dict[str, Outcome]:
    """What one model makes of all recordings of other people that have its markers."""
    name, number = item
    outcomes: dict[str, Outcome] = {}
    for pair in _by_training(name)[number]:
        _measure(benchmark, pair, outcomes)
    return outcomes


def _pair(train: list[tuple[str, str]], test: str) -> Pair | None:
    """A training and a test with the markers that all people of the training and the test wear; None where these are too few."""
    worn = [{label for person, file in train if person == who for label in _worn(file)} for who in dict.fromkeys(who for who, _ in train)]
    common = [label for label in _worn(train[0][1]) if all(label in some for some in (*worn, _worn(test)))]
    if len(common) < 8:
        return None
    recordings = tuple(_with_columns(everything(file), common) for _, file in train)
    return Pair(
        f"{', '.join(file for _, file in train)}: {test}", recordings, tuple(who for who, _ in train), everything(test).select(common)
    )


def _worn(file: str) -> list[str]:
    """The labels of a file that name a marker, each once."""
    recording = everything(file)
    seen = np.flatnonzero(recording.visible.any(axis=0))
    named = [recording.labels[column] for column in seen if not is_unnamed(recording.labels[column])]
    return [label for label in named if recording.labels.count(label) == 1]


def _with_columns(recording: Recording, labels: list[str]) -> Recording:
    """These columns only; a marker that the trial lacks is missing in all its frames."""
    columns = MarkerSet(tuple(labels)).columns_of(recording.labels)
    positions = np.where((columns >= 0)[None, :, None], recording.positions[:, columns], np.nan)
    return Recording(positions, tuple(labels), recording.rate, recording.vertical, metadata=recording.metadata)


def _middle(recording: Recording) -> slice:
    spare = max(0, len(recording) - LONGEST) // 2
    return slice(spare, spare + LONGEST)


def _measure(benchmark: BenchmarkRun, pair: Pair, outcomes: dict[str, Outcome]) -> None:
    """Label the test as it was worn, with gaps, and with all other points of its file."""
    try:
        ensemble = benchmark.fit(_some(benchmark, pair.train), pair.people)
    except AsterismError as problem:
        benchmark.report(f"{pair.name}: nothing learned: {problem}")
        return
    middle = _middle(pair.test)
    test = pair.test.frames(middle)
    conditions = {
        "nothing hidden": simulate_gaps_and_ghosts(test, 0, 0, seed=0),
        f"{HIDDEN} hidden": simulate_gaps_and_ghosts(test, HIDDEN, 0, seed=0),
        "as recorded": _as_recorded(test, everything(_file(pair.test)).frames(middle)),
    }
    for condition, (clouds, truth) in conditions.items():
        outcome = outcomes.setdefault(condition, Outcome(Tally()))
        try:
            outcome.add(ensemble.label(clouds), truth, _file(pair.test))
        except AsterismError:
            outcome.add(silence(truth, test.labels), truth, _file(pair.test))
    benchmark.report(f"{pair.name}: {', '.join(f'{c} {o.tally.false_assignments:.4f}' for c, o in outcomes.items())} wrong so far")


def _some(benchmark: BenchmarkRun, train: Sequence[Recording]) -> list[Recording]:
    """The recordings to learn from; few frames of each for a quick run."""
    return [evenly(recording, 40) if benchmark.quick else recording for recording in train]


def _file(recording: Recording) -> str:
    return str(file_of(recording)).rsplit("/movement/", 1)[-1]


def _as_recorded(test: Recording, whole: Recording) -> tuple[Clouds, Ints]:
    """The clouds with the file's other points in them, and the truth about the test's markers."""
    rest = [column for column, label in enumerate(whole.labels) if label not in test.labels]
    positions = np.concatenate([test.positions, whole.positions[:, rest]], axis=1)
    labels = (*test.labels, *(f"*{column}" for column in rest))
    clouds, truth = simulate_gaps_and_ghosts(Recording(positions, labels, whole.rate, whole.vertical), 0, 0, seed=0)
    return clouds, truth[:, : len(test.labels)]


def _is_standing(trial: Recording) -> bool:
    return file_of(trial).stem == "static"


def _standing_and_walking(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Ten children's walks, the eleventh's standing trial; and the reverse."""
    subjects = list(gait())[: 1 if benchmark.quick else None]
    for standing in (True, False):
        total = Outcome(Tally())
        for outcome in benchmark.each(_other_trials, [(subject, standing) for subject in subjects]):
            total.join(outcome)
        what = "walks learned, standing labelled" if standing else "standing learned, walks labelled"
        yield from _figures(f"strangers, gait, {what}, {HIDDEN} hidden", total, asked=True)


def _other_trials(benchmark: BenchmarkRun, item: tuple[str, bool]) -> Outcome:
    """One child's standing trials, or walks, by a model of the other children's other trials."""
    left_out, standing = item
    train = [(who, t) for who, own in gait().items() if who != left_out for t in own if _is_standing(t) != standing]
    train = train[: 3 if benchmark.quick else None]
    ensemble, outcome = benchmark.fit(_some(benchmark, [trial for _, trial in train]), [who for who, _ in train]), Outcome(Tally())
    for trial in (trial for trial in gait()[left_out] if _is_standing(trial) == standing):
        clouds, truth = simulate_gaps_and_ghosts(trial, HIDDEN, 0, seed=0)
        outcome.add(ensemble.label(clouds), truth)
    return outcome


def _ordinary(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Every gait recording, its subject left out: none may be said not to fit."""
    total = Outcome(Tally())
    for outcome in benchmark.each(_own_kind, list(gait())[: 1 if benchmark.quick else None]):
        total.join(outcome)
    yield Figure("strangers, gait, all trials left out: said not to fit", "== 0", total.foreign, "recordings", total.recordings)


def _own_kind(benchmark: BenchmarkRun, left_out: str) -> Outcome:
    """One child's trials by a model of all others."""
    ensemble, outcome = ensemble_of(benchmark, left_out), Outcome(Tally())
    for number, trial in enumerate(gait()[left_out]):
        for hidden in (0, HIDDEN):
            clouds, truth = simulate_gaps_and_ghosts(trial, hidden, 0, seed=number)
            outcome.add(ensemble.label(clouds), truth)
    return outcome


def _other_bodies(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """A mouse by a model of children, and two children side by side who were learned as one body and have changed places."""
    subjects, mouse = gait(), everything(MOUSE)
    labelling = ensemble_of(benchmark, next(iter(subjects))).label(mouse.frames(_middle(mouse)).clouds())
    said = labelling.verdict is not None and labelling.verdict.kind == OTHER_BODY
    yield Figure(
        "strangers, a mouse by a model of children: labelled", "<= 0.005", _labelled(labelling), "fraction", len(labelling.indices)
    )
    yield Figure("strangers, a mouse by a model of children: said to be another body", "== 1", float(said), "fraction", 1)
    one, other = list(subjects)[:2]
    first, second = (next(trial for trial in subjects[who] if file_of(trial).stem == "straight") for who in (one, other))
    ensemble = benchmark.fit(_some(benchmark, [_side_by_side(first, second)]), ["both"])
    clouds, truth = simulate_gaps_and_ghosts(_side_by_side(first, second, changed=True), 0, 0, seed=0)
    outcome = Outcome(Tally())
    outcome.add(ensemble.label(clouds), truth)
    yield Figure(
        "strangers, two learned as one body, places changed: wrong", "none", outcome.tally.false_assignments, "fraction", len(truth)
    )
    yield Figure("strangers, two learned as one body, places changed: sure and wrong", "none", outcome.sure_and_wrong, "labels", len(truth))


def _labelled(labelling: Labelling) -> float:
    return float((labelling.indices >= 0).mean())


def _side_by_side(one: Recording, other: Recording, changed: bool = False) -> Recording:
    """Two walks as one recording of one body, a metre apart; the first on the right where they have changed places."""
    frames = min(len(one), len(other))
    side = np.array([-0.5 if changed else 0.5, 0.0, 0.0])
    parts = [_centred(one.positions[:frames]) + side, _centred(other.positions[:frames]) - side]
    labels = (*(f"A{label}" for label in one.labels), *(f"B{label}" for label in other.labels))
    return replace(one, positions=np.concatenate(parts, axis=1), labels=labels, events=())


def _centred(positions: np.ndarray) -> np.ndarray:
    """Positions whose usual place across the walk is 0, for walks along y."""
    return positions - np.nanmedian(positions, axis=(0, 1)) * np.array([1.0, 0.0, 0.0])
