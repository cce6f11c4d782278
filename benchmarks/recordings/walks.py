"""What the scripts on walks share: conditions, the clouds of a person under each, and models that have never seen the person."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

import asterism
from asterism.errors import AsterismError
from asterism.recording import NULL, Clouds, Ints, Labelling, MarkerSet, Recording
from asterism.simulation import Clutter, add_clutter, displace_marker, simulate_gaps_and_ghosts
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import CHOOSING, file_of, gait, people_and_trials

SEEDS = 2
"""Times that each walk is hidden anew: the walks last 2 to 6 seconds."""

HELEN_HAYES = "helen-hayes"
Markers = str | tuple[str, ...]


@dataclass(frozen=True)
class Condition:
    """Markers hidden at every moment, riding ghosts at every moment, clutter, and whether each person wears one marker oddly."""

    hidden: int = 0
    ghosts: int = 0
    clutter: Clutter | None = None
    displaced: bool = False


@dataclass(frozen=True)
class Sample:
    """A walk under a condition: as it was worn, the clouds with track numbers, and the truth (T, M) about them."""

    walk: Recording
    clouds: Clouds
    truth: Ints


def reporting() -> list[str]:
    """The gait subjects on which nothing is chosen."""
    return [subject for subject in gait() if subject not in CHOOSING][:5]


def full_body_subjects() -> list[str]:
    """Those who are left out of models of all markers, for every script that needs one: learning it takes a minute."""
    return list(gait())[3:7:3]


def walks(subject: str, markers: Markers = HELEN_HAYES) -> list[Recording]:
    """The subject's straight walk and the one with a turn."""
    return [trial for trial in gait(markers)[subject] if file_of(trial).stem != "static"]


def standing(subject: str) -> Recording | None:
    """The subject's standing trial, which two of the eleven have not."""
    return next((trial for trial in gait()[subject] if file_of(trial).stem == "static"), None)


def samples(
    benchmark: BenchmarkRun, subject: str, condition: Condition, markers: Markers = HELEN_HAYES, seeds: int = SEEDS
) -> Iterator[Sample]:
    """The subject's walks under a condition, each so many times, the same ones for every method."""
    for number, walk in enumerate(walks(subject, markers)):
        for repeat in range(1 if benchmark.quick else seeds):
            yield sample(walk, condition, SEEDS * number + repeat, SEEDS * list(gait()).index(subject) + repeat)


def sample(walk: Recording, condition: Condition, seed: int, marker_seed: int = 0) -> Sample:
    """One walk under a condition; `marker_seed` chooses which marker is displaced: a person wears it alike in all walks."""
    if condition.displaced:
        walk, _ = displace_marker(walk, MarkerSet.load(HELEN_HAYES), seed=marker_seed)
    clouds, truth = simulate_gaps_and_ghosts(walk, condition.hidden, condition.ghosts, seed=seed)
    if condition.clutter:
        clouds, truth = add_clutter(walk, clouds, truth, condition.clutter, seed=1000 + seed)
    return Sample(walk, clouds, truth)


def unnumbered(clouds: Clouds) -> Clouds:
    """The same clouds without track numbers."""
    return replace(clouds, tracks=None)


def unseen_training(benchmark: BenchmarkRun, subject: str, markers: Markers = HELEN_HAYES) -> tuple[list[str], list[Recording]]:
    """Everyone's recordings but this subject's, with a name for each; a quick run takes a second of the straight walks of three people."""
    people, train = people_and_trials(gait(markers), leave_out=subject)
    pairs = list(zip(people, train, strict=True))
    if benchmark.quick:
        pairs = [(person, trial.frames(slice(100))) for person, trial in pairs if file_of(trial).stem == "straight"][:3]
    return [person for person, _ in pairs], [trial for _, trial in pairs]


def unseen_model(benchmark: BenchmarkRun, subject: str, markers: Markers = HELEN_HAYES) -> asterism.MarkerModel:
    """A model that has learned from all other subjects."""
    people, train = unseen_training(benchmark, subject, markers)
    return benchmark.fit(train, people)


def label_whole(model: asterism.MarkerModel, clouds: Clouds, truth: Ints) -> Labelling:
    """The recording labelled as a whole; no label at all where it is refused."""
    try:
        return model.label(clouds)
    except AsterismError:
        return silence(truth, model.marker_set.names)


def silence(truth: Ints, names: tuple[str, ...]) -> Labelling:
    """The labelling of whoever has learned nothing."""
    return Labelling(np.full(truth.shape, NULL, dtype=np.int64), np.zeros(truth.shape), names)
