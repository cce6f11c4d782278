"""The thesis' own experiment (tables 5.3 to 5.5) by its own rules: subjects seen, odd and even blocks."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from asterism.labelling.partial.matrix import label_by_matrix
from asterism.labelling.partial.search_strategies import search_partial_solvers
from asterism.labelling.partial.solver import stack_frames
from asterism.labelling.partial.solver_search import PRINTED, PRINTED_FEATURES
from asterism.labelling.simulated_occlusions import simulate_occlusions
from asterism.recording import Labelling
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import blocks, evenly, gait, people_and_trials
from benchmarks.figures import Figure, reached
from benchmarks.labelling.seen import FRAMES, TARGETS, THESIS_FA, THESIS_FO, by_marker, redrawn, test_frames

PRINTED_MARKERS = {
    "RASI": (0.0002, 0.0638), "LASI": (0.0002, 0.0555), "SACR": (0.0, 0.0611), "RTHI": (0.0, 0.4503), "LTHI": (0.0001, 0.0485),
    "RKNE": (0.0, 0.3003), "LKNE": (0.0001, 0.4458), "RTIB": (0.0001, 0.0420), "LTIB": (0.0003, 0.0471), "RANK": (0.0003, 0.3402),
    "LANK": (0.0001, 0.4930), "RHEE": (0.0005, 0.4214), "LHEE": (0.0001, 0.4506), "RTOE": (0.0004, 0.3467), "LTOE": (0.0005, 0.4513),
}  # fmt: skip
"""Table 5.3, FA and FO of each marker at 99.99 % and 4 occlusions; its wands and calves are THI and TIB here."""

THESIS = "thesis rules"
DRAWS = FRAMES // 4
"""Frames that each cell is about, drawn and hidden anew."""
MAIN = 0.9999
"""The target hit rate that the thesis recommends."""


def thesis(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Tables 5.4 and 5.5 cell by cell, table 5.3 marker by marker, and how many cells reach the print."""
    found = list(benchmark.each(_column, TARGETS))
    for figures in found:
        yield from figures
    yield _reached("all targets", [figure for figures in found for figure in figures])


def thesis_main(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """The column of the recommended target hit rate alone."""
    figures = _column(benchmark, MAIN)
    yield from figures
    yield _reached(f"target {100 * MAIN:g} %", figures)


def _reached(which: str, figures: list[Figure]) -> Figure:
    cells = [figure for figure in figures if figure.row.startswith(("table 5.4", "table 5.5"))]
    met = sum(bool(reached(figure.asked, figure.measured)) for figure in cells)
    return Figure(f"tables 5.4 and 5.5, {which}: cells at or better than printed", f">= {len(cells)}", met, "cells", len(cells))


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
        clouds, truth = simulate_occlusions(test_frames(1024 if benchmark.quick else DRAWS), hidden, 0, seed=hidden)
        votes = label_by_matrix(clouds, solvers, rules="printed")
        labelling = Labelling(votes.indices, votes.votes, recordings[0].labels)
        tally = redrawn(labelling, truth)
        fa, fo = tally.false_assignments, tally.false_occlusions
        cell = f"{THESIS}, subjects seen, {hidden} occlusion{'s' * (hidden > 1)}, target {target * 100:g} %"
        figures.append(tally.figure(f"table 5.4, {cell}: FA", f"<= {THESIS_FA[hidden][column]:g}", fa))
        figures.append(tally.figure(f"table 5.5, {cell}: FO", f"<= {THESIS_FO[hidden][column]:g}", fo))
        if target == MAIN and hidden == 4:
            figures += by_marker(cell, labelling, truth, tally, PRINTED_MARKERS)
    return figures
