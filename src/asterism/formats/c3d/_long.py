"""C3D recordings that are too long to be in memory as positions: a file in, ranges of its frames out; a labelled copy written by ranges."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from asterism.errors import AsterismError, guarded_reading
from asterism.files.atomic import write_atomically
from asterism.formats._columns import recording_of
from asterism.formats._vertical import SAMPLED_FRAMES
from asterism.formats.c3d._assemble import assembled, tail_of
from asterism.formats.c3d._confidence import Channels, LabelSummary
from asterism.formats.c3d._file import KEY, C3DFile, open_c3d, ranges
from asterism.formats.c3d._layout import BLOCK, Layout, header_of
from asterism.formats.c3d._parameters import parse_parameters
from asterism.formats.c3d._reader import points_of, scaled
from asterism.formats.c3d._writer import Filling, RewritePlan, planned, renamed_computed
from asterism.recording import Floats, Ints, Recording, as_vertical


@dataclass(frozen=True)
class LongRecording:
    """A recording of which only its file is in memory.

    file     the file
    sampled  the recording as `read` gives it, with some of its frames only, evenly spread
    """

    file: C3DFile
    sampled: Recording

    def __len__(self) -> int:
        return self.file.layout.frames

    @cached_property
    def columns(self) -> Ints:
        """(M,) the point column of the file of each label."""
        return np.array(self.sampled.taken, dtype=np.int64)

    def frames(self, which: slice) -> Recording:
        """A range of frames, without events and the file: `read(...).frames(which)`, with the origin of each sample."""
        start = which.indices(len(self))[0]
        values = self.file.coordinates_of(which)
        positions = scaled(values, float(self.sampled.metadata["metres_per_unit"]))[:, self.columns]
        origin = np.where(np.isnan(positions[:, :, 0]), -1, self.columns)
        first = self.sampled.first_frame + start
        # The source stays out: a range of frames must not be written as the whole file.
        return replace(self.sampled, positions=positions, origin=origin, first_frame=first, events=(), source=None, taken=())

    def shown(self) -> tuple[Ints, NDArray[np.bool_]]:
        """How many points each frame has (T,), and which columns have a point in some frame (M,)."""
        counts, some = np.empty(len(self), dtype=np.int64), np.zeros(len(self.columns), dtype=np.bool_)
        # Range by range, since the whole does not fit into memory.
        for part in ranges(len(self)):
            visible = self.frames(part).visible
            counts[part] = visible.sum(axis=1)
            some |= visible.any(axis=0)
        return counts, some

    def one_frame(self, shown: NDArray[np.bool_]) -> Recording:
        """A recording of one frame that shows these columns (M,), with everything else that this one has."""
        # Zeros stand for "there": only which columns are seen counts.
        positions = np.where(shown[None, :, None], 0.0, np.full((1, 1, 3), np.nan))
        return replace(self.sampled, positions=positions, origin=np.where(shown, self.columns, -1)[None, :])


@dataclass(frozen=True)
class LabelledRanges:
    """A labelled recording of which only ranges of frames are in memory.

    head     a recording of one frame with its labels, events, log and file
    main     the point column of the file that most samples of each label came from, -1 for none
    frames   gives a range of frames: a recording with the labels of `head`, and the confidence of its names (frames, M)
    names    (M,) the labels that were given
    summary  what they amount to
    """

    head: Recording
    main: Sequence[int]
    frames: Callable[[slice], tuple[Recording, Floats]]
    names: tuple[str, ...]
    summary: LabelSummary


def read_long(path: Path, vertical: ArrayLike | str | None, points: int) -> LongRecording | None:
    """The recording of a C3D file with more points than given in all frames together; None of a smaller one.

    None, too, of a file with something behind its data, which only `write_c3d` keeps. Memory for the file. Raises AsterismError as
    `read_c3d` does.
    """
    if not _may_be_long(path, points):
        return None
    with guarded_reading(path):
        file = open_c3d(path)
        # Something behind the data must be kept, which writing by ranges does not.
        behind = bytes(file.raw[file.layout.stop :])
        if file.layout.frames * file.layout.points <= points or len(behind) > BLOCK or behind.strip(b"\0"):
            return None
        some = slice(None, None, max(1, file.layout.frames // SAMPLED_FRAMES))
        up = None if vertical is None else as_vertical(vertical)
        return LongRecording(file, recording_of(path, points_of(file, some), None, up, source=file))


def _may_be_long(path: Path, points: int) -> bool:
    """Whether a file's name, size and first bytes are those of a C3D file with so many points: each has 8 bytes at least."""
    if path.suffix.casefold() != ".c3d" or not path.is_file() or path.stat().st_size < 8 * points:
        return False
    with guarded_reading(path), path.open("rb") as stream:
        return stream.read(2)[1:] == bytes([KEY])


def write_long(path: Path, file: C3DFile, labelled: LabelledRanges) -> list[str]:
    """Write what `write_c3d` writes for the whole recording with the confidence of its labels, some frames at a time.

    Returns what the file cannot hold. Raises AsterismError as `write_c3d` does; a file at `path` is replaced completely or not at all.
    """
    plan = planned(file, labelled.head, labelled.main, str(path))
    # Parameters alone, as if the file had no data: those are written range by range.
    empty = replace(file, raw=file.raw[: file.layout.start], layout=replace(file.layout, frames=0))
    head, _ = assembled(empty, plan.parameters, 0, len(plan.slots), plan.rate)
    relabelled = _without_data(replace(empty, path=str(path)), head, len(plan.slots))
    renamed = renamed_computed(relabelled, file)
    lost = [f"the label of the computed point {label}, which a marker has now; the point is {label}_computed" for label in renamed]
    channels = None
    try:
        channels = Channels.of(relabelled, labelled.names, labelled.summary)
        head, _ = assembled(relabelled, channels.parameters, 0, len(plan.slots), None)
        channels.write_header(head, relabelled)
    except AsterismError as problem:
        lost.append(f"the confidence of the labels, because {str(problem).rstrip('.')}")
    write_atomically(path, _parts(head, file, relabelled, plan, channels, labelled))
    return lost


def _without_data(like: C3DFile, raw: bytearray, points: int) -> C3DFile:
    """A file of these bytes, which end where its data would begin, with so many points."""
    start, processor = like.header.parameters_at, like.processor
    layout = Layout(len(raw), 0, points, like.layout.analog, like.layout.real)
    parameters = parse_parameters(bytes(raw[start:]), processor)
    return replace(like, raw=raw, header=header_of(raw, processor, start), parameters=parameters, layout=layout)


def _parts(
    head: bytearray, file: C3DFile, relabelled: C3DFile, plan: RewritePlan, channels: Channels | None, labelled: LabelledRanges
) -> Iterator[bytes | bytearray]:
    """The new file, piece by piece."""
    yield head
    points, kind = 4 * len(plan.slots), file.point_words.dtype.newbyteorder(file.processor.order)
    width = points + (file.layout.analog if channels is None else channels.width)
    filling = Filling.of(file, plan.slots, labelled.head.labels, relabelled.path)
    for some in ranges(file.layout.frames):
        recording, confidence = labelled.frames(some)
        words = np.empty((len(recording), width), dtype=kind)
        origin = np.full(recording.positions.shape[:2], -1, dtype=np.int64) if recording.origin is None else recording.origin
        filling.fill(words, some, recording.positions, origin)
        analog = file.words[some, 4 * file.layout.points :]
        words[:, points:] = analog if channels is None else channels.words(relabelled, analog, confidence)
        yield words.tobytes()
    # What follows the data moves with their new length.
    yield tail_of(file, file.layout.frames * (width - file.layout.width) * kind.itemsize)[0]
