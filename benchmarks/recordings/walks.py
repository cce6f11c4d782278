"""What the rows on gait recordings share: the conditions, one subject's trials, and the ensemble that has never seen the subject."""

from __future__ import annotations

from collections.abc import Iterator

import asterism
from asterism.labelling.simulated_occlusions import simulate_gaps_and_ghosts
from asterism.recording import Clouds, Ints, Recording
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import file_of, gait, people_and_trials

CONDITIONS = {
    "1 hidden": (1, 0),
    "3 hidden": (3, 0),
    "5 hidden": (5, 0),
    "3 hidden + 3 ghosts": (3, 3),
}
"""Markers hidden and ghost tracks there at every moment."""

SEEDS = 2
"""Times that each walk is hidden anew: the walks last 2 to 6 seconds."""

Markers = str | tuple[str, ...]


def walks(subject: str, markers: Markers = "helen-hayes") -> list[Recording]:
    """The subject's straight walk and the one with a turn."""
    return [trial for trial in gait(markers)[subject] if file_of(trial).stem != "static"]


def standing(subject: str, markers: Markers = "helen-hayes") -> Recording | None:
    """The subject's standing trial, which two of the eleven have not."""
    return next((trial for trial in gait(markers)[subject] if file_of(trial).stem == "static"), None)


def with_gaps(
    benchmark: BenchmarkRun, subject: str, hidden: int, ghosts: int, markers: Markers = "helen-hayes", seeds: int = SEEDS
) -> Iterator[tuple[Clouds, Ints]]:
    """The subject's walks with gaps and ghosts, the same ones for every method: clouds and the truth (T, M) about them."""
    for number, walk in enumerate(walks(subject, markers)):
        for seed in range(1 if benchmark.quick else seeds):
            yield simulate_gaps_and_ghosts(walk, hidden, ghosts, seed=SEEDS * number + seed)


def walk_of_draw(benchmark: BenchmarkRun, subject: str, draw: int) -> str:
    """Which walk the clouds of this place in `with_gaps` show, for the different frames of a tally."""
    return f"{subject}, walk {draw // (1 if benchmark.quick else SEEDS)}"


def unseen_training(benchmark: BenchmarkRun, subject: str, markers: Markers = "helen-hayes") -> tuple[list[str], list[Recording]]:
    """Everyone's recordings but this subject's, with a name for each; a quick run takes a second of the straight walks of three people."""
    people, train = people_and_trials(gait(markers), leave_out=subject)
    pairs = list(zip(people, train, strict=True))
    if benchmark.quick:
        pairs = [(person, trial.frames(slice(100))) for person, trial in pairs if file_of(trial).stem == "straight"][:3]
    return [person for person, _ in pairs], [trial for _, trial in pairs]


def unseen_ensemble(benchmark: BenchmarkRun, subject: str, markers: Markers = "helen-hayes") -> asterism.MarkerModel:
    """An ensemble that has learned from all other subjects."""
    people, train = unseen_training(benchmark, subject, markers)
    return benchmark.fit(train, people)
