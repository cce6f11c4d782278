"""How long one touch takes: a minute of 15 markers and of 59, with gaps and with ghosts, every kind of touch."""

from __future__ import annotations

import time
from collections.abc import Iterator
from statistics import median

import numpy as np

from asterism.labelling.correction import Correction, Cut, Ghost, Name, Right
from asterism.recording import Clouds, Ints, Recording
from asterism.simulation import simulate_gaps_and_ghosts
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import GAIT_BODY
from benchmarks.figures import Figure
from benchmarks.recordings.walks import unseen_ensemble, walks

SUBJECT = "HC031"
"""Who is left out, as in the rows on speed."""
SECONDS = 60
TOUCHES = 15
CONDITIONS = {"no gaps": (0, 0), "2 hidden": (2, 0), "2 hidden + 1 ghost": (2, 1)}


def resolve(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """The median over touches, each taken and then taken back: labels, pieces, and what else changed; and with the list beside it."""
    for markers, asked in (("helen-hayes", "< 0.2"), (GAIT_BODY, "< 1")):
        if benchmark.quick and markers != "helen-hayes":
            continue
        ensemble, walk = (
            unseen_ensemble(benchmark, SUBJECT, markers),
            long_walk(walks(SUBJECT, markers), 10 if benchmark.quick else SECONDS),
        )
        for condition, (hidden, ghosts) in CONDITIONS.items():
            clouds, truth = simulate_gaps_and_ghosts(walk, hidden, ghosts, seed=1)
            correction = Correction(ensemble, as_columns(clouds))
            taken, listed = _seconds_of_touches(correction, marker_of_pieces(correction, clouds, truth))
            row = f"one touch, {SECONDS} s of {len(walk.labels)} markers, {condition}"
            yield Figure(f"{row}: labelled again, median", asked, median(taken), "s", len(taken))
            yield Figure(f"{row}: and the list made anew, median", "none", median(listed), "s", len(listed))


def long_walk(trials: list[Recording], seconds: int) -> Recording:
    """Trials forwards and backwards, one behind the other, until they last so long."""
    frames, parts, count = round(seconds * trials[0].rate), [], 0
    while count < frames:
        trial = trials[len(parts) // 2 % len(trials)]
        parts.append(trial.positions[:: 1 if len(parts) % 2 == 0 else -1])
        count += len(trial)
    return Recording(np.concatenate(parts)[:frames], trials[0].labels, trials[0].rate, trials[0].vertical)


def as_columns(clouds: Clouds) -> Recording:
    """Clouds as a file of them would be read: a column without a name for each track."""
    assert clouds.tracks is not None
    numbers, column = np.unique(clouds.tracks, return_inverse=True)
    positions = np.full((len(clouds), len(numbers), 3), np.nan)
    positions[clouds.frame_of, column] = clouds.xyz
    return Recording(positions, tuple(f"*{n + 1}" for n in range(len(numbers))), clouds.rate, clouds.vertical)


def marker_of_pieces(correction: Correction, clouds: Clouds, truth: Ints) -> Ints:
    """The true marker of each piece, -1 for ghosts, by its place; truth (T, M) about the clouds that `as_columns` was given."""
    assert clouds.tracks is not None
    marker_of_track = np.full(int(clouds.tracks.max()) + 1, -1)
    frames, markers = np.nonzero(truth >= 0)
    marker_of_track[clouds.tracks[clouds.offsets[frames] + truth[frames, markers]]] = markers
    numbers = np.unique(clouds.tracks)
    return np.asarray(marker_of_track[numbers[correction.clouds.columns[correction.pieces.id]]])


def _seconds_of_touches(correction: Correction, truth: Ints) -> tuple[list[float], list[float]]:
    """Right and wrong touches of every kind, on long pieces and on those of the list: seconds of each, without and with the list."""
    pieces = correction.pieces
    long = np.argsort(pieces.first - pieces.last, kind="stable")[:TOUCHES]
    asked = [pieces.place_of(int(item.points[0])) for item in correction.items()[:TOUCHES]]
    taken, listed = [], []
    correction.apply(Right(int(pieces.id[long[0]])))  # what the first touch alone works out
    correction.undo()
    for number, place in enumerate([place for pair in zip(long, [*asked, *long], strict=False) for place in pair][:TOUCHES]):
        piece, marker = int(pieces.id[place]), int(truth[place])
        middle = int(pieces.first[place] + pieces.last[place] + 1) // 2
        wrong = correction.names[(marker + 1) % len(correction.names)]
        kinds = (
            Ghost(piece) if marker < 0 else Name(piece, correction.names[marker]),
            Name(piece, wrong),
            Ghost(piece),
            Cut(piece, middle) if middle > pieces.first[place] else Right(piece),
        )
        started = time.perf_counter()
        correction.apply(kinds[number % len(kinds)])
        taken.append(time.perf_counter() - started)
        correction.items()
        listed.append(time.perf_counter() - started)
        correction.undo()
    return taken, listed
