"""The rows of the chapter: no labelled file, one person taught beside virtual ones, more points, virtual people who stand."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

import asterism
from asterism.errors import AsterismError
from asterism.files.cache import VARIABLE
from asterism.formats import write
from asterism.labelling import TrainingRules, virtual_model
from asterism.recording import MarkerSet
from asterism.session.worn import FindRules, SetFinder
from asterism.simulation import simulate_gaps_and_ghosts
from asterism.skeleton import VirtualRules, virtual_people
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import gait, people_and_trials
from benchmarks.figures import Figure
from benchmarks.recordings.walks import label_whole
from benchmarks.virtual.judged import Counts, counted, judged, line_of, summed
from benchmarks.virtual.worn import TUNE, Worn, markers_only, recordings_of, sets, with_extra_points

LONGEST, SHORT, AS_THE_COMMAND = 300, 100, 3000
"""Frames of a file that are labelled, from its middle, and where a file is labelled many times."""
TOLD = 0.99
"""Files of which fewer markers are right, or some labels wrong, are told in the log."""
FIFTEEN, THIRTY_NINE = "helen-hayes", "plug-in-gait"
RIGHT = {"walks": ">= 0.997", "statics": ">= 0.99", "movements": ">= 0.97"}
ADDED, PEOPLE, STANDING, LEFT_OUT = 50, 80, 300, 3
"""Files to which points are added back; virtual people beside real ones; virtual people who stand; children left out."""
TAUGHT = (THIRTY_NINE, "opencap-lab", "hamner-running", "leuven", "landmarks-73")
"""Sets of which more than one file is there; one person's in turn teach the others."""
FEWEST = 1000
"""Labels of a person in a bin from which their share right is told: of fewer, one marker of one file decides."""


def fifteen(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """15 markers, no labelled file, by how many are hidden; and how far its confidence holds."""
    total = Counts()
    for hidden, asked in ((0, ">= 0.998"), (3, ">= 0.995"), (5, ">= 0.99")):
        counts = _labelled(benchmark, recordings_of(FIFTEEN), hidden)
        total += counts
        row = f"no labelled file, 15 markers, {hidden} hidden"
        yield from _figures(row, counts, asked, "<= 0.0002")
        yield Figure(f"{row}: files below 95 % right", "<= 0", counts.below, "files", counts.files)
    yield from _reliability("no labelled file, 15 markers", total)


def thirty_nine(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """39 markers, no labelled file: walks, statics with raised arms, movements; nothing and three hidden."""
    total = Counts()
    for kind, asked in RIGHT.items():
        counts = summed(_labelled(benchmark, recordings_of(THIRTY_NINE, kind=kind), hidden) for hidden in (0, 3))
        total += counts
        yield from _figures(f"no labelled file, 39 markers, {kind}", counts, asked, "<= 0.0005")
    yield from _reliability("no labelled file, 39 markers", total)


def others(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Every other shipped set that a recording wears, nothing and three hidden: each, and all together."""
    total = Counts()
    for name in [name for name in sets() if name not in (FIFTEEN, THIRTY_NINE)][: 1 if benchmark.quick else None]:
        counts = summed(_labelled(benchmark, recordings_of(name), hidden) for hidden in (0, 3))
        total += counts
        yield from _figures(f"no labelled file, {name}, {len(MarkerSet.load(name))} markers", counts, ">= 0.97", "<= 0.002")
    yield from _figures("no labelled file, all other sets", total, ">= 0.97", "<= 0.002")
    yield from _reliability("no labelled file, all other sets", total)


def raw(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Every file that has points beside the set's markers, as recorded: gaps, ghosts, other markers, up to 109 points."""
    total = Counts()
    for name in (FIFTEEN, THIRTY_NINE) if benchmark.quick else sets():
        files = [worn for worn in recordings_of(name) if len(worn.everything().labels) > len(MarkerSet.load(name))]
        counts = _labelled(benchmark, files, raw=True)
        total += counts
        if counts.files:
            yield from _figures(f"no labelled file, raw, {name}", counts, ">= 0.97", "<= 0.003")
    yield from _figures("no labelled file, raw, all sets", total, ">= 0.97", "<= 0.003")


def taught(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """One person taught, whichever, and all other people of the set labelled; and children left out of ten who are taught."""
    for name in TAUGHT[: 1 if benchmark.quick else None]:
        files = recordings_of(name)
        # a set that one person wears is taught by each of his files in turn
        alone = len({worn.person for worn in files if worn.split == TUNE}) == 1
        of = {worn.file: worn.file if alone else worn.person for worn in files}
        counts = []
        for who in dict.fromkeys(of[worn.file] for worn in files if worn.split == TUNE):
            train = [markers_only(worn, 10_000) for worn in files if of[worn.file] == who]
            model = benchmark.fit(
                train, ["one"] * len(train), marker_set=MarkerSet.load(name), training=TrainingRules(virtual_people=PEOPLE)
            )
            others = [worn for worn in files if of[worn.file] != who]
            counts.append(summed(_each(benchmark, model, _few(others, 2) if benchmark.quick else others)))
            benchmark.report(line_of(f"{name}, taught by {who}", counts[-1]))
        row = f"one person taught and virtual people, {name}, strangers"
        yield from _figures(row, summed(counts), ">= 0.98", "<= 0.002")
        yield Figure(f"{row}: right, worst of the teachers", ">= 0.98", min(one.right_share for one in counts), "fraction", len(counts))
    counts = []
    for child in sorted(gait())[: 1 if benchmark.quick else LEFT_OUT]:
        names, recordings = people_and_trials(gait(), child)
        model = benchmark.fit(recordings, names, marker_set=MarkerSet.load(FIFTEEN))
        counts.append(summed(_each(benchmark, model, [worn for worn in recordings_of(FIFTEEN) if worn.person == child])))
    yield from _figures("ten people taught, 15 markers, children left out", summed(counts), ">= 1", "<= 0")


def more_points(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Five of 15 markers hidden throughout and added back one by one: how far the share right falls below its best so far."""
    model, files = virtual_model(FIFTEEN), _few(recordings_of(FIFTEEN), 4 if benchmark.quick else ADDED)
    falls = []
    for number, worn in enumerate(files):
        trial = markers_only(worn, SHORT)
        order = np.random.default_rng(number).permutation(np.nonzero(trial.visible.any(axis=0))[0])[:5]
        best, fall = 0.0, 0.0
        for shown in range(len(order) + 1):
            positions = trial.positions.copy()
            positions[:, order[shown:]] = np.nan
            clouds, truth = simulate_gaps_and_ghosts(replace(trial, positions=positions), 0, 0, seed=number)
            share = counted(label_whole(model, clouds, truth), truth).right_share
            best, fall = max(best, share), max(fall, best - share)
        falls.append(fall)
    row = "more points, 15 markers, five added back one by one"
    fell = sum(fall > 0.01 for fall in falls)
    yield Figure(f"{row}: files of which the share right falls by more than 0.01", "<= 0", fell, "files", len(falls))
    yield Figure(f"{row}: largest fall", "<= 0.01", max(falls), "fraction", len(falls))


def virtual_standing(benchmark: BenchmarkRun, people: int = STANDING) -> Iterator[Figure]:
    """Virtual people who stand, and real adults of other laboratories, by a model of all children: sure and wrong, and turned round."""
    names, recordings = people_and_trials(gait())
    model = benchmark.fit(recordings, names)
    stands = VirtualRules(share=(("stand", 1.0),), take=(("stand", 12),))
    trials = virtual_people(FIFTEEN, people=10 if benchmark.quick else people, frames=12, seed=1, rules=stands)
    shown = [simulate_gaps_and_ghosts(trial, 0, 0, seed=number) for number, trial in enumerate(trials)]
    adults = [worn for worn in recordings_of(FIFTEEN, kind="statics") if worn.person not in names]
    for who, counts in (
        (f"virtual people who stand, {len(trials):,}", [counted(label_whole(model, clouds, truth), truth) for clouds, truth in shown]),
        ("real adults who stand, 0 and 3 hidden", [one for hidden in (0, 3) for one in _each(benchmark, model, adults, hidden)]),
    ):
        row, total, turned = (
            f"{who}, by a model of children",
            summed(counts),
            sum(2 * (one.given - one.right) > one.given for one in counts),
        )
        yield Figure(f"{row}: labels sure and wrong", "<= 0", total.sure_and_wrong, "labels", max(total.given, 1))
        yield Figure(f"{row}: mostly wrong", "<= 0", turned, "recordings", len(counts))
        yield Figure(f"{row}: right", "none", total.right_share, "fraction", max(total.visible, 1))


def virtual_standing_all(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """The same with 10,000 people; about half an hour."""
    yield from virtual_standing(benchmark, 10_000)


def set_worn(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """All points of files without a name in them: whether a set is found that names as many of them as the largest that they wear does."""
    largest: dict[str, Worn] = {}
    for name in sorted(sets(), key=lambda name: len(MarkerSet.load(name))):
        own = len(MarkerSet.load(name))
        extra = [(worn, with_extra_points(worn, SHORT).visible[:, own:].any(axis=0).sum()) for worn in recordings_of(name)]
        largest |= {worn.file: worn for worn, points in extra if points <= 0.1 * own}
    told = [_set_told(benchmark, worn) for worn in _few(list(largest.values()), 3 if benchmark.quick else len(largest))]
    yield Figure("set worn, no name in the file: told right", ">= 0.99", told.count("right") / len(told), "fraction", len(told))
    yield Figure("set worn, no name in the file: sure and wrong", "<= 0", told.count("sure and wrong"), "files", len(told))


def _set_told(benchmark: BenchmarkRun, worn: Worn) -> str:
    """Whether the set that is found names as many points as that which is worn."""
    trial = with_extra_points(worn, AS_THE_COMMAND)
    try:
        found = SetFinder().of(worn.path, replace(trial, labels=tuple(f"*{place}" for place in range(len(trial.labels)))))[0]
    except AsterismError as problem:
        benchmark.report(f"{worn.file} wears {worn.markers}; {str(problem).partition(':')[2]}")
        return "refused"
    named = [(one.columns_of(worn.everything().labels) >= 0).sum() for one in (found.marker_set, MarkerSet.load(worn.markers))]
    if found.name == worn.markers or named[0] >= named[1]:
        return "right"
    benchmark.report(f"{worn.file} wears {worn.markers}; found {found.words}")
    return "sure and wrong" if found.same_names >= FindRules().sure else "wrong"


def first_command(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """`asterism label FILE -o OUT` on a file of 15 markers without names: with empty caches, and then again; processor time."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        trial = markers_only(recordings_of(FIFTEEN)[0], LONGEST)
        write(folder / "walk.c3d", replace(trial, labels=tuple(f"*{place + 1}" for place in range(len(trial.labels)))))
        environment = {**os.environ, "NUMBA_CACHE_DIR": f"{folder}/kernels", VARIABLE: f"{folder}/cache"}
        for which, asked in (("first", "< 30"), ("second", "< 3")):
            before = sum(os.times()[2:4])
            words = [sys.executable, "-m", "asterism", "label", str(folder / "walk.c3d"), "-o", str(folder / which)]
            subprocess.run(words, env=environment, check=True, capture_output=True)
            spent = sum(os.times()[2:4]) - before
            yield Figure(f"asterism label FILE -o OUT, no model given, {which} time: processor time", asked, spent, "s", 1)


def _labelled(benchmark: BenchmarkRun, files: list[Worn], hidden: int = 0, raw: bool = False) -> Counts:
    """The counts of files that all wear one set, by its model of virtual people."""
    chosen = _few(files, 2) if benchmark.quick else files
    return summed(_each(benchmark, virtual_model(chosen[0].markers), chosen, hidden, raw)) if chosen else Counts()


def _each(benchmark: BenchmarkRun, model: asterism.MarkerModel, files: list[Worn], hidden: int = 0, raw: bool = False) -> Iterator[Counts]:
    for worn in files:
        counts = judged(model, worn, hidden, raw=raw, longest=SHORT if raw or benchmark.quick else LONGEST)
        if counts.right_share < TOLD or counts.given > counts.right:
            benchmark.report(line_of(f"{worn.markers}, {worn.person}, {worn.file}, {hidden} hidden", counts))
        yield counts


def _few(files: list[Worn], most: int) -> list[Worn]:
    return [files[int(place)] for place in np.unique(np.linspace(0, len(files) - 1, min(len(files), most)).round())]


def _figures(row: str, counts: Counts, right: str, wrong: str) -> Iterator[Figure]:
    if counts.files:
        yield Figure(f"{row}: right", right, counts.right_share, "fraction", counts.visible)
        yield Figure(f"{row}: wrong", wrong, counts.wrong_share, "fraction", max(counts.given, 1))
        yield Figure(
            f"{row}: labels sure and wrong", "<= 0" if right != "none" else "none", counts.sure_and_wrong, "labels", max(counts.given, 1)
        )


def _reliability(row: str, counts: Counts) -> Iterator[Figure]:
    """Of each bin as many must be right as its lower end says; of the surest all but one of 10,000."""
    bins = (("0.90 to 0.95", ">= 0.9"), ("0.95 to 0.99", ">= 0.95"), ("0.99 or more", ">= 0.9999"))
    for place, ((given, right), (name, asked)) in enumerate(zip(counts.bins.tolist(), bins, strict=True)):
        if given:
            yield Figure(f"{row}, all: right at {name}", asked, right / given, "fraction", given)
        people = [(own[place, 1] / own[place, 0], own[place, 0], who) for who, own in counts.of_person.items() if own[place, 0] >= FEWEST]
        if people:
            share, labels, who = min(people)
            yield Figure(f"{row}, {who}, the worst of {len(people)} people: right at {name}", asked, share, "fraction", labels)
