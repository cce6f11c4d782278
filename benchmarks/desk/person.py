"""A person who knows the truth corrects recordings with the gaps and ghosts that they have: touches until every label is right."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from asterism.labelling.correction import Correction, Cut, Ghost, Name
from asterism.labelling.review import labels_of_points
from asterism.recording import Ints, Recording
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import Fold, movement_folds
from benchmarks.figures import Figure
from benchmarks.recordings.contradictions import impossible

SETS = ("vicon53/nick_freeform_001", "optitrack-wheelchair/racing_full", "optitrack-wheelchair/walkingOptiTrack", "clouthier62")
LONGEST = 3000
"""Frames of each recording that are corrected, from its beginning."""
MOST = 3000
"""Touches after which the person gives up."""


@dataclass(frozen=True)
class Course:
    """What correcting one recording took: touches, tracks that would have to be named one by one, points wrong before and after."""

    touches: int
    tracks: int
    wrong_before: int
    wrong_after: int
    points: int


def person(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """From one half of a trial to the other, or from one trial to the next; labels as a person gave them are the truth.

    Then the same, with hand labels that the body contradicts as no truth: who sees them would not follow them.
    """
    folds = _folds()[: 1 if benchmark.quick else None]
    courses: dict[str, list[tuple[Course, Course]]] = {}
    for fold, found in zip(folds, benchmark.each(_corrected, range(len(folds))), strict=True):
        courses.setdefault(fold.label, []).extend(found)
    for label, pairs in courses.items():
        row = f"a person who knows the truth, {label} as recorded"
        followed, possible = zip(*pairs, strict=True)
        yield from _figures(row, followed)
        if sum(course.points for course in possible) < sum(course.points for course in followed):
            yield from _figures(f"{row}, without hand labels that the body contradicts", possible)


def _figures(row: str, courses: Sequence[Course]) -> Iterator[Figure]:
    touches, tracks, points = (sum(getattr(course, name) for course in courses) for name in ("touches", "tracks", "points"))
    before, after = (sum(getattr(course, name) for course in courses) for name in ("wrong_before", "wrong_after"))
    share = touches / tracks
    yield Figure(f"{row}: touches to a perfect recording, as a share of the tracks", "<= 0.1", share, "fraction", tracks)
    yield Figure(f"{row}: touches", "none", touches, "touches", tracks)
    yield Figure(f"{row}: points wrong before", "none", before / points, "fraction", points)
    yield Figure(f"{row}: points wrong after", "<= 0", after, "points", points)


@cache
def _folds() -> list[Fold]:
    return list(movement_folds(SETS, halves=True))


def _corrected(benchmark: BenchmarkRun, number: int) -> list[tuple[Course, Course]]:
    fold = _folds()[number]
    ensemble = benchmark.fit(fold.train, fold.train_people)
    courses = []
    for test in fold.test:
        frames = test.frames[:LONGEST]
        doubtful = impossible(test.recording)[frames]
        pair = []
        for no_truth in (np.zeros_like(doubtful), doubtful):
            tracks = as_tracks(test.recording.frames(frames), ensemble.marker_set.names, no_truth)
            pair.append(correct(Correction(ensemble, tracks.recording), tracks) if no_truth.any() or not pair else pair[0])
        courses.append((pair[0], pair[1]))
        benchmark.report(f"{fold.label}, {fold.person}: {pair}")
    return courses


@dataclass(frozen=True)
class Tracks:
    """A recording whose N columns are unbroken stretches without names; the marker of each (N,); where it is no truth (T, N)."""

    recording: Recording
    marker: Ints
    doubtful: NDArray[np.bool_]


def as_tracks(recording: Recording, names: tuple[str, ...], doubtful: NDArray[np.bool_]) -> Tracks:
    """A recording's unbroken stretches, as a camera system gives them; doubtful (T, M): where its labels are no truth."""
    visible = recording.visible
    begins = visible & ~np.concatenate([np.zeros((1, visible.shape[1]), dtype=np.bool_), visible[:-1]])
    number = np.where(visible, np.cumsum(begins.T.ravel()).reshape(begins.T.shape).T - 1, -1)
    frames, columns = np.nonzero(visible)
    tracks = number[frames, columns]
    positions = np.full((len(recording), int(number.max()) + 1, 3), np.nan)
    positions[frames, tracks] = recording.positions[frames, columns]
    marker, no_truth = np.full(positions.shape[1], -1), np.zeros(positions.shape[:2], dtype=np.bool_)
    place = {name: m for m, name in enumerate(names)}
    marker[tracks] = np.array([place.get(label, -1) for label in recording.labels])[columns]
    no_truth[frames, tracks] = doubtful[frames, columns]
    order = np.random.default_rng(0).permutation(positions.shape[1])
    labels = tuple(f"*{n + 1}" for n in range(len(order)))
    return Tracks(Recording(positions[:, order], labels, recording.rate, recording.vertical), marker[order], no_truth[:, order])


def correct(correction: Correction, tracks: Tracks) -> Course:
    """Answer the list from its top; where it is empty and labels are still wrong, the longest piece that is wrong."""
    clouds = correction.clouds
    known = ~tracks.doubtful[clouds.frame_of, clouds.columns]
    truth = tracks.marker[clouds.columns]
    before = int(_wrong(correction, truth, known).sum())
    touches = 0
    while touches < MOST:
        piece = _next(correction, _wrong(correction, truth, known))
        if piece is None:
            break
        points = np.nonzero((correction.pieces.of_point == correction.pieces.place_of(piece)) & known)[0]
        meant = int(truth[points[0]])
        other = np.nonzero(truth[points] != meant)[0]
        if len(other):
            correction.apply(Cut(piece, int(clouds.frame_of[points[other[0]]])))
        else:
            correction.apply(Ghost(piece) if meant < 0 else Name(piece, correction.names[meant]))
        touches += 1
    count = len(np.unique(clouds.columns[known]))
    return Course(touches, count, before, int(_wrong(correction, truth, known).sum()), int(known.sum()))


def _next(correction: Correction, wrong: NDArray[np.bool_]) -> int | None:
    """The first piece of the list that is not right; else the longest that is not; None where all are.

    Looking at a piece that is right takes no touch: nothing has to be said.
    """
    if not wrong.any():
        return None
    for item in correction.items():
        if wrong[item.points].any():
            return int(item.points[0])
    pieces = correction.pieces
    count = np.bincount(pieces.of_point, weights=wrong, minlength=len(pieces))
    return int(pieces.id[int(np.argmax(count))])


def _wrong(correction: Correction, truth: Ints, known: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(P,) where a point's label is not the truth, as far as that is known."""
    return np.asarray((labels_of_points(correction.labelling, correction.clouds)[0] != truth) & known)
