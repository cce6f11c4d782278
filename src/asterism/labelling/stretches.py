"""Recordings too long to be labelled at once: clouds by ranges of frames in; one labelling, joined of overlapping stretches, out.

A whole recording's labelling takes some 250 bytes for each point. A stretch of minutes shows a person's body as well as an hour does, so
that long recordings are labelled stretch by stretch. Neighbouring stretches share some seconds. Each frame has the labels of the stretch
that shows more of what is around it, and a tracklet that two stretches name differently has the name of which it is more certain.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from asterism.labelling.review import labels_of_points
from asterism.progress import Progress
from asterism.recording import NULL, Clouds, Floats, Ints, Labelling
from asterism.recording.verdict import FITS, Verdict
from asterism.tracking.linking import find_tracklets

LabelsClouds = Callable[[Clouds, Progress | None], Labelling]
"""Labels clouds as a whole, and reports its progress."""


@dataclass(frozen=True)
class StretchRules:
    """How a long recording is divided. Chosen by memory alone: with these, an hour of 39 markers takes less than 1 GB.

    whole    points up to which a recording is labelled at once
    points   points of a stretch, about
    overlap  s that neighbouring stretches share
    """

    whole: int = 2_000_000
    points: int = 500_000
    overlap: float = 20.0


@dataclass(frozen=True)
class _StretchLabels:
    """The labels of one stretch, which joining changes.

    first       its first frame
    clouds      its points
    track       (P,) the tracklet of each of them
    marker      (P,) their markers, -1 for none
    confidence  (P,) of these labels
    labelling   of its clouds
    """

    first: int
    clouds: Clouds
    track: Ints
    marker: Ints
    confidence: Floats
    labelling: Labelling

    @classmethod
    def of(cls, first: int, clouds: Clouds, labelling: Labelling) -> _StretchLabels:
        marker, confidence = labels_of_points(labelling, clouds)
        return cls(first, clouds, find_tracklets(clouds).of_point, marker, confidence, labelling)

    def take_back(self, track: int, marker: int) -> Ints:
        """Take its label from the points of a tracklet that bear this marker, and give these points."""
        points, frames = self._points(track, marker)
        self.labelling.indices[frames, marker], self.labelling.confidence[frames, marker] = NULL, 0.0
        self.marker[points] = NULL
        if self.labelling.candidates is not None:
            self.labelling.candidates[frames, marker] = NULL
        return points

    def give(self, points: Ints, marker: int, confidence: float) -> None:
        """Give points without a label a marker, where no point of their frame bears it; no more certain than they were, nor than this."""
        frames = self._frames(points)
        free = self.labelling.indices[frames, marker] == NULL
        points, frames = points[free], frames[free]
        self.marker[points] = marker
        self.confidence[points] = np.minimum(self.confidence[points], confidence)
        self.labelling.indices[frames, marker] = points - self.clouds.offsets[frames]
        self.labelling.confidence[frames, marker] = self.confidence[points]
        if self.labelling.candidates is not None:
            self.labelling.candidates[frames, marker] = NULL

    def lower(self, track: int, marker: int, confidence: float) -> None:
        """Make the label of a tracklet as uncertain as this at least."""
        points, frames = self._points(track, marker)
        self.confidence[points] = np.minimum(self.confidence[points], confidence)
        self.labelling.confidence[frames, marker] = self.confidence[points]

    def _points(self, track: int, marker: int) -> tuple[Ints, Ints]:
        """The points of a tracklet that bear a marker, and their frames."""
        points = np.nonzero((self.track == track) & (self.marker == marker))[0]
        return points, self._frames(points)

    def _frames(self, points: Ints) -> Ints:
        return np.searchsorted(self.clouds.offsets, points, side="right") - 1


def stretches(frames: int, length: int, overlap: int) -> list[slice]:
    """So many frames in stretches of equal length, no longer than given, that share `overlap` frames with the next or a few more."""
    if frames <= length:
        return [slice(0, frames)]
    count = -(-(frames - overlap) // max(1, length - overlap))
    own = (frames - overlap) / count
    return [slice(int(number * own), min(frames, int(np.ceil((number + 1) * own)) + overlap)) for number in range(count)]


def label_in_stretches(
    label: LabelsClouds,
    clouds_of: Callable[[slice], Clouds],
    parts: Sequence[slice],
    *,
    progress: Progress | None = None,
) -> Iterator[tuple[int, Labelling]]:
    """The labelling of a long recording, piece by piece: each piece's first frame and its labels, joined with those of its neighbours.

    label: labels the clouds of one stretch; clouds_of: the points of a range of frames; parts: see `stretches`. The pieces follow each
    other without a gap. Memory for two stretches.
    Raises SeveralBodies where a stretch certainly shows two bodies.
    """
    if len(parts) == 1:  # nothing to join: what joining needs is not looked for
        yield parts[0].start, label(clouds_of(parts[0]), progress)
        return
    before: _StretchLabels | None = None
    begin = 0
    for number, frames in enumerate(parts):
        report = None if progress is None else _share(progress, number, len(parts))
        clouds = clouds_of(frames)
        part = _StretchLabels.of(frames.start, clouds, label(clouds, report))
        if before is not None:
            _agree(before, part)
            seam = (frames.start + parts[number - 1].stop) // 2
            yield begin, _frames(before.labelling, slice(begin - before.first, seam - before.first))
            begin = seam
        before = part
    if before is not None:
        yield begin, _frames(before.labelling, slice(begin - before.first, None))


def _share(progress: Progress, number: int, count: int) -> Progress:
    """Progress of one stretch as progress of all."""
    return lambda fraction, what: progress((number + fraction) / count, what)


def _agree(before: _StretchLabels, after: _StretchLabels) -> None:
    """Give each tracklet that two neighbouring stretches show, and name differently, one name: that of the stretch that is more certain.

    The name is then as uncertain as that of the other stretch.
    """
    start = before.clouds.offsets[after.first - before.first]
    shared = len(before.clouds.xyz) - start
    here = np.s_[start : start + shared]
    pairs = np.stack([before.track[here], before.marker[here], after.track[:shared], after.marker[:shared]], axis=1)
    differ = (pairs[:, 1] != pairs[:, 3]) & (pairs[:, 1] != NULL) & (pairs[:, 3] != NULL)
    renamed = list[tuple[_StretchLabels, Ints, int, float]]()
    for track, marker, later_track, later_marker in np.unique(pairs[differ], axis=0).tolist():
        points = np.nonzero((pairs == (track, marker, later_track, later_marker)).all(axis=1))[0]
        first, second = float(before.confidence[start + points].mean()), float(after.confidence[points].mean())
        if first >= second:
            renamed.append((after, after.take_back(later_track, later_marker), marker, second))
            before.lower(track, marker, second)
        else:
            renamed.append((before, before.take_back(track, marker), later_marker, first))
            after.lower(later_track, later_marker, first)
    for part, points, name, confidence in renamed:  # when all are taken back: two tracklets may have exchanged their names
        part.give(points, name, confidence)


def _frames(labelling: Labelling, which: slice) -> Labelling:
    """The labels of some frames."""
    candidates = None if labelling.candidates is None else labelling.candidates[which]
    return replace(labelling, indices=labelling.indices[which], confidence=labelling.confidence[which], candidates=candidates)


def join_verdicts(verdicts: Sequence[tuple[int, Verdict]]) -> Verdict | None:
    """One verdict of all stretches: each with the number of its labels. None where there is none.

    Its kind is that of most labels, so that a stretch from which the person has gone does not decide; of those verdicts that of most labels
    counts, with the groups of exchangeable markers and the number of roughly compared pieces of all.
    """
    if not verdicts:
        return None
    weight: dict[str, int] = {}
    for labels, verdict in verdicts:
        weight[verdict.kind] = weight.get(verdict.kind, 0) + labels
    kind = max(weight, key=lambda each: (weight[each], each != FITS))
    chosen = max((each for each in verdicts if each[1].kind == kind), key=lambda each: each[0])[1]
    groups = dict.fromkeys(group for _, verdict in verdicts for group in verdict.exchangeable)
    return replace(chosen, exchangeable=tuple(groups), rough=sum(verdict.rough for _, verdict in verdicts))


class JoinedLabelling:
    """Pieces of a recording's labelling, added one after the other; and the labelling of all of it."""

    def __init__(self, names: tuple[str, ...], frames: int, stretches: int, *, compact: bool = False) -> None:
        """compact: half of the memory, without candidates."""
        self._names, self._frames, self._stretches, self._compact = names, frames, stretches, compact
        self._whole: Labelling | None = None
        self._verdicts: list[tuple[int, Verdict]] = []

    def add(self, begin: int, piece: Labelling) -> None:
        """Take in the labels of the frames from `begin` on."""
        if len(piece.indices) == self._frames and not self._compact:
            self._whole = piece  # all there is: it stays as it was labelled
            return
        if self._whole is None:
            shape = (self._frames, len(self._names))
            places = np.full(shape, NULL, dtype=np.int32 if self._compact else np.int64)
            candidates = None if self._compact else np.full(shape, NULL, dtype=np.int64)
            self._whole = Labelling(places, np.zeros(shape), self._names, candidates)
        here = np.s_[begin : begin + len(piece.indices)]
        self._whole.indices[here], self._whole.confidence[here] = piece.indices, piece.confidence
        if piece.candidates is not None and self._whole.candidates is not None:
            self._whole.candidates[here] = piece.candidates
        if piece.verdict is not None:
            self._verdicts.append((int((piece.indices >= 0).sum()), piece.verdict))

    def labelling(self) -> Labelling:
        """The labels of all frames."""
        if self._whole is None:
            raise ValueError("no piece of the recording was labelled")
        verdict = join_verdicts(self._verdicts) if self._verdicts else self._whole.verdict
        return replace(self._whole, verdict=verdict, stretches=self._stretches)


def label_long(
    label: LabelsClouds, names: Sequence[str], clouds: Clouds, rules: StretchRules | None = None, *, progress: Progress | None = None
) -> Labelling:
    """What `label` gives of these clouds; in stretches where they have more than `rules.whole` points.

    label: labels clouds as a whole, with these names of markers. A label differs from that of the whole recording only where a stretch
    alone does not show what it is. Raises what `label` raises.
    """
    parts = stretches_of(clouds.counts, clouds.rate, rules or StretchRules())
    joined = JoinedLabelling(tuple(names), len(clouds), len(parts))
    for begin, piece in label_in_stretches(label, clouds.frames, parts, progress=progress):
        joined.add(begin, piece)
    return joined.labelling()


def stretches_of(counts: NDArray[np.integer], rate: float, rules: StretchRules) -> list[slice]:
    """How to divide a recording with so many points in each frame (T,); one stretch where it is labelled at once."""
    if counts.sum() <= rules.whole:
        return [slice(0, len(counts))]
    overlap = max(2, round(rules.overlap * rate))
    usual = max(1.0, float(counts.mean()))
    return stretches(len(counts), max(round(rules.points / usual), 3 * overlap), overlap)
