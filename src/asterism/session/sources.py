"""A file in; its frames by ranges, and a labelled copy of it, out: of a recording in memory, and of one of which only the file is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from asterism import formats
from asterism.errors import NoMarkers
from asterism.formats import LabelConfidence
from asterism.formats.c3d import LabelledRanges, LabelSummary, LongRecording, ranges, read_long, write_long
from asterism.labelling import ReviewItem, review
from asterism.labelling.correction import Correction
from asterism.labelling.review_in_pieces import ReviewInPieces
from asterism.recording import NULL, Clouds, Floats, Ints, Labelling, MarkerSet, Recording, label_states
from asterism.session.names import under_names_of_set
from asterism.session.options import IGNORE, LabellingOptions

Finish = Callable[[Recording], Recording]


class FrameSource(Protocol):
    """A recording that is labelled range by range, the ranges in their order and without a gap."""

    @property
    def about(self) -> Recording:
        """A recording with everything but all frames: it shows each column that has a point somewhere."""
        ...

    @property
    def compact(self) -> bool:
        """Whether the labels are to take little memory."""
        ...

    @property
    def counts(self) -> Ints:
        """(T,) points of each frame."""
        ...

    def frames(self, which: slice) -> Recording:
        """A range of frames."""
        ...

    def clouds(self, which: slice) -> Clouds:
        """Its points."""
        ...

    def whole(self) -> _InMemory:
        """The same recording, in memory."""
        ...

    def begin(self, marker_set: MarkerSet) -> None:
        """Forget what was added."""
        ...

    def add(self, begin: int, labelling: Labelling, recording: Recording, clouds: Clouds) -> None:
        """Take in the labels of the frames from `begin` on."""
        ...

    def finish(self, labelling: Labelling, policy: str | None, by: str) -> LabelledCopy:
        """The recording under the labels of all frames."""
        ...


class LabelledCopy(Protocol):
    """A recording under its labels."""

    @property
    def clouds(self) -> Clouds:
        """The points that were labelled. Of a recording that is not in memory, as many points, which are nowhere."""
        ...

    @property
    def recording(self) -> Recording:
        """The recording under its labels."""
        ...

    def items(self) -> list[ReviewItem]:
        """What a person should check first."""
        ...

    def write(self, target: Path, program: str | None, drop_computed: bool) -> list[str]:
        """Write it; returns what the file cannot hold."""
        ...

    def corrected(self, correction: Correction, finish: Finish | None = None) -> LabelledCopy:
        """The recording under labels that a person has corrected; finish: what else is done to it before it is written."""
        ...


def open_source(path: Path, options: LabellingOptions, *, by_ranges: bool) -> FrameSource:
    """A file's recording. by_ranges: whether a long C3D file stays on the disk.

    Raises AsterismError as `asterism.read` does, and NoMarkers where no frame has a point.
    """
    source: FrameSource | None = None
    if by_ranges:
        # a file that fits into memory is read as every other one: all that can be read has this way
        long = read_long(path, options.vertical, options.settings.stretches.whole)
        source = None if long is None else _ByRanges(path, options.vertical, long)
    if source is None:
        source = _InMemory(formats.read(path, vertical=options.vertical))
    if not source.counts.any():
        raise NoMarkers(f"{path}: the recording has no points to label.")
    return source


@dataclass
class _InMemory:
    """A recording that is in memory as a whole."""

    about: Recording
    compact: bool = False

    @cached_property
    def all_clouds(self) -> Clouds:
        """Its points."""
        return self.about.clouds()

    @property
    def counts(self) -> Ints:
        return self.all_clouds.counts

    def frames(self, which: slice) -> Recording:
        return self.about if which == slice(0, len(self.about)) else self.about.frames(which)

    def clouds(self, which: slice) -> Clouds:
        return self.all_clouds if which == slice(0, len(self.about)) else self.all_clouds.frames(which)

    def whole(self) -> _InMemory:
        return self

    def begin(self, marker_set: MarkerSet) -> None:
        self._marker_set = marker_set

    def add(self, begin: int, labelling: Labelling, recording: Recording, clouds: Clouds) -> None:
        """All that a copy needs is there at the end."""

    def finish(self, labelling: Labelling, policy: str | None, by: str) -> _CopyInMemory:
        # a name that means a marker is spelled as the set does, also where the point keeps it
        named = under_names_of_set(self.about, self._marker_set, policy)
        return _CopyInMemory(named, self.all_clouds, labelling, policy != IGNORE, by)


@dataclass
class _CopyInMemory:
    """A recording in memory, under the names of the set, and its labels."""

    named: Recording
    clouds: Clouds
    labelling: Labelling
    keep_names: bool
    by: str
    correction: Correction | None = None
    finish: Finish | None = None

    @cached_property
    def recording(self) -> Recording:
        labelled = self.named.with_labelling(self.labelling, self.clouds, keep_names=self.keep_names, by=self.by)
        corrected = labelled if self.correction is None else self.correction.logged(labelled)
        return corrected if self.finish is None else self.finish(corrected)

    def items(self) -> list[ReviewItem]:
        return review(self.labelling, self.clouds)

    def write(self, target: Path, program: str | None, drop_computed: bool) -> list[str]:
        written = formats.without_computed(self.recording) if drop_computed else self.recording
        marks: Any = {"labelling": self.labelling, "clouds": self.clouds}
        if program is not None:
            return formats.write_for_program(written, program, target, **marks)
        return formats.write(target, written, **marks)

    def corrected(self, correction: Correction, finish: Finish | None = None) -> _CopyInMemory:
        return _CopyInMemory(self.named, self.clouds, correction.labelling, self.keep_names, self.by, correction, finish)


class _ByRanges:
    """A long C3D recording, of which only the file is in memory."""

    compact = True

    def __init__(self, path: Path, vertical: ArrayLike | str | None, long: LongRecording) -> None:
        self.path, self.vertical, self.long = path, vertical, long
        self.counts, self._shown = long.shown()

    @cached_property
    def about(self) -> Recording:
        return self.long.one_frame(self._shown)

    def frames(self, which: slice) -> Recording:
        return self.long.frames(which)

    def clouds(self, which: slice) -> Clouds:
        return self.long.frames(which).clouds()

    def whole(self) -> _InMemory:
        return _InMemory(formats.read(self.path, vertical=self.vertical))

    def begin(self, marker_set: MarkerSet) -> None:
        # (M, points of the file) how many samples of each marker came from each of them
        self._origins = np.zeros((len(marker_set), self.long.file.layout.points), dtype=np.int64)
        self._rest = set[int]()
        self._review = ReviewInPieces(marker_set.names)
        self._marker_set = marker_set

    def add(self, begin: int, labelling: Labelling, recording: Recording, clouds: Clouds) -> None:
        markers = len(self._marker_set)
        origin = recording.with_labelling(labelling, clouds).origin
        if origin is not None:
            frame, marker = np.nonzero(origin[:, :markers] >= 0)
            np.add.at(self._origins, (marker, origin[frame, marker]), 1)
            self._rest |= set(origin[:, markers:].max(axis=0, initial=NULL).tolist())
        self._review.add(labelling, clouds)

    def finish(self, labelling: Labelling, policy: str | None, by: str) -> _CopyByRanges:
        # all that is said of a copy counts points; where they are takes memory, and nobody asks
        counted = _counted(self.counts, self.about)
        return _CopyByRanges(self.long, self._labelled(labelling, counted, policy, by), counted, self._review.items())

    def _labelled(self, labelling: Labelling, counted: Clouds, policy: str | None, by: str) -> LabelledRanges:
        """The recording under its labels: what `Recording.with_labelling` gives for all of it."""
        long, marker_set, rest = self.long, self._marker_set, sorted(self._rest - {NULL})
        # a frame without any label has the columns that every frame of the copy has
        blank = Labelling(np.full((1, len(marker_set)), NULL), np.zeros((1, len(marker_set))), marker_set.names)
        left = under_names_of_set(long.one_frame(np.isin(long.columns, rest)), marker_set, policy)
        head = left.with_labelling(blank, keep_names=policy != IGNORE, by=by)
        # the file has one description per point: that of the column which most samples came from
        main = [int(counts.argmax()) if counts.any() else NULL for counts in self._origins] + rest

        def frames(some: slice) -> tuple[Recording, Floats]:
            here = replace(labelling, indices=labelling.indices[some], confidence=labelling.confidence[some])
            part = long.frames(some).with_labelling(here)
            origin = np.full((len(part), len(main)), NULL, dtype=np.int64)
            positions = np.full((*origin.shape, 3), np.nan)
            columns = np.arange(len(marker_set))
            if part.origin is not None:
                # samples without a label keep the column of the file that they came from
                left_over = np.searchsorted(rest, part.origin[:, len(columns) :].max(axis=0, initial=NULL))
                columns = np.concatenate([columns, len(columns) + left_over])
                positions[:, columns], origin[:, columns] = part.positions, part.origin
            return replace(head, positions=positions, origin=origin), LabelConfidence.of_labelling(here).values

        return LabelledRanges(head, main, frames, marker_set.names, _summary(labelling, counted))


@dataclass
class _CopyByRanges:
    """A long C3D recording under its labels, written by ranges of frames."""

    long: LongRecording
    labelled: LabelledRanges
    clouds: Clouds
    found: list[ReviewItem]

    @property
    def recording(self) -> Recording:
        return self.labelled.frames(slice(None))[0]

    def items(self) -> list[ReviewItem]:
        return self.found

    def write(self, target: Path, program: str | None, drop_computed: bool) -> list[str]:
        if program is not None:
            raise ValueError("a recording for another program is written as a whole; label it in memory")
        labelled = self.labelled
        if drop_computed:
            # the head alone says which columns are written: no range of frames need be touched
            labelled = replace(labelled, head=formats.without_computed(labelled.head))
        return write_long(target, self.long.file, labelled)

    def corrected(self, correction: Correction, finish: Finish | None = None) -> _CopyByRanges:
        raise ValueError("a recording is corrected in memory; label it so")


def _counted(counts: Ints, recording: Recording) -> Clouds:
    """Clouds of so many points in each frame (T,), all at the origin."""
    offsets = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    nowhere = np.broadcast_to(np.zeros(3), (int(offsets[-1]), 3))
    return Clouds(nowhere, offsets, recording.rate, recording.vertical, np.broadcast_to(np.int64(NULL), len(nowhere)))


def _summary(labelling: Labelling, counted: Clouds) -> LabelSummary:
    """What the labels amount to, added up range by range."""
    summary = None
    for some in ranges(len(counted)):
        here = replace(labelling, indices=labelling.indices[some], confidence=labelling.confidence[some])
        part = LabelSummary.of(LabelConfidence.of_labelling(here), label_states(here, counted.frames(some)))
        summary = part if summary is None else summary.plus(part)
    if summary is None:
        raise ValueError("a recording without frames has no labels to sum up")
    return summary
