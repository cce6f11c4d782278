"""What the rows about clutter share: the conditions, the clouds of a subject under each, and models of all others."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

import asterism
from asterism.errors import AsterismError
from asterism.recording import Clouds, Ints, Labelling, MarkerSet, Recording
from asterism.simulation import Clutter, add_clutter, displace_marker, simulate_gaps_and_ghosts
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import CHOOSING, gait
from benchmarks.recordings.movement import silence
from benchmarks.recordings.walks import Markers, unseen_ensemble, walks

SEEDS = 2
"""Times that each walk is hidden and cluttered anew: with the five subjects reported on some 6,000 frames, 90,000 markers."""


@dataclass(frozen=True)
class Condition:
    """Markers hidden at every moment, riding ghosts at every moment, clutter, and whether each person wears one marker oddly."""

    hidden: int = 0
    ghosts: int = 0
    clutter: Clutter | None = None
    displaced: bool = False


def reporting() -> list[str]:
    """The gait subjects on which nothing is chosen."""
    return [subject for subject in gait() if subject not in CHOOSING][:5]


@dataclass(frozen=True)
class Sample:
    """A walk under a condition: as it was worn, the clouds with track numbers, and the truth (T, M) about them."""

    walk: Recording
    clouds: Clouds
    truth: Ints


def samples(subject: str, condition: Condition, repeats: int = SEEDS) -> Iterator[Sample]:
    """The subject's walks under a condition, each so many times, the same ones for every method."""
    for number, walk in enumerate(walks(subject)):
        for repeat in range(repeats):
            yield sample(walk, condition, SEEDS * number + repeat, SEEDS * list(gait()).index(subject) + repeat)


def sample(walk: Recording, condition: Condition, seed: int, marker_seed: int = 0) -> Sample:
    """One walk under a condition; `marker_seed` chooses which marker is displaced: a person wears it alike in all walks."""
    if condition.displaced:
        walk, _ = displace_marker(walk, MarkerSet.load("helen-hayes"), seed=marker_seed)
    clouds, truth = simulate_gaps_and_ghosts(walk, condition.hidden, condition.ghosts, seed=seed)
    if condition.clutter:
        clouds, truth = add_clutter(walk, clouds, truth, condition.clutter, seed=1000 + seed)
    return Sample(walk, clouds, truth)


def unnumbered(clouds: Clouds) -> Clouds:
    """The same clouds without track numbers."""
    return replace(clouds, tracks=None)


def ensemble_of(benchmark: BenchmarkRun, subject: str, markers: Markers = "helen-hayes") -> asterism.MarkerModel:
    """A model of all others."""
    return unseen_ensemble(benchmark, subject, markers)


def label_whole(ensemble: asterism.MarkerModel, clouds: Clouds, truth: Ints) -> Labelling:
    """The recording labelled as a whole; no label at all where it is refused."""
    try:
        return ensemble.label(clouds)
    except AsterismError:
        return silence(truth, ensemble.marker_set.names)


def cut(walk: Recording, most: int) -> Recording:
    """The first so many frames, or all."""
    return walk if len(walk) <= most else walk.frames(np.arange(most))
