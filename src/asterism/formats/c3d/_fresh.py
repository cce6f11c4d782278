"""A new C3D file from a recording that was not read from one: bytes out, little-endian, real numbers, millimetres."""

from __future__ import annotations

from dataclasses import replace
from importlib.metadata import PackageNotFoundError, version

import numpy as np
from numpy.typing import NDArray

from asterism.errors import AsterismError
from asterism.formats.c3d._edit import LOG_GROUP, MOST_STRINGS, event_records, floats_record, integers_record, log_record, strings_record
from asterism.formats.c3d._file import ranges
from asterism.formats.c3d._layout import BLOCK, LIMIT
from asterism.formats.c3d._numbers import PC
from asterism.formats.c3d._parameters import CHARACTER, Record, make_group, make_parameter
from asterism.recording import Floats, Recording, filled_samples

_POINT, _ANALOG, _FORCE_PLATFORM, _TRIAL, _EVENT, _SUBJECTS, _MANUFACTURER, _LOG = range(1, 9)
_SCREENS = {"x": "+Y", "y": "+X", "z": "+X"}


_RESIDUAL_STEP = 0.01
_MASKED_CAMERAS = 7


def fresh_c3d(recording: Recording, target: str, residual: Floats | None = None, cameras: NDArray[np.bool_] | None = None) -> bytearray:
    """The bytes of a new file: positions in mm, missing points with residual -1, labels, rate, vertical, events, subject.

    residual (T, M) m and cameras (T, M, C) go into the fourth word of each point, as far as it reaches: 2.55 mm, seven cameras.

    Raises AsterismError where the recording does not fit: more than 65535 points, or a label beyond 127 bytes.
    """
    frames, points = recording.positions.shape[:2]
    if points > LIMIT:
        raise AsterismError(f"{target}: {points} points are more than the {LIMIT} that a C3D file can hold; write fewer columns.")
    # Frame numbers are 32 bits; where they do not fit, the file begins at 1.
    first = recording.first_frame if recording.first_frame >= 1 and recording.first_frame + frames - 1 < 2**31 else 1
    step = 1.0 if residual is None else _RESIDUAL_STEP
    try:
        section = _section(recording, first, step)
    except AsterismError as problem:
        raise AsterismError(f"{target}: {problem}") from problem
    head, size = _header(recording, first, len(section) // BLOCK + 2, step) + section, 16 * frames * points
    ending = 0 if frames >= LIMIT else -size % BLOCK  # readers take bytes behind uncounted frames for frames
    out = bytearray(len(head) + size + ending)
    out[: len(head)] = head
    # Measured samples have the residual 0 here, so that filled ones have their standard deviation in mm.
    filled = 1000.0 * filled_samples(recording) if residual is None and recording.log else None
    block = np.frombuffer(out, dtype=f"{PC.order}u4", count=size // 4, offset=len(head)).reshape(frames, points, 4)
    for some in ranges(frames):
        positions = recording.positions[some]
        data = np.zeros((len(positions), points, 4))
        data[:, :, :3] = positions * 1000.0
        if residual is not None and cameras is not None:
            data[:, :, 3] = _fourth_word(residual[some], cameras[some])
        elif filled is not None:
            data[:, :, 3] = residual_steps(filled[some])
        # The convention of the format: all zero, with a residual of -1.
        data[np.isnan(positions[:, :, 0])] = (0.0, 0.0, 0.0, -1.0)
        block[some] = PC.words_of_floats(data)
    return out


def residual_steps(deviation: Floats) -> Floats:
    """Residuals of filled samples in whole steps, of standard deviations in steps: at least one, at most what a byte holds; 0 for NaN."""
    return np.where(np.isnan(deviation), 0.0, np.clip(np.round(np.nan_to_num(deviation)), 1.0, 255.0))


def _fourth_word(residual: Floats, cameras: NDArray[np.bool_]) -> Floats:
    """High byte: a bit for each of the first seven cameras; low byte: the residual in steps of |POINT:SCALE| mm."""
    # A larger residual is shown as the largest that a byte holds.
    steps = np.clip(np.round(np.nan_to_num(residual) * 1000.0 / _RESIDUAL_STEP), 0, 255)
    seven = cameras[:, :, :_MASKED_CAMERAS]
    word: Floats = steps + 256.0 * (seven @ 2.0 ** np.arange(seven.shape[2]))
    return word


def _header(recording: Recording, first: int, data_start: int, step: float) -> bytes:
    frames, points = recording.positions.shape[:2]
    last = first + frames - 1
    words = np.zeros(BLOCK // 2, dtype=np.uint16)
    words[0] = 0x5002
    words[1] = points
    # With more frames than 16 bits count, the header says how many it can.
    words[3:5] = (first, last) if last <= LIMIT else (1, min(frames, LIMIT))
    words[8] = data_start
    head = bytearray(PC.store(words))
    head[12:16] = PC.store(PC.words_of_floats([-step]))
    head[20:24] = PC.store(PC.words_of_floats([recording.rate]))
    return bytes(head)


def _section(recording: Recording, first: int, step: float) -> bytes:
    """The parameter section in whole blocks. It states where the data begin, so it is laid out twice."""
    # Its own length moves the data, whose place it states: a first layout gives the length.
    blocks = -(-len(_chain(recording, first, 0, step)) // BLOCK)
    section = _chain(recording, first, blocks + 2, step)
    return (section[:2] + bytes([min(blocks, 255)]) + section[3:]).ljust(blocks * BLOCK, b"\0")


def _chain(recording: Recording, first: int, data_start: int, step: float) -> bytes:
    frames, points = recording.positions.shape[:2]
    last = first + frames - 1
    records = [_group("POINT", _POINT), _integer("USED", _POINT, points), _integer("FRAMES", _POINT, min(frames, LIMIT))]
    records += [_integer("DATA_START", _POINT, data_start), _float("SCALE", _POINT, -step), _float("RATE", _POINT, recording.rate)]
    # A float holds what the 16-bit count cannot.
    if frames > LIMIT:
        records.append(_float("LONG_FRAMES", _POINT, frames))
    records += [_text("UNITS", _POINT, "mm"), *_screens(recording.vertical)]
    for page, at in enumerate(range(0, points, MOST_STRINGS)):
        number = str(page + 1) if page else ""
        labels = [label.encode("utf-8") for label in recording.labels[at : at + MOST_STRINGS]]
        records.append(strings_record("LABELS" + number, _POINT, labels, 4, PC))
        records.append(strings_record("DESCRIPTIONS" + number, _POINT, [b""] * len(labels), 4, PC))
    records += [_group("ANALOG", _ANALOG), _integer("USED", _ANALOG, 0), _float("RATE", _ANALOG, 0.0), _float("GEN_SCALE", _ANALOG, 1.0)]
    records += [_group("FORCE_PLATFORM", _FORCE_PLATFORM), _integer("USED", _FORCE_PLATFORM, 0)]
    records += [
        _group("TRIAL", _TRIAL),
        integers_record("ACTUAL_START_FIELD", _TRIAL, [first % 65536, first // 65536], (2,), PC),
        integers_record("ACTUAL_END_FIELD", _TRIAL, [last % 65536, last // 65536], (2,), PC),
        _float("CAMERA_RATE", _TRIAL, recording.rate),
    ]
    subject = str(recording.metadata.get("subject") or "")
    if recording.events:
        # The clock of the new file counts from its frame 1, whatever time the old one gave its first frame.
        later = (first - 1) / recording.rate - float(recording.times[0])
        events = [replace(event, time=event.time + later) for event in recording.events]
        records += [_group("EVENT", _EVENT), *event_records(events, _EVENT, PC, subject)]
    if subject:
        records += [_group("SUBJECTS", _SUBJECTS), _integer("USED", _SUBJECTS, 1), _integer("USES_PREFIXES", _SUBJECTS, 0)]
        records.append(strings_record("NAMES", _SUBJECTS, [subject.encode("utf-8")], 4, PC))
    records += [_group("MANUFACTURER", _MANUFACTURER), _text("COMPANY", _MANUFACTURER, "Asterism")]
    records += [_text("SOFTWARE", _MANUFACTURER, "Asterism"), _text("VERSION_LABEL", _MANUFACTURER, _version())]
    if recording.log:
        records += [_group(LOG_GROUP, _LOG), log_record(recording.log, _LOG, PC)]
    return bytes([1, 0x50, 0, PC.code]) + b"".join(record.raw for record in records) + b"\0\0"


def _screens(vertical: Floats) -> list[Record]:
    """POINT:X_SCREEN and Y_SCREEN, the vertical being up the screen; a tilted one in full beside them."""
    axis = int(np.abs(vertical).argmax())
    letter, sign = "xyz"[axis], "-" if vertical[axis] < 0 else "+"
    records = [_text("X_SCREEN", _POINT, _SCREENS[letter]), _text("Y_SCREEN", _POINT, sign + letter.upper())]
    # A tilted vertical is no axis: it stands in full beside the nearest one.
    if np.abs(vertical[axis]) < 1.0:
        records.append(floats_record("VERTICAL", _POINT, list(vertical), (3,), PC))
    return records


def _version() -> str:
    try:
        return version("asterism")
    except PackageNotFoundError:
        return "unknown"


def _group(name: str, number: int) -> Record:
    return make_group(name, number, processor=PC)


def _integer(name: str, group: int, value: int) -> Record:
    return integers_record(name, group, [value], (), PC)


def _float(name: str, group: int, value: float) -> Record:
    return floats_record(name, group, [value], (), PC)


def _text(name: str, group: int, value: str) -> Record:
    data = value.encode("utf-8")
    return make_parameter(name, group, CHARACTER, (len(data),), data, processor=PC)
