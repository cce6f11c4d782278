"""A person who knows the truth corrects recordings with the gaps and ghosts that they have: touches until every label is right."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np

from asterism.labelling.correction import Correction, Cut, Ghost, Name
from asterism.labelling.review import labels_of_points
from asterism.recording import Clouds, Ints, Recording
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import Fold, movement_folds
from benchmarks.figures import Figure

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
    """From one half of a trial to the other, or from one trial to the next; labels as a person gave them are the truth."""
    folds = _folds()[: 1 if benchmark.quick else None]
    courses: dict[str, list[Course]] = {}
    for fold, found in zip(folds, benchmark.each(_corrected, range(len(folds))), strict=True):
        courses.setdefault(fold.label, []).extend(found)
    for label, some in courses.items():
        touches, tracks = sum(course.touches for course in some), sum(course.tracks for course in some)
        row = f"a person who knows the truth, {label} as recorded"
        yield Figure(f"{row}: touches to a perfect recording, as a share of the tracks", "<= 0.1", touches / tracks, "fraction", tracks)
        yield Figure(f"{row}: touches", "none", touches, "touches", tracks)
        points = sum(course.points for course in some)
        yield Figure(f"{row}: points wrong before", "none", sum(course.wrong_before for course in some) / points, "fraction", points)
        yield Figure(f"{row}: points wrong after", "<= 0", sum(course.wrong_after for course in some), "points", points)


@cache
def _folds() -> list[Fold]:
    return list(movement_folds(SETS, halves=True))


def _corrected(benchmark: BenchmarkRun, number: int) -> list[Course]:
    fold = _folds()[number]
    ensemble = benchmark.fit(fold.train, fold.train_people)
    courses = []
    for test in fold.test:
        recording, truth = as_tracks(test.recording.frames(test.frames[:LONGEST]), ensemble.marker_set.names)
        courses.append(correct(Correction(ensemble, recording), truth))
        benchmark.report(f"{fold.label}, {fold.person}: {courses[-1]}")
    return courses


def as_tracks(recording: Recording, names: tuple[str, ...]) -> tuple[Recording, Ints]:
    """A recording whose columns are unbroken stretches without names, as a camera system gives them; and the marker of each column."""
    visible = recording.visible
    begins = visible & ~np.concatenate([np.zeros((1, visible.shape[1]), dtype=np.bool_), visible[:-1]])
    number = np.where(visible, np.cumsum(begins.T.ravel()).reshape(begins.T.shape).T - 1, -1)
    frames, columns = np.nonzero(visible)
    positions = np.full((len(recording), int(number.max()) + 1, 3), np.nan)
    positions[frames, number[frames, columns]] = recording.positions[frames, columns]
    marker = np.full(positions.shape[1], -1)
    place = {name: m for m, name in enumerate(names)}
    marker[number[frames, columns]] = np.array([place.get(label, -1) for label in recording.labels])[columns]
    order = np.random.default_rng(0).permutation(positions.shape[1])
    labels = tuple(f"*{n + 1}" for n in range(len(order)))
    return Recording(positions[:, order], labels, recording.rate, recording.vertical), marker[order]


def correct(correction: Correction, marker_of_column: Ints) -> Course:
    """Answer the list from its top; where it is empty and labels are still wrong, the longest piece that is wrong."""
    clouds = correction.clouds
    truth = marker_of_column[clouds.columns]
    before = _wrong(correction, truth)
    touches = 0
    while touches < MOST:
        piece = _next(correction, clouds, truth)
        if piece is None:
            break
        points = np.nonzero(correction.pieces.of_point == correction.pieces.place_of(piece))[0]
        other = np.nonzero(truth[points] != truth[points[0]])[0]
        if len(other):
            correction.apply(Cut(piece, int(clouds.frame_of[points[other[0]]])))
        else:
            correction.apply(Ghost(piece) if truth[piece] < 0 else Name(piece, correction.names[truth[piece]]))
        touches += 1
    return Course(touches, len(marker_of_column), before, _wrong(correction, truth), len(truth))


def _next(correction: Correction, clouds: Clouds, truth: Ints) -> int | None:
    """The first piece of the list that is not right; else the longest that is not; None where all are.

    Looking at a piece that is right takes no touch: nothing has to be said.
    """
    wrong = labels_of_points(correction.labelling, clouds)[0] != truth
    if not wrong.any():
        return None
    for item in correction.items():
        if wrong[item.points].any():
            return int(item.points[0])
    pieces = correction.pieces
    count = np.bincount(pieces.of_point, weights=wrong, minlength=len(pieces))
    return int(pieces.id[int(np.argmax(count))])


def _wrong(correction: Correction, truth: Ints) -> int:
    return int((labels_of_points(correction.labelling, correction.clouds)[0] != truth).sum())
