"""Write recordings as C3D: a recording and a path in, a file out.

A recording that was read from C3D is written into a copy of that file. The columns that it replaces are written sample by sample, with
the bits that they came from; everything else in the file stays. Any other recording gets a new file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from asterism.errors import AsterismError
from asterism.files.atomic import write_atomically
from asterism.formats._columns import without_common_subject
from asterism.formats._confidence import LabelConfidence
from asterism.formats._physical import is_unnamed
from asterism.formats.c3d._assemble import assembled
from asterism.formats.c3d._confidence import with_confidence
from asterism.formats.c3d._edit import label_parameters, log_of, with_declared, with_events, with_log, with_number
from asterism.formats.c3d._file import C3DFile, parse_c3d, ranges
from asterism.formats.c3d._fresh import fresh_c3d, residual_steps
from asterism.formats.c3d._layout import LIMIT
from asterism.formats.c3d._numbers import Words
from asterism.formats.c3d._parameters import Parameters, Record
from asterism.formats.c3d._reader import in_metres, scaled, unit_of
from asterism.formats.c3d.analog import AnalogChannel, with_analog
from asterism.recording import Floats, Ints, LabelStates, Recording, filled_samples

COMPUTED_ENDING = b"_computed"
"""What follows the label of a computed point where a marker of the recording has the same label."""


def write_c3d(
    path: Path,
    recording: Recording,
    confidence: LabelConfidence | None = None,
    states: LabelStates | None = None,
    analog: Sequence[AnalogChannel] = (),
) -> list[str]:
    """Write a recording as C3D; a file at `path` is replaced completely or not at all.

    The confidence of labels goes into analog channels and the group ASTERISM; states: what became of the markers; analog: channels of a new
    file, see `with_analog`.

    Where the recording was read from C3D, every unchanged sample (`origin`) is copied bit by bit with its residual
    and cameras, new samples get residual 0 (filled ones below), missing ones are written as the file writes missing points; points that
    the recording does not replace (`taken`), analog data, parameters, byte order and number format stay. An unchanged recording gives
    the file byte for byte.

    Samples that the processing log calls filled have residual 0 where no measured sample of the file has; else their residual is their
    standard deviation, at least one step, without cameras.

    Returns what the file cannot hold: the confidence, where it has no room for the channels.
    Raises AsterismError where the recording does not fit its source (other frames, a label twice), a coordinate does not fit the
    file's integers, or the file cannot be written.
    """
    if not recording.labels or not len(recording):
        what = "no points" if not recording.labels else "no frames"
        raise AsterismError(f"{path}: the recording has {what}, and a C3D file needs both; nothing was written.")
    of_c3d = isinstance(recording.source, C3DFile)
    data = rewritten(recording.source, recording, str(path)) if of_c3d else fresh_c3d(recording, str(path))
    lost = []
    if analog:
        data = with_analog(parse_c3d(data, str(path)), analog)
    # Computed points give way to a marker's label, which the person must know.
    if isinstance(recording.source, C3DFile):
        renamed = renamed_computed(parse_c3d(data, str(path)), recording.source)
        lost += [f"the label of the computed point {label}, which a marker has now; the point is {label}_computed" for label in renamed]
    # Confidence comes last: the file is whole without it.
    if confidence is not None and states is not None:
        try:
            data = with_confidence(parse_c3d(data, str(path)), confidence, states)
        except AsterismError as problem:
            lost.append(f"the confidence of the labels, because {str(problem).rstrip('.')}")
    write_atomically(path, data)
    return lost


def write_c3d_points(path: Path, recording: Recording, residual: Floats, cameras: NDArray[np.bool_]) -> None:
    """Write a new C3D file whose points have residuals and the cameras that saw them.

    residual (T, M) m, cameras (T, M, C). Raises AsterismError as `write_c3d` does.
    """
    if not recording.labels or not len(recording):
        raise AsterismError(
            f"{path}: the recording has no {'points' if len(recording) else 'frames'}, and a C3D file needs both; nothing was written."
        )
    write_atomically(path, fresh_c3d(recording, str(path), residual, cameras))


@dataclass(frozen=True)
class _Slot:
    """A point column of the new file: the old column in its place (None: new), and the recording's column (None: the old one stays)."""

    place: int | None
    column: int | None


@dataclass(frozen=True)
class RewritePlan:
    """How a recording is written into a copy of its file.

    slots       the point columns of the new file
    parameters  of the new file
    rate        frames per second, None where it stays
    """

    slots: list[_Slot]
    parameters: Parameters
    rate: float | None


def rewritten(file: C3DFile, recording: Recording, target: str) -> bytearray:
    """The bytes of `file`, with the columns of `recording` in place of those that it replaces."""
    # Analog data belong to the frames that were read.
    if len(recording) != file.layout.frames:
        raise AsterismError(
            f"{target}: the recording has {len(recording)} frames, the file that it was read from {file.layout.frames}; "
            "cut recordings with `frames()`, which drops the file."
        )
    origin = recording.origin
    # Without an origin every sample is new.
    if origin is None or origin.shape != recording.positions.shape[:2]:
        origin = np.full(recording.positions.shape[:2], -1, dtype=np.int64)
    points = file.layout.points
    plan = planned(file, recording, [_commonest(column[(column >= 0) & (column < points)]) for column in origin.T], target)
    data, words = assembled(file, plan.parameters, 4 * len(plan.slots) + file.layout.analog, len(plan.slots), plan.rate)
    filling, residuals = Filling.of(file, plan.slots, recording.labels, target), _residuals(file, recording)
    for some in ranges(file.layout.frames):
        filling.fill(words[some], some, recording.positions[some], origin[some], residuals[some])
        words[some, 4 * len(plan.slots) :] = file.words[some, 4 * points :]
    return data


def planned(file: C3DFile, recording: Recording, main: Sequence[int], target: str) -> RewritePlan:
    """How a recording is written; main: the place in the file that most samples of each column came from, -1 for none.

    Of the recording only labels, events, log, rate and `taken` are looked at.
    """
    seen = without_common_subject(file.labels)[0]
    slots = _slots(seen, recording, main, file.layout.points)
    if len(slots) > LIMIT:
        raise AsterismError(f"{target}: {len(slots)} points are more than the {LIMIT} that a C3D file can hold; write fewer columns.")
    renamed = _renamed_computed(file, seen, recording, slots)
    labels = _labels(file, seen, recording, slots, renamed, target)
    # Columns that stay in their places with their labels leave the parameters untouched.
    same_columns = [slot.place for slot in slots] == list(range(file.layout.points)) and labels == file.raw_labels
    parameters = file.parameters
    if not same_columns:
        descriptions = [
            file.descriptions[slot.place] if slot.place is not None and label == file.raw_labels[slot.place] else b""
            for slot, label in zip(slots, labels, strict=True)
        ]
        parameters = parameters.replaced(label_parameters(file, labels, descriptions))
        # Lists of angles and forces name points by their labels.
        read = file.parameters.text_of
        gone = {read(raw) for raw in file.raw_labels} - {read(raw) for raw in labels}
        parameters = with_declared(parameters, gone, {read(file.raw_labels[place]): read(raw) for place, raw in renamed.items()})
    if recording.events != file.events:
        parameters = with_events(parameters, recording.events)
    # Readers that see this group count no more frames than 16 bits do; without rotations it says nothing.
    if parameters is not file.parameters and file.layout.frames >= LIMIT and file.parameters.count("ROTATION", "USED") == 0:
        parameters = parameters.without("ROTATION")
    if recording.log != log_of(file.parameters):
        parameters = with_log(parameters, recording.log)
    rate = recording.rate if recording.rate != file.rate else None
    # The analog rate follows, since samples per frame stay.
    if rate is not None:
        parameters = _with_rate(parameters, rate / file.rate)
    return RewritePlan(slots, parameters, rate)


def _slots(seen: Sequence[str], recording: Recording, main: Sequence[int], points: int) -> list[_Slot]:
    """The columns of the new file, each with the place of the old one by its label or by its samples' origin."""
    free = {place for place in recording.taken if 0 <= place < points}
    place_of: dict[int, int] = {}
    by_label: dict[str, list[int]] = {}
    for place in sorted(free):
        by_label.setdefault(seen[place], []).append(place)

    def take(column: int, place: int) -> None:
        place_of[column] = place
        free.discard(place)

    # A column goes first to the place of its samples if that has its label,
    for column, label in enumerate(recording.labels):
        if main[column] in free and seen[main[column]] == label:
            take(column, main[column])
    # then to a place with its label,
    for column, label in enumerate(recording.labels):
        same = [place for place in by_label.get(label, ()) if place in free]
        if column not in place_of and same:
            take(column, same[0])
    # then to the place of its samples, whatever the label,
    for column in range(len(recording.labels)):
        if column not in place_of and main[column] in free:
            take(column, main[column])
    # and a column that came from nowhere to any place that is free.
    for column in range(len(recording.labels)):
        if column not in place_of and main[column] < 0 and free:
            take(column, min(free))
    column_at = {place: column for column, place in place_of.items()}
    stay = [_Slot(p, column_at.get(p)) for p in range(points) if p in column_at or p not in set(recording.taken)]
    new = [_Slot(None, column) for column in range(len(recording.labels)) if column not in place_of]
    named = {column for column, label in enumerate(recording.labels) if not is_unnamed(label)}
    if not any(is_unnamed(seen[place_of[column]]) if column in place_of else main[column] >= 0 for column in named):
        return stay + new
    # Where points got names: markers in the recording's order, which is that of their set, and points without a name last.
    own = sorted((slot for slot in [*stay, *new] if slot.column is not None), key=lambda slot: (slot.column not in named, slot.column))
    middle = [slot for slot in stay if slot.column is None]
    return [*own[: len(named)], *middle, *own[len(named) :]]


def _commonest(places: Ints) -> int:
    return int(np.bincount(places).argmax()) if len(places) else -1


@dataclass(frozen=True)
class Filling:
    """Writes the points of a new data block, some frames at a time.

    file     the file that the recording was read from
    slots    the point columns of the new one
    labels   of the recording's columns
    scale    metres per unit
    missing  the four words of a missing point
    target   the name of the new file, for messages
    """

    file: C3DFile
    slots: Sequence[_Slot]
    labels: Sequence[str]
    scale: float
    missing: Words
    target: str

    @classmethod
    def of(cls, file: C3DFile, slots: Sequence[_Slot], labels: Sequence[str], target: str) -> Filling:
        """With the unit of the file, and its words for missing points."""
        return cls(file, slots, labels, unit_of(file)[0], missing_words(file), target)

    def fill(self, out: Words, some: slice, positions: Floats, origin: Ints, residuals: Floats | None = None) -> None:
        """Write the points of some frames of the file, (frames, width) words in the file's byte order.

        positions (frames, columns, 3) m; origin (frames, columns): the file's point column that each sample came from, -1 for none;
        residuals (frames, columns) steps of new samples, None for 0.
        """
        residuals = np.zeros(origin.shape) if residuals is None else residuals
        file = self.file
        before = scaled(file.coordinates_of(some), self.scale)
        points, frames = file.point_words[some], np.arange(len(before))
        for new, slot in enumerate(self.slots):
            column = np.s_[:, 4 * new : 4 * new + 4]
            # Points that the recording does not replace keep their bits.
            if slot.column is None:
                out[column] = points[:, slot.place]
                continue
            new_positions = positions[:, slot.column]
            words = np.empty((len(frames), 4), dtype=points.dtype)
            done = np.zeros(len(frames), dtype=bool)
            # A sample is copied from where it came from, else from the column's own place.
            sources = [origin[:, slot.column]] + ([np.full(len(frames), slot.place)] if slot.place is not None else [])
            for source in sources:
                known = (source >= 0) & (source < file.layout.points)
                source = np.where(known, source, 0)
                old = before[frames, source]
                # Bits are copied only where nothing changed, so that residual and cameras stay right.
                same = ((old == new_positions) | (np.isnan(old) & np.isnan(new_positions))).all(axis=1) & known & ~done
                words[same] = points[frames[same], source[same]]
                done |= same
            gone = ~done & np.isnan(new_positions[:, 0])
            words[gone] = self.missing
            fresh = ~done & ~gone
            words[fresh] = _encoded(
                file, new_positions[fresh], residuals[fresh, slot.column], self.scale, self.labels[slot.column], self.target
            )
            out[column] = words


def missing_words(file: C3DFile) -> Words:
    """The four words with which this file says that a point is missing."""
    # Files have their own way to say that a point is missing: the new ones must be said in it.
    some_missing = any(np.isnan(file.coordinates_of(some)).any() for some in ranges(file.layout.frames))
    if file.zeros_are_missing and some_missing and not file.residuals_are_unused:
        return np.zeros(4, dtype=file.point_words.dtype)
    if file.layout.real:
        return file.processor.words_of_floats([0.0, 0.0, 0.0, -1.0])
    return file.processor.words_of_integers([0, 0, 0, -1])


def _residuals(file: C3DFile, recording: Recording) -> Floats:
    """(T, M) steps of the residual with which new samples are written.

    By the format's custom a sample that was interpolated has the residual 0. Where a measured sample has that, too, as after filters, a
    filled one has its standard deviation, and no camera.
    """
    deviation = filled_samples(recording)
    if not np.isfinite(deviation).any():
        return np.zeros(deviation.shape)
    measured = any(
        (np.isfinite(file.coordinates_of(some)[..., 0]) & (file.residuals_of(some) == 0)).any() for some in ranges(file.layout.frames)
    )
    return residual_steps(deviation / (abs(file.scale) * unit_of(file)[0])) if measured else np.zeros(deviation.shape)


def _encoded(file: C3DFile, positions: Floats, residuals: Floats, scale: float, label: str, target: str) -> Words:
    """(N, 4) words of new samples, (N, 3) m; residuals (N,) steps."""
    raw = positions * round(1 / scale) if scale < 1 and scale == 1 / round(1 / scale) else positions / scale
    # Where all residuals are negative, a 0 would stand out as the only measured point.
    residual = np.full((len(raw), 1), -1.0) if file.residuals_are_unused else residuals[:, None]
    if file.layout.real:
        return file.processor.words_of_floats(np.concatenate([raw, residual], axis=1))
    steps = np.rint(raw / file.scale)
    if (np.abs(steps) > 32767).any():
        raise AsterismError(
            f"{target}: {label} lies {np.abs(positions).max():.2f} m from the origin, further than the integers of this file reach "
            f"({32767 * file.scale * scale:.2f} m); move it there or write another format."
        )
    return file.processor.words_of_integers(np.concatenate([steps, residual], axis=1).astype(np.int16))


def renamed_computed(after: C3DFile, before: C3DFile) -> list[str]:
    """The labels of computed points that writing changed."""
    ending = COMPUTED_ENDING.decode()
    return [label.removesuffix(ending) for label in after.labels if label.endswith(ending) and label not in before.labels]


def _renamed_computed(file: C3DFile, seen: Sequence[str], recording: Recording, slots: Sequence[_Slot]) -> dict[int, bytes]:
    """New labels for the computed points of the file, by place, whose own is that of a marker of the recording."""
    from asterism.formats._physical import COMPUTED
    from asterism.formats.c3d._reader import kinds_of_points

    wanted = {label.casefold() for label in recording.labels}
    clashes = [slot.place for slot in slots if slot.column is None and slot.place is not None and seen[slot.place].casefold() in wanted]
    if not clashes:
        return {}
    kinds = kinds_of_points(file, in_metres(file)[0])
    return {place: file.labels[place].encode("utf-8") + COMPUTED_ENDING for place in clashes if kinds[place] == COMPUTED}


def _labels(
    file: C3DFile, seen: Sequence[str], recording: Recording, slots: Sequence[_Slot], renamed: Mapping[int, bytes], target: str
) -> list[bytes]:
    """The labels of the new file as bytes: old ones untouched, new ones with the file's subject prefix, unnamed ones unique."""
    # The subject's prefix was taken off when reading, and belongs into the file.
    prefix = next((full[: -len(short)] for full, short in zip(file.labels, seen, strict=True) if full != short), "")
    kept = {seen[slot.place].casefold() for slot in slots if slot.column is None and slot.place is not None and slot.place not in renamed}
    wanted = {label.casefold() for label in recording.labels}
    labels, number = [], 0
    for slot in slots:
        label = "" if slot.column is None else recording.labels[slot.column]
        if slot.place is not None and (slot.column is None or seen[slot.place] == label):
            labels.append(renamed.get(slot.place, file.raw_labels[slot.place]))
            continue
        # A name without meaning is counted on until it is free.
        if is_unnamed(label):
            while label.casefold() in kept:
                number += 1
                label = f"*{number}" if f"*{number}".casefold() not in wanted else label
            kept.add(label.casefold())
        elif label.casefold() in kept:
            raise AsterismError(
                f"{target}: {label} would occur twice, as a marker and as a point of the file that was not read; "
                "read the file with a marker set that has it, or rename it."
            )
        # The names of several people say whose they are.
        labels.append((label if is_unnamed(label) or ":" in label else prefix + label).encode("utf-8"))
    return labels


def _with_rate(parameters: Parameters, factor: float) -> Parameters:
    changes: dict[tuple[str, str], Record | None] = {}
    for group in ("POINT", "ANALOG"):
        old = parameters.number(group, "RATE")
        if old is not None:
            changes[group, "RATE"] = with_number(parameters, group, "RATE", old * factor)
    return parameters.replaced(changes)
