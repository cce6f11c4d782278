"""Swaps inside tracks, links by motion, and false cuts: on every gait recording, with 15 markers and with all."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from asterism.labelling.simulated_occlusions import simulate_gaps_and_ghosts
from asterism.recording import Clouds, Ints, Recording
from asterism.tracking.linking import Tracklets, find_tracklets
from benchmarks.benchmark_run import BenchmarkRun, frames_per_second
from benchmarks.data import GAIT_BODY, gait
from benchmarks.figures import Figure

SWAPS = 10
"""Swaps tried in each recording, one at a time."""
NEIGHBOURS = 3
"""A marker swaps with one of so many nearest ones."""


def swaps(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Two neighbouring columns exchange their markers for the rest of the trial; then the recordings as they are; then raw clouds."""
    for markers in ("helen-hayes", GAIT_BODY):
        rng = np.random.default_rng(0)
        trials = [trial for recordings in gait(markers).values() for trial in recordings][: 3 if benchmark.quick else None]
        name = f"{len(trials[0].labels)} markers"
        tried, cut, false, cleanly = 0, 0, 0, 0
        for trial in trials:
            false += _cuts(_columns(trial))
            for _ in range(SWAPS):
                swapped = _swapped(trial, rng)
                if swapped is None:
                    continue
                recording, i, j, t = swapped
                of = _columns(recording)
                tried += 1
                cut += all(of[t - 3, k] < 0 or of[t - 3, k] != of[t + 2, k] for k in (i, j))
                cleanly += of[t - 1, i] == of[t, j] and of[t - 1, j] == of[t, i]
        yield Figure(f"swaps in a track, {name}: cut within 3 frames", ">= 0.95", cut / tried, "fraction", tried)
        yield Figure(f"swaps in a track, {name}: joined again by motion", "none", cleanly / tried, "fraction", tried)
        yield Figure(f"swaps in a track, {name}: false cuts per 10 recordings", "< 1", 10 * false / len(trials), "cuts", len(trials))
        for hidden, ghosts in ((3, 0), (5, 0), (3, 3)):
            wrong, missing, there = 0, 0, 0
            for number, trial in enumerate(trials):
                clouds, truth = simulate_gaps_and_ghosts(trial, hidden, ghosts, seed=number, number_tracks=False)
                parts = _compare(find_tracklets(clouds), clouds, truth)
                wrong, missing, there = wrong + parts[0], missing + parts[1], there + parts[2]
            condition = f"{hidden} hidden" + (f" + {ghosts} ghosts" if ghosts else "")
            asked = "< 0.0001" if ghosts else "< 0.00001"
            yield Figure(f"links by motion, {name}, {condition}: wrong", asked, wrong / there, "fraction", there, ours=True)
            yield Figure(f"links by motion, {name}, {condition}: missing", "none", missing / there, "fraction", there)
        clouds = simulate_gaps_and_ghosts(trials[0], 3, 3, number_tracks=False)[0]
        rate = frames_per_second(lambda clouds=clouds: find_tracklets(clouds), len(clouds))
        yield Figure(f"links by motion, {name}, 3 hidden + 3 ghosts: speed, one core", "none", rate, "frames/s", len(clouds))


def _columns(recording: Recording) -> Ints:
    """(T, M) the tracklet of each sample, -1 where there is none."""
    clouds = recording.clouds()
    of = np.full(recording.visible.shape, -1, dtype=np.int64)
    of[_frame_of(clouds), clouds.columns] = find_tracklets(clouds).of_point
    return of


def _cuts(of: Ints) -> int:
    return int(((of[1:] >= 0) & (of[:-1] >= 0) & (of[1:] != of[:-1])).sum())


def _swapped(recording: Recording, rng: np.random.Generator) -> tuple[Recording, int, int, int] | None:
    """Two neighbours exchanged from a frame on: (recording, column, column, frame); None where one of them is not there."""
    positions = recording.positions.copy()
    t, i = int(rng.integers(5, len(recording) - 5)), int(rng.integers(positions.shape[1]))
    away = np.linalg.norm(positions[t] - positions[t, i], axis=1)
    j = int(np.argsort(np.where(np.isnan(away), np.inf, away))[1 + rng.integers(NEIGHBOURS)])
    if np.isnan(positions[t - 1 : t + 1][:, [i, j]]).any():
        return None
    positions[t:, [i, j]] = positions[t:, [j, i]]
    return replace(recording, positions=positions), i, j, t


def _compare(tracklets: Tracklets, clouds: Clouds, truth: NDArray[np.int64]) -> tuple[int, int, int]:
    """Links that join two markers (or a marker and a ghost), links that are missing, and links that there are in truth."""
    marker = np.full(len(clouds.xyz), -1, dtype=np.int64)
    frames, markers = np.nonzero(truth >= 0)
    marker[clouds.offsets[frames] + truth[frames, markers]] = markers
    order = np.lexsort((_frame_of(clouds), tracklets.of_point))
    before, after = order[:-1], order[1:]
    linked = tracklets.of_point[before] == tracklets.of_point[after]
    first, second = marker[before[linked]], marker[after[linked]]
    there = int(((truth[1:] >= 0) & (truth[:-1] >= 0)).sum())
    return int((first != second).sum()), there - int(((first == second) & (first >= 0)).sum()), there


def _frame_of(clouds: Clouds) -> Ints:
    return np.repeat(np.arange(len(clouds)), clouds.counts)
