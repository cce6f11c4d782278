"""Where the data block of a C3D file begins, and what it holds: header, parameters and the file's length in, one layout out.

Headers and parameters of real files contradict each other. What they say is treated as a set of claims. The order of evidence:

1. The length of the file, or where the next block (rotations) begins. Claims that fill it up to the last block of 512 bytes stand
   before all others, whoever makes them: the header's start of the data, then POINT:DATA_START, then the end of the parameters; the
   header's frames, then TRIAL, then POINT:LONG_FRAMES, then POINT:FRAMES. Where several fill it, zeros behind the data and points
   that move least from frame to frame decide.
2. Where none does, a count of frames that is at the limit of 16 bits, wrapped round it, or not given, counts for nothing: the
   length decides.
3. Else the claims that leave least of the file unread; a finding tells which whole frames are left over.
4. Where all of them need more than there is, the file was cut off, and holds its whole frames.

Source: the public C3D format specification.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from itertools import product

import numpy as np

from asterism.errors import AsterismError
from asterism.findings import Finding
from asterism.formats._findings import cut_off, header_conflict, header_doubt
from asterism.formats.c3d._numbers import Processor
from asterism.formats.c3d._parameters import Parameters, parse_parameters
from asterism.recording import Event
from asterism.recording.arrays import nan_median

BLOCK = 512
LIMIT = 65535
"""The most that 16 bits count."""
_LEAPING = 0.1
"""`_restlessness` of what are no points: read rightly, 113 recordings of all vendors have 0.02 at most; with a wrong width, 0.2 to 1."""
_FRAMES_COMPARED = 200
"""Frames by which it is told in which layout points move least: some seconds."""
_LABEL_KEY = 12345


@dataclass(frozen=True)
class Header:
    """The first block, with its numbers as they are, right or wrong."""

    parameters_at: int
    points: int
    analog_per_frame: int
    first_frame: int
    last_frame: int
    scale: float
    data_at: int
    analog_per_point_frame: int
    rate: float
    events: tuple[Event, ...]

    @property
    def frames(self) -> int:
        """The number of frames that first and last frame give; where the last one is wrapped round 16 bits, wrapped as well."""
        count = self.last_frame - self.first_frame + 1
        return count if count >= 0 else count + LIMIT + 1


@dataclass(frozen=True)
class Layout:
    """What the data block holds: `frames` of `points` times four words and `analog` words each, from byte `start` on.

    cut: whether the file breaks off before the frames that it declares.
    """

    start: int
    frames: int
    points: int
    analog: int
    real: bool
    cut: bool = False

    @property
    def width(self) -> int:
        """Words per frame."""
        return 4 * self.points + self.analog

    @property
    def frame_bytes(self) -> int:
        """Bytes per frame."""
        return self.width * (4 if self.real else 2)

    @property
    def stop(self) -> int:
        """The byte behind the last frame."""
        return self.start + self.frames * self.frame_bytes


def header_of(raw: bytes | bytearray, processor: Processor, parameters_at: int) -> Header:
    """The header of a file's bytes."""

    def word(number: int) -> int:
        return processor.unsigned_at(raw, 2 * number - 2)

    return Header(
        parameters_at=parameters_at,
        points=word(2),
        analog_per_frame=word(3),
        first_frame=word(4),
        last_frame=word(5),
        scale=processor.float_at(raw, 12),
        data_at=max(word(9) - 1, 0) * BLOCK,
        analog_per_point_frame=word(10),
        rate=processor.float_at(raw, 20),
        events=tuple(_events_of_header(raw, processor)),
    )


# Labels of header events are only there with this key.
def _events_of_header(raw: bytes | bytearray, processor: Processor) -> Iterator[Event]:
    if processor.unsigned_at(raw, 298) != _LABEL_KEY:
        return
    for place in range(min(processor.unsigned_at(raw, 300), 18)):
        time = processor.float_at(raw, 304 + 4 * place)
        label = raw[396 + 4 * place : 400 + 4 * place].decode("latin-1").strip("\0 ")
        if np.isfinite(time):
            yield Event(label, time)


@dataclass(frozen=True)
class _DataStart:
    """A place where the data may begin, the parameters up to there, and the claims about what the data hold.

    ends  bytes at which the data may end, the most likely first
    """

    at: int
    parameters: Parameters
    claims: tuple[Layout, ...]
    ends: tuple[int, ...]

    @cached_property
    def clean(self) -> bool:
        """Whether no parameter lies across the start, and nothing but zeros between the last one and the start."""
        return not any(record.cut for record in self.parameters.records) and not any(self.parameters.tail)


def find_layout(raw: bytes | bytearray, path: str, processor: Processor, header: Header) -> tuple[Parameters, Layout, list[Finding]]:
    """The parameters of a file, the layout of its data, and what is wrong with either.

    Raises AsterismError where the file breaks off before its first frame ends.
    """
    starts = _starts(raw, processor, header)
    findings: list[Finding] = []
    found = _that_fills(raw, processor, header, starts) or _by_length(raw, processor, header, starts)
    sure = found is not None
    if found is None:
        start = starts[0]
        found = start, _that_leaves_least(raw, path, processor, start, findings)
    start, layout = found
    if len({start.at, header.data_at or start.at, *_data_start(start.parameters)}) > 1:
        said = "".join(f", POINT:DATA_START {_block(at)}" for at in _data_start(start.parameters))
        sentence = f"the header says that data begin in block {_block(header.data_at)}{said}; block {_block(start.at)} was used"
        # Unless the data fill the file, zeros behind them, it is the header's word against that of the parameters.
        sure = sure and not any(raw[layout.stop : start.ends[0]])
        doubt = not sure and len(starts) > 1 and start.clean == starts[1].clean
        findings.append(header_doubt(sentence) if doubt else header_conflict(sentence))
    findings += _about_counts(raw, header, start, layout)
    if (findings or any(raw[layout.stop :])) and layout.points and layout.frames > 2 and _restlessness(raw, processor, layout) >= _LEAPING:
        findings.append(header_doubt("the points leap from frame to frame, as where a file has other numbers of points or analog samples"))
    return start.parameters, layout, findings


def _block(at: int) -> int:
    return at // BLOCK + 1


def _starts(raw: bytes | bytearray, processor: Processor, header: Header) -> list[_DataStart]:
    """Where the data may begin, the most reliable first: at least one place."""
    at, size = header.parameters_at, len(raw)
    counted = min(at + BLOCK * max(raw[at + 2], 1), size)

    # Header and parameters mostly name one place, whose parameters are then read once.
    @cache
    def parameters(start: int) -> Parameters:
        # Parameters end where the data begin, or where their own count says.
        return parse_parameters(bytes(raw[at : start if start > at else counted]), processor)

    places = [header.data_at, *_data_start(parameters(max(counted, min(header.data_at, size)))), counted]
    # The second block is where the parameters themselves begin, mostly; the last place is always there.
    places = [place for place in dict.fromkeys(places) if BLOCK <= place <= size and place != at]
    sections = [(place, parameters(place)) for place in places]
    starts = [_DataStart(place, own, tuple(_claims(header, own, place)), tuple(_ends(own, place, size))) for place, own in sections]
    # Data that begin in the midst of a parameter, or late, where there is something before them, are less likely, whoever says so.
    return sorted(starts, key=lambda start: not start.clean)


def _data_start(parameters: Parameters) -> list[int]:
    """The byte at which POINT:DATA_START says that the data begin; nothing where it says none."""
    block = parameters.count("POINT", "DATA_START") or 0
    return [(block - 1) * BLOCK] if block > 1 else []


def _ends(parameters: Parameters, start: int, size: int) -> Iterator[int]:
    """Where the data may end: before a block of other data that a group points to, such as that of rotations, else with the file."""
    for group in parameters.groups:
        block = parameters.count(group, "DATA_START")
        if group == "POINT" or not block or parameters.count(group, "USED") == 0:
            continue
        # The pointer has 16 bits: behind 32 MB it is wrapped round them.
        yield from (end for end in range((block - 1) * BLOCK, size, BLOCK * (LIMIT + 1)) if end > start)
    yield size


def _rotations_fill(parameters: Parameters, frames: int, room: int) -> bool:
    """Whether rotations of so many frames, 17 numbers each, fill what follows the data; true of a file that does not count them."""
    used, ratio = parameters.count("ROTATION", "USED"), parameters.number("ROTATION", "RATIO") or 1.0
    return not used or abs(room - 4 * 17 * used * ratio * frames) <= 2 * BLOCK


def _counts(header: Header, parameters: Parameters) -> dict[str, int]:
    """The number of frames as each part of the file gives it, the most reliable first."""
    counts = {"the header": header.frames}
    begin, end = parameters.counts("TRIAL", "ACTUAL_START_FIELD"), parameters.counts("TRIAL", "ACTUAL_END_FIELD")
    if len(begin) >= 2 and len(end) >= 2:
        counts["TRIAL"] = end[0] + 65536 * end[1] - begin[0] - 65536 * begin[1] + 1
    for name in ("LONG_FRAMES", "FRAMES"):
        count = parameters.count("POINT", name)
        if count is not None:
            counts[f"POINT:{name}"] = count
    return counts


def _spent(name: str, count: int, header: Header, frames: int) -> bool:
    """Whether a count says nothing against so many frames: at the limit of 16 bits, wrapped round it, or not given."""
    if count <= 0 or name == "POINT:LONG_FRAMES":
        return count <= 0
    at_limit = count == LIMIT or (name == "the header" and header.last_frame == LIMIT)
    return frames >= count and (at_limit or (frames > count and (frames - count) % (LIMIT + 1) == 0))


def _claims(header: Header, parameters: Parameters, start: int) -> Iterator[Layout]:
    """Every layout of the data block that some part of the file declares, the most reliable first."""
    used = parameters.count("POINT", "USED")
    labels = sum(len(parameters.raw_strings("POINT", name)) for name in parameters.groups.get("POINT", ()) if name.startswith("LABELS"))
    channels, rates = parameters.count("ANALOG", "USED"), [parameters.number(group, "RATE") for group in ("ANALOG", "POINT")]
    analog = [header.analog_per_frame]
    if channels is not None:
        analog.append(channels * header.analog_per_point_frame)
        if rates[0] and rates[1]:
            analog.append(channels * min(max(round(rates[0] / rates[1]), 0), LIMIT))
    # 65535 is what a 16-bit count shows of more frames: it comes last.
    counts = dict.fromkeys(count for count in _counts(header, parameters).values() if count > 0)
    frames = sorted(counts, key=lambda count: count == LIMIT) or [0]
    scale = parameters.number("POINT", "SCALE")
    signs = [header.scale] if np.isfinite(header.scale) and header.scale != 0 else []
    signs += [scale] if scale else []
    # Without a sign both number formats are tried.
    reals = dict.fromkeys([sign < 0 for sign in signs] or [True, False])
    # Labels are often listed for points that the file has not: they count last.
    points = [header.points, *([] if used is None else [used]), *([labels] if header.points or used else [])]
    for real, count, samples, length in product(reals, dict.fromkeys(points), dict.fromkeys(analog), frames):
        yield Layout(start, length, count, samples, real)


def _fills(raw: bytes | bytearray, layout: Layout, end: int) -> bool:
    """Whether a layout leaves less than a block, or a whole one of zeros, which some programs write behind a full block."""
    left = end - layout.stop
    return 0 <= left < BLOCK or (left == BLOCK and not any(raw[layout.stop : end]))


def _that_fills(
    raw: bytes | bytearray, processor: Processor, header: Header, starts: Sequence[_DataStart]
) -> tuple[_DataStart, Layout] | None:
    """The claim that fills the room of the data but for its last block."""
    for start in starts:
        for end in start.ends:
            fits = [claim for claim in start.claims if claim.frames and claim.width and _fills(raw, claim, end)]
            if fits:
                counts = list(_counts(header, start.parameters).values())
                # What ends a block is zeros, mostly, and no frame: data behind the last frame speak against a claim, as does an empty
                # last frame; then the number of those who say so counts.
                fits.sort(key=lambda claim: (any(raw[claim.stop : end]), _ends_empty(raw, claim), -counts.count(claim.frames)))
                layout = _stillest(raw, processor, fits)
                if not any(raw[layout.stop : end]) or _restlessness(raw, processor, layout) < _LEAPING:
                    return start, layout
    return None


def _ends_empty(raw: bytes | bytearray, layout: Layout) -> bool:
    return not any(raw[layout.stop - layout.frame_bytes : layout.stop])


def _by_length(
    raw: bytes | bytearray, processor: Processor, header: Header, starts: Sequence[_DataStart]
) -> tuple[_DataStart, Layout] | None:
    """A claim with as many frames as there is room for, where all counts of frames are spent."""
    for start in starts:
        counts = _counts(header, start.parameters)
        for end in start.ends:
            fits: dict[tuple[int, int, bool], Layout] = {}
            for layout in (layout for claim in start.claims for layout in _lengthened(raw, claim, end, counts.values())):
                spent = all(_spent(name, count, header, layout.frames) for name, count in counts.items())
                if layout.frames and spent and (end == len(raw) or _rotations_fill(start.parameters, layout.frames, len(raw) - end)):
                    fits.setdefault(_shape(layout), layout)
            if fits:
                return start, _stillest(raw, processor, list(fits.values()))
    return None


def _lengthened(raw: bytes | bytearray, claim: Layout, end: int, counts: Collection[int]) -> Iterator[Layout]:
    """A claim with other numbers of frames: those that are wrapped round 16 bits and fill the room; then all for which there is room."""
    size = claim.frame_bytes
    if not size:
        return
    room = (end - claim.start) // size
    wrapped = (replace(claim, frames=room - (room - count) % (LIMIT + 1)) for count in counts if 0 < count <= room)
    yield from (layout for layout in wrapped if _fills(raw, layout, end))
    left = end - claim.start - room * size
    # Padding of the last block, and a block more that some programs write, may have the length of frames, and is zeros.
    while room > 1 and left + size < 2 * BLOCK and not any(raw[end - left - size : end]):
        room, left = room - 1, left + size
    yield replace(claim, frames=room)


def _that_leaves_least(raw: bytes | bytearray, path: str, processor: Processor, start: _DataStart, findings: list[Finding]) -> Layout:
    """The claim that leaves least of the file unread; where all need more than there is, as many frames as are whole.

    Raises AsterismError where no frame is.
    """
    room = start.ends[-1] - start.at
    claims = [claim for claim in start.claims if claim.width and claim.frames]
    if not claims:
        return replace(start.claims[0], frames=0)
    # Shapes that fit come first, so that the more reliable of equally still ones is taken.
    claims.sort(key=lambda claim: claim.stop > start.ends[-1])
    clipped = [replace(claim, frames=min(claim.frames, room // claim.frame_bytes)) for claim in claims]
    shape = _shape(_stillest(raw, processor, clipped))
    claims = [claim for claim in claims if _shape(claim) == shape]
    fit = max((claim for claim in claims if claim.stop <= start.ends[-1]), key=lambda claim: claim.stop, default=None)
    if fit is not None:
        return fit
    frames = room // claims[0].frame_bytes
    if not frames:
        raise AsterismError(f"{path} breaks off before its first frame ends; export or copy it again.")
    findings.append(cut_off(f"the file breaks off: it holds {frames} of {claims[0].frames} frames"))
    return replace(claims[0], frames=frames, cut=True)


def _shape(layout: Layout) -> tuple[int, int, bool]:
    return layout.points, layout.analog, layout.real


def _stillest(raw: bytes | bytearray, processor: Processor, layouts: Sequence[Layout]) -> Layout:
    """The first of the layouts, unless points move less than half as much from frame to frame in another one.

    Read with a wrong width, each column runs through all points of the body, and jumps by its size.
    """
    shapes = {_shape(layout): layout for layout in reversed(layouts)}
    if len(shapes) < 2:
        return layouts[0]
    restless = {shape: _restlessness(raw, processor, layout) for shape, layout in shapes.items()}
    calm = min(restless, key=lambda shape: restless[shape])
    return layouts[0] if restless[calm] >= 0.5 * restless[_shape(layouts[0])] else shapes[calm]


def _restlessness(raw: bytes | bytearray, processor: Processor, layout: Layout) -> float:
    """The median step of a coordinate from one frame to the next, as a share of the median distance from the middle; at most 1.

    1 where there are too few frames or points to tell, or most numbers are no coordinates.
    """
    frames = min(layout.frames, _FRAMES_COMPARED)
    if frames < 2 or not layout.points:
        return 1.0
    read = processor.words32 if layout.real else processor.words16
    words = read(raw, frames * layout.width, layout.start).reshape(frames, -1)[:, : 4 * layout.points].reshape(frames, -1, 4)[:, :, :3]
    with np.errstate(all="ignore"):
        values = np.asarray((processor.floats if layout.real else processor.integers)(np.ascontiguousarray(words)), dtype=np.float64)
        # Integers that are read as floats are huge, or next to nothing.
        odd = ~((np.abs(values) < 1e8) & (np.abs(values) > 1e-8)) & (values != 0)
        there = ~odd & (values != 0)
        both = there[1:] & there[:-1]
        if odd.mean() > 0.25 or not both.any():
            return 1.0
        seen = values[there]
        spread = float(nan_median(np.abs(seen - nan_median(seen, 0)), 0))
        return min(float(nan_median(np.abs(np.diff(values, axis=0))[both], 0)) / spread, 1.0) if spread > 0 else 1.0


def _about_counts(raw: bytes | bytearray, header: Header, start: _DataStart, layout: Layout) -> Iterator[Finding]:
    """What the file declares otherwise than the data are, and whole frames that nothing declares."""
    # What was cut off contradicts every count; saying so once is enough.
    if layout.cut:
        return
    for who, noun, declared, found in (
        ("the header", "points", header.points, layout.points),
        ("the header", "analog samples per frame", header.analog_per_frame, layout.analog),
        ("POINT:USED", "points", start.parameters.count("POINT", "USED"), layout.points),
    ):
        if declared is not None and declared != found:
            yield header_conflict(f"{declared} {noun} are declared by {who}, the data hold {found}")
    counts = _counts(header, start.parameters)
    others = {name: count for name, count in counts.items() if count != layout.frames}
    spent = [name for name, count in others.items() if _spent(name, count, header, layout.frames)]
    for name, count in others.items():
        if name not in spent:
            yield header_conflict(f"{count} frames are declared by {name}, the data hold {layout.frames}")
    if spent and len(others) == len(counts):
        yield header_conflict(f"{' and '.join(spent)} cannot count the frames; there are {layout.frames} by the length of the file")
    end = min(end for end in start.ends if end >= layout.stop)
    left = (end - layout.stop) // max(layout.frame_bytes, 1)
    # Zeros that fill the last block, or more, are no frames.
    if layout.frames and left and end - layout.stop >= BLOCK and any(raw[layout.stop : end]):
        yield header_doubt(f"behind the {layout.frames} frames that are declared there is room for {left} more, which were not read")


def first_frame_of(
    header: Header, parameters: Parameters, layout: Layout, events: Sequence[Event], rate: float
) -> tuple[int, Finding | None]:
    """The number of the first stored frame, 1 for the first of the trial; and a finding where header and TRIAL contradict each other.

    Of the two, the one whose last frame agrees with the frames there are; else the one in whose time more events lie; else TRIAL.
    """
    begin, counts, frames = parameters.counts("TRIAL", "ACTUAL_START_FIELD"), _counts(header, parameters), layout.frames
    fits = {name: count > 0 and (layout.cut or count == frames or _spent(name, count, header, frames)) for name, count in counts.items()}
    claims = [("the header", header.first_frame, fits["the header"])]
    if len(begin) >= 2:
        trial = begin[0] + 65536 * begin[1]
        # The header's numbers have 16 bits only.
        if fits.get("TRIAL") and trial + frames - 1 > LIMIT:
            return trial, None
        claims.insert(0, ("TRIAL", trial, fits.get("TRIAL", False)))
        # A program that cut the beginning away may have left both first frames, and TRIAL's last one tells it. Some count one more.
        by_last = trial + counts.get("TRIAL", 0) - frames
        if not fits.get("TRIAL", True) and abs(by_last - trial) > 1 and by_last > 0:
            claims.append(("TRIAL's last frame", by_last, False))
    if not fits["the header"]:
        # One of its two numbers is wrong; most trials begin with 1.
        by_last = header.last_frame - frames + 1
        claims.insert(len(claims) - (by_last == 1), ("the header's last frame", by_last, False))
    # A program that counts from 0 means the same frame.
    claims = [(who, max(first, 1), fit) for who, first, fit in claims]
    weights = {
        first: (fit, sum(-1.0 <= event.time * rate - first + 1 <= frames for event in events))
        for _, first, fit in sorted(claims, key=lambda claim: claim[2])
    }
    first = max((first for _, first, _ in claims), key=lambda first: weights[first])
    if len(weights) < 2:
        return first, None
    said = ", ".join(f"{other} by {who}" for who, other, _ in claims)
    others = [weight for other, weight in weights.items() if other != first]
    # Frames that fit leave open at which end a file was cut, unless events or another number tell it.
    told = not events or ("TRIAL's last frame", first, False) in claims or all(weights[first][1] > inside for _, inside in others)
    if told and all(weights[first] > weight for weight in others):
        return first, header_conflict(f"the first frame is {said}; {first} was used, which fits the frames and events better")
    return first, header_doubt(f"the first frame is {said}; {first} was used, and where it is wrong events are at other frames")
