"""The thesis' own experiment (tables 5.3 to 5.5) by its own rules: subjects seen, odd and even blocks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from asterism.labelling.partial.matrix import PartialSolvers, label_by_matrix
from asterism.labelling.partial.solver import stack_frames
from asterism.labelling.partial.solver_search import PRINTED, PRINTED_FEATURES, search_partial_solvers
from asterism.labelling.simulated_occlusions import simulate_occlusions
from asterism.recording import Labelling, Recording
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import blocks, evenly, gait, people_and_trials
from benchmarks.figures import Figure, reached
from benchmarks.labelling.seen import FRAMES, TARGETS, THESIS_FA, THESIS_FO, by_marker, drawn_frames, redrawn, test_frames
from benchmarks.score import Tally

PRINTED_MARKERS = {
    "RASI": (0.0002, 0.0638), "LASI": (0.0002, 0.0555), "SACR": (0.0, 0.0611), "RTHI": (0.0, 0.4503), "LTHI": (0.0001, 0.0485),
    "RKNE": (0.0, 0.3003), "LKNE": (0.0001, 0.4458), "RTIB": (0.0001, 0.0420), "LTIB": (0.0003, 0.0471), "RANK": (0.0003, 0.3402),
    "LANK": (0.0001, 0.4930), "RHEE": (0.0005, 0.4214), "LHEE": (0.0001, 0.4506), "RTOE": (0.0004, 0.3467), "LTOE": (0.0005, 0.4513),
}  # fmt: skip
"""Table 5.3, FA and FO of each marker at 99.99 % and 4 occlusions; its wands and calves are THI and TIB here."""

THESIS = "thesis rules"
MATRIX_RULES = {THESIS: "printed", "thesis rules with agreed proposals": "agreed"}
"""As printed, and with solvers that keep silent about markers in which their labellings differ, at 99.99 % only. The row `tables` has the
default rules."""

DRAWS = FRAMES // 2
"""Frames that each cell is about, drawn and hidden anew."""


def thesis(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Tables 5.4 and 5.5 cell by cell, table 5.3 marker by marker, and how many cells reach the print."""
    met = cells = 0
    for figures in benchmark.each(_column, TARGETS[2:3] if benchmark.quick else TARGETS):
        for figure in figures:
            if figure.row.startswith((f"table 5.4, {THESIS}, subjects", f"table 5.5, {THESIS}, subjects")):
                cells += 1
                met += bool(reached(figure.asked, figure.measured))
            yield figure
    yield Figure(f"tables 5.4 and 5.5, {THESIS}: cells at or better than printed", f">= {cells}", met, "cells", cells)


def _column(benchmark: BenchmarkRun, target: float) -> list[Figure]:
    """One target hit rate over all occlusions."""
    people, recordings = people_and_trials(gait())
    train = [blocks(recording, odd=False) for recording in recordings]
    if benchmark.quick:
        train = [evenly(recording, 40) for recording in train]
    frames, groups = stack_frames(train, people)
    solvers = search_partial_solvers(frames, groups, targets=target, features=PRINTED_FEATURES, settings=PRINTED, seed=0)
    sizes = np.bincount(np.diff(solvers.solvers.first_depth)).tolist()
    benchmark.report(f"target {target}: {len(solvers)} solvers, by size {sizes}, {int(solvers.covered.sum())} markers covered")
    column = TARGETS.index(target)
    figures: list[Figure] = []
    for hidden in (4,) if benchmark.quick else range(1, 6):
        figures += _on_training_frames(solvers, train, hidden, target)
        clouds, truth = simulate_occlusions(test_frames(1024 if benchmark.quick else DRAWS), hidden, 0, seed=hidden)
        for rules in MATRIX_RULES if target == 0.9999 else (THESIS,):
            votes = label_by_matrix(clouds, solvers, rules=MATRIX_RULES[rules])
            labelling = Labelling(votes.indices, votes.votes, recordings[0].labels)
            tally = redrawn(labelling, truth)
            fa, fo = tally.false_assignments, tally.false_occlusions
            cell = f"{rules}, subjects seen, {hidden} occlusion{'s' * (hidden > 1)}, target {target * 100:g} %"
            figures.append(tally.figure(f"table 5.4, {cell}: FA", f"<= {THESIS_FA[hidden][column]:g}", fa))
            figures.append(tally.figure(f"table 5.5, {cell}: FO", f"<= {THESIS_FO[hidden][column]:g}", fo))
            if rules == THESIS and target == 0.9999 and hidden == 4:
                figures += by_marker(cell, labelling, truth, tally, PRINTED_MARKERS)
    return figures


def _on_training_frames(solvers: PartialSolvers, train: Sequence[Recording], hidden: int, target: float) -> Iterator[Figure]:
    """The same cells on the frames that the solvers were trained on: the thesis does not say that its test frames are others."""
    clouds, truth = simulate_occlusions(drawn_frames(train, DRAWS // 4), hidden, 0, seed=hidden)
    votes = label_by_matrix(clouds, solvers, rules="printed")
    tally = Tally()
    tally.add(Labelling(votes.indices, votes.votes, train[0].labels), truth)
    cell = f"{THESIS}, frames of the training, {hidden} occlusion{'s' * (hidden > 1)}, target {target * 100:g} %"
    column = TARGETS.index(target)
    yield tally.figure(f"table 5.4, {cell}: FA (printed {THESIS_FA[hidden][column]:g})", "none", tally.false_assignments)
    yield tally.figure(f"table 5.5, {cell}: FO (printed {THESIS_FO[hidden][column]:g})", "none", tally.false_occlusions)
