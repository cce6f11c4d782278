"""The guarantee: on any clouds the whole recording has at least as many right and no more wrong than its frames, up to 0.1 points.

Markers whose hand labels cannot be (`contradictions`) are left out on both sides. Cells are drawn from the grid of rates, lives, places,
hidden markers, with and without track numbers and of three sets of markers, each level of each equally often and in random order (a Latin
hypercube with a fixed seed).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from asterism.simulation import Clutter
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import GAIT_BODY, file_of
from benchmarks.dirt.walks import Condition, cut, ensemble_of, label_whole, reporting, sample, unnumbered
from benchmarks.figures import Figure
from benchmarks.recordings.contradictions import believable
from benchmarks.recordings.full_body import full_body_subjects
from benchmarks.recordings.walks import Markers, walks
from benchmarks.score import Tally

RATES = (0.0, 0.3, 1.0, 3.0, 10.0, 30.0)
LIVES = (1, 2, 3, 10, 50, None)
PLACES: tuple[tuple[Literal["beside", "fixed", "crossing"], float], ...] = (
    ("beside", 0.03),
    ("beside", 0.08),
    ("beside", 0.15),
    ("fixed", 0.0),
    ("crossing", 0.0),
)
HIDDEN = (0, 1, 2, 3, 4, 5)
_FOOT = {side + name for side in "LR" for name in ("HFB", "TUB", "SHN", "CPG", "LCA", "STL", "NAV", "P1M", "P5M")}
BODY_41 = tuple(name for name in GAIT_BODY if name not in _FOOT)
"""All but the inner markers of the Oxford foot: 41."""
SETS: dict[int, Markers] = {15: "helen-hayes", 41: BODY_41, len(GAIT_BODY): GAIT_BODY}
CELLS, SEED = 48, 13
LONGEST = 300
"""Frames of each walk."""
ALLOWED = 0.001


@dataclass(frozen=True)
class Cell:
    """One place of the grid."""

    clutter: Clutter
    hidden: int
    numbered: bool
    markers: int

    def __str__(self) -> str:
        at = self.clutter.place + (f" {1000 * self.clutter.spread:.0f} mm" if self.clutter.place == "beside" else "")
        life = "the whole recording" if self.clutter.life is None else f"{self.clutter.life} frames"
        numbers = "with" if self.numbered else "without"
        return f"{self.markers} markers, {self.hidden} hidden, {self.clutter.per_frame:g} {at}, life {life}, {numbers} numbers"


def cells(count: int = CELLS, seed: int = SEED) -> list[Cell]:
    """So many cells of the grid."""
    rng = np.random.default_rng(seed)

    def drawn(levels: int) -> list[int]:
        return list(rng.permutation(np.arange(count) % levels))

    # two thirds of the cells have 15 markers: a model of more takes minutes to learn
    sizes = [tuple(SETS)[max(0, place - 3)] for place in drawn(6)]
    chosen = zip(drawn(len(RATES)), drawn(len(LIVES)), drawn(len(PLACES)), drawn(len(HIDDEN)), drawn(2), sizes, strict=True)
    return [
        Cell(Clutter(RATES[rate], LIVES[life], *PLACES[place]), HIDDEN[hidden], bool(numbered), size)
        for rate, life, place, hidden, numbered, size in chosen
    ]


def guarantee(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """The worst cell's loss of right labels and gain of wrong ones against its frames, and in how many cells the guarantee holds."""
    grid = [cell for cell in cells() if not benchmark.quick or cell.markers == 15][: 4 if benchmark.quick else None]
    found = list((replace(benchmark, jobs=1) if benchmark.quick else benchmark).each(_cell, list(enumerate(grid))))
    for cell, (whole, framewise) in zip(grid, found, strict=True):
        told = f"right {whole.right_share:.5f} of {framewise.right_share:.5f}"
        benchmark.report(f"{cell}: {told}, wrong {whole.false_assignments:.5f} of {framewise.false_assignments:.5f}")
    every = Tally()
    for whole, _ in found:
        every += whole
    lost = [framewise.right_share - whole.right_share for whole, framewise in found]
    gained = [whole.false_assignments - framewise.false_assignments for whole, framewise in found]
    worst = np.maximum(lost, gained)
    row = f"guarantee, {len(grid)} cells of the grid, whole recording against its frames"
    yield Figure(f"{row}: right lost, worst cell", f"<= {ALLOWED}", max(lost), "fraction", every.distinct, every.frames)
    yield Figure(f"{row}: wrong gained, worst cell", f"<= {ALLOWED}", max(gained), "fraction", every.distinct, every.frames)
    yield Figure(f"{row}: cells that hold", "== 1", float((worst <= ALLOWED).mean()), "fraction", len(grid))
    for place, method in enumerate(("whole recording", "frame by frame")):
        tallies = [both[place] for both in found]
        row = f"guarantee, all cells, {method}"
        yield every.figure(f"{row}: right", "none", float(np.mean([tally.right_share for tally in tallies])))
        yield every.figure(f"{row}: wrong", "none", float(np.mean([tally.false_assignments for tally in tallies])))


def _cell(benchmark: BenchmarkRun, item: tuple[int, Cell]) -> tuple[Tally, Tally]:
    number, cell = item
    subjects = reporting()
    large = next(subject for subject in subjects if subject in full_body_subjects())
    subject = subjects[number % len(subjects)] if cell.markers == 15 and not benchmark.quick else large
    markers = SETS[cell.markers]
    ensemble, whole, framewise = ensemble_of(benchmark, subject, markers), Tally(), Tally()
    for seed, walk in enumerate(walks(subject, markers)):
        one = sample(cut(walk, LONGEST), Condition(cell.hidden, clutter=cell.clutter), 2 * number + seed)
        clouds = one.clouds if cell.numbered else unnumbered(one.clouds)
        for tally, labelling in ((whole, label_whole(ensemble, clouds, one.truth)), (framewise, ensemble.label(clouds))):
            tally.add(*believable(labelling, one.truth, walk), recording=str(file_of(walk)))
    return whole, framewise
