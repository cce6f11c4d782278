"""Packets of OptiTrack Motive's stream (NatNet 2.3 to 4.x, and later ones by what they say of themselves) in; servers and frames out.

The layout is that of the vendor's public depacketizing examples, which contradict each other: versions before 3 have a latency before the
time code in C++ and none in Python. A packet has to end where its version says, so that each one shows which is right. Nothing here raises.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from asterism.live.analog import AnalogDevice, AnalogSamples
from asterism.live.frames import MOST_POINTS, DamagedPacket, LiveFrame, believable, joined

FRAME = 7
_SERVER_INFO = 1
"""Kinds of messages that are read."""
_LATEST = (4, 5)
"""Later versions are tried as this one, and then by the sizes that they give for each part."""
_SIZES = (4, 1)
"""The first version that says the size of each part."""
_OCCLUDED, _BY_CAMERAS, _BY_MODEL, _UNLABELLED = 0x01, 0x02, 0x04, 0x10
"""Bits of a marker: what is known of where its place is from."""
_MOST_FAILED = 5
"""Packets in a row that do not fit the version in use, after which others are tried again: a server of another version took over. Half of
it lets noise look for another version; twice as many lose frames."""


class _Packet:
    """Reads a packet from the front; never beyond its end, and never more elements than it has bytes for."""

    def __init__(self, data: bytes, at: int = 0) -> None:
        self.data, self.at = data, at

    def take(self, layout: str) -> tuple[float, ...]:
        size = struct.calcsize(layout)
        if self.at + size > len(self.data):
            raise DamagedPacket
        values = struct.unpack_from(layout, self.data, self.at)
        self.at += size
        return values

    def count(self, least: int) -> int:
        """A number of elements of at least so many bytes."""
        count = int(self.take("<i")[0])
        if count < 0 or count * least > len(self.data) - self.at:
            raise DamagedPacket
        return count

    def skip(self, size: int) -> None:
        if size < 0 or self.at + size > len(self.data):
            raise DamagedPacket
        self.at += size

    def name(self) -> str:
        """A text that ends with a zero."""
        end = self.data.find(b"\0", self.at, self.at + 256)
        if end < 0:
            raise DamagedPacket
        text = self.data[self.at : end].decode("utf-8", "replace")
        self.at = end + 1
        return text

    def records(self, count: int, size: int) -> np.ndarray:
        """(count, size) bytes."""
        if count * size > len(self.data) - self.at:
            raise DamagedPacket
        found = np.frombuffer(self.data, dtype=np.uint8, count=count * size, offset=self.at).reshape(count, size)
        self.at += count * size
        return found

    @property
    def left(self) -> int:
        return len(self.data) - self.at


@dataclass(frozen=True)
class NatNetServer:
    """Who answers: the program and its version, the version of its stream, and to which group it sends, "" where to each client alone.

    group_told  whether it said so itself, as versions since 3 do; earlier ones may also send to each client alone
    """

    name: str
    program: tuple[int, ...]
    stream: tuple[int, int]
    group: str = ""
    port: int = 1511
    group_told: bool = True


def server_of_packet(data: bytes) -> NatNetServer | None:
    """The server that an answer to a greeting names; None where the packet is none."""
    try:
        packet = _Packet(data)
        kind, size = packet.take("<HH")
        if kind != _SERVER_INFO or size > len(data) - 4:
            return None
        name = bytes(packet.records(1, 256)[0]).partition(b"\0")[0].decode("utf-8", "replace")
        program, stream = packet.take("<4B"), packet.take("<4B")
    except DamagedPacket:
        return None
    about = (name, tuple(int(part) for part in program), (int(stream[0]), int(stream[1])))
    try:
        # Since version 3: the clock's frequency, and where frames are sent.
        _, port, is_group, *address = packet.take("<QHB4B")
    except DamagedPacket:
        return NatNetServer(*about, "239.255.42.99", group_told=False)
    # Any other address is no group, whatever is said; 255.255.255.255 is everybody.
    group = ".".join(str(int(part)) for part in address) if is_group and (224 <= address[0] <= 239 or set(address) == {255}) else ""
    return NatNetServer(*about, group, int(port) or 1511)


@dataclass(frozen=True)
class _StreamLayout:
    """A version of the stream; `latency` for a latency before the time code, `by_size` for parts that are passed over by their size."""

    version: tuple[int, int]
    latency: bool = False
    by_size: bool = False

    @property
    def behind(self) -> tuple[int, ...]:
        """Bytes that may stand behind the time: flags and four zeros; since 3 three time stamps before them, later one more."""
        return (6,) if self.version < (3, 0) else (30,) if self.version < _SIZES else (38, 30)


_STREAM_LAYOUTS = (
    *map(_StreamLayout, (_SIZES, (3, 0))),
    *(_StreamLayout(version, latency) for latency in (True, False) for version in ((2, 11), (2, 9), (2, 7), (2, 6), (2, 5))),
)
"""All that differ in where something stands; versions between have the layout of the one before. 2.6 with a latency is as long as 2.7
without, so that those with one come first: so C++ reads them, and Motive is C++."""


@dataclass
class NatNetFrames:
    """Reads the frames of one server.

    told   the version of its stream, as the server says it
    scale  m of its unit

    A packet that does not end where that version ends is tried as the others: a server may say another version than it sends. What fitted
    is kept to, until a row of packets does not fit it. `used` is the version by which packets are read, None before the first; `sure` says
    whether they end where it does, `labelled` whether Motive gave some marker a label.
    """

    told: tuple[int, int]
    scale: float = 1.0
    used: tuple[int, int] | None = None
    sure: bool = False
    labelled: bool = False
    _layout: _StreamLayout | None = None
    _failed: int = 0
    _first: list[_StreamLayout] = field(default_factory=list)

    def __post_init__(self) -> None:
        version = min(self.told, _LATEST)
        self._first = [_StreamLayout(version)] if version >= (3, 0) else [_StreamLayout(version, True), _StreamLayout(version, False)]

    @property
    def contradiction(self) -> str:
        """What is wrong about the version, "" where nothing is."""
        told = f"its stream is NatNet {self.told[0]}.{self.told[1]} as it says"
        if self.told > _LATEST:
            return f"{told}, later than {_LATEST[0]}.{_LATEST[1]}, which is known; it is read as that one, or by the sizes that it gives"
        if self.used is not None and self.used != self.told:
            return f"{told}, but its packets are those of {self.used[0]}.{self.used[1]}, as which they are read"
        return "" if self.sure else f"{told}, but its packets do not end as those of that version; their markers are used"

    def frame(self, data: bytes, arrived: float) -> LiveFrame | None:
        """The frame in a packet; None where the packet is of another kind, or damaged.

        Points are all markers that cameras saw. A hidden marker has a place, too, which Motive fills in by its own model: it is left out.
        """
        if len(data) < 4:
            return None
        kind, size = struct.unpack_from("<HH", data)
        if kind != FRAME or size > len(data) - 4:
            return None
        content = data[4 : 4 + size]
        if self._layout is not None:
            found = self._read(content, self._layout, arrived)
            if found is not None and found[1] == self.sure:
                self._failed = 0
                return found[0]
            self._failed += 1
            if self._failed < _MOST_FAILED:
                return None
        return self._sought(content, arrived)

    def _sought(self, content: bytes, arrived: float) -> LiveFrame | None:
        """The frame by whichever layout ends where the packet ends; else by the version that was told, or by sizes."""
        almost: tuple[_StreamLayout, LiveFrame] | None = None
        later = [_StreamLayout(_LATEST, by_size=True)] if self.told > _LATEST else []
        for layout in (*self._first, *later, *_STREAM_LAYOUTS):
            found = self._read(content, layout, arrived)
            if found is None:
                continue
            if found[1]:
                return self._kept(layout, True, found[0])
            if almost is None and (layout in self._first or layout.by_size) and _is_time(found[0].time):
                almost = (layout, found[0])
        # Where the packets of a server have once ended as they should, one that does not is damaged.
        return None if almost is None or self.sure else self._kept(almost[0], False, almost[1])

    def _kept(self, layout: _StreamLayout, sure: bool, frame: LiveFrame) -> LiveFrame:
        self._layout, self.sure, self._failed = layout, sure, 0
        self.used = self.told if layout in self._first or layout.by_size else layout.version
        return frame

    def _read(self, content: bytes, layout: _StreamLayout, arrived: float) -> tuple[LiveFrame, bool] | None:
        """The frame by one layout, and whether it ends where that ends."""
        try:
            packet = _Packet(content)
            frame, labelled = _frame(packet, layout, arrived, self.scale)
        except DamagedPacket:
            return None
        if not np.isfinite(frame.time) or len(frame.points) > MOST_POINTS:
            return None
        self.labelled = self.labelled or labelled
        return frame, packet.left in layout.behind and content[-4:] == bytes(4)


def _is_time(seconds: float) -> bool:
    """Whether it can be a time: what is read at a wrong place is mostly next to nothing, or more than centuries."""
    return seconds == 0 or 1e-6 < seconds < 1e10


def _frame(packet: _Packet, layout: _StreamLayout, arrived: float, scale: float) -> tuple[LiveFrame, bool]:
    """The frame, and whether Motive gave some marker a label."""
    version = layout.version
    number = int(packet.take("<i")[0])
    sets = _Part(packet, layout, 5)
    for _ in range(sets.to_read):
        packet.name()
        packet.records(packet.count(12), 12)
    sets.end()
    part = _Part(packet, layout, 12)
    others = packet.records(part.count, part.each(12))[:, :12].copy().view("<f4").reshape(-1, 3)
    part.end()
    _pass_over_bodies(packet, layout)
    seen, hidden, labelled = _markers(packet, layout)
    analog = list[AnalogSamples]()
    for since, kind in (((2, 9), "force plate"), ((2, 11), "device")):
        if version >= since:
            analog += _analog(packet, layout, kind)
    packet.skip(12 if layout.latency else 8)
    at = float(packet.take("<d" if version >= (2, 7) else "<f")[0])
    # Numbers of a damaged packet may be none, and to convert them is then told as a warning.
    with np.errstate(invalid="ignore"):
        points = joined(*(believable(scale * each.astype(np.float64)) for each in (seen, others, hidden)))
    return LiveFrame(number, at, arrived, points, analog=tuple(analog)), labelled


class _Part:
    """A part of a frame: how many elements it has, of at least so many bytes each, and where it ends in versions that say so."""

    def __init__(self, packet: _Packet, layout: _StreamLayout, least: int) -> None:
        self._packet, self._by_size = packet, layout.by_size
        self.count = packet.count(0 if layout.by_size else least)
        size = int(packet.take("<i")[0]) if layout.version >= _SIZES else 0
        if layout.by_size and not 0 <= size <= packet.left:
            raise DamagedPacket
        self._end, self._size = packet.at + size, size

    @property
    def to_read(self) -> int:
        """Elements to pass over one by one; none where the part is passed over by its size."""
        return 0 if self._by_size else self.count

    def each(self, size: int) -> int:
        """Bytes of an element, which are `size` unless later versions have more."""
        if not self._by_size or not self.count:
            return size
        if self._size % self.count or self._size < size * self.count:
            raise DamagedPacket
        return self._size // self.count

    def end(self) -> None:
        if self._by_size:
            self._packet.at = self._end


def _pass_over_bodies(packet: _Packet, layout: _StreamLayout) -> None:
    """Rigid bodies, skeletons and, since 4.1, assets: nothing of them is a point that a camera saw."""
    part = _Part(packet, layout, 32)
    for _ in range(part.to_read):
        _rigid_body(packet, layout.version)
    part.end()
    part = _Part(packet, layout, 8)
    for _ in range(part.to_read):
        packet.take("<i")
        for _ in range(packet.count(32)):
            _rigid_body(packet, layout.version)
    part.end()
    if layout.version >= (4, 1):
        # A number, rigid bodies of 38 bytes, markers of 26.
        part = _Part(packet, layout, 12)
        for _ in range(part.to_read):
            packet.take("<i")
            packet.records(packet.count(38), 38)
            packet.records(packet.count(26), 26)
        part.end()


def _markers(packet: _Packet, layout: _StreamLayout) -> tuple[np.ndarray, np.ndarray, bool]:
    """(n, 3) markers that cameras saw and hidden ones, of the list that versions since 2.3 have; whether a seen one has a label."""
    version = layout.version
    part = _Part(packet, layout, 20)
    size = part.each(20 + (2 if version >= (2, 6) else 0) + (4 if version >= (3, 0) else 0))
    markers = packet.records(part.count, size)
    part.end()
    places = markers[:, 4:16].copy().view("<f4").reshape(-1, 3)
    # The upper half of a number is that of the body to which the marker belongs.
    of_body = markers[:, 2:4].any(axis=1)
    if version < (2, 6):
        return places, places[:0], bool(of_body.any())
    flags = markers[:, 20]
    hidden = flags & _OCCLUDED != 0
    seen = ~hidden & ((flags & _BY_CAMERAS != 0) | (flags & _BY_MODEL == 0))
    return places[seen], places[hidden], bool((of_body & (flags & _UNLABELLED == 0)).any())


def _analog(packet: _Packet, layout: _StreamLayout, kind: str) -> Iterator[AnalogSamples]:
    """What each force plate or device measured: its number, and channels with their samples. Their rate is in no packet, nor their names.

    Where a channel has fewer samples than another, those that it lacks are NaN.
    """
    part = _Part(packet, layout, 8)
    for _ in range(part.to_read):
        name = f"{kind} {packet.take('<i')[0]}"
        channels = [packet.records(packet.count(4), 4).copy().view("<f4").ravel() for _ in range(packet.count(4))]
        values = np.full((max(map(len, channels), default=0), len(channels)), np.nan)
        for column, samples in enumerate(channels):
            # A signalling NaN of a damaged packet is told as a warning.
            with np.errstate(invalid="ignore"):
                values[: len(samples), column] = samples
        if values.size:
            names = tuple(f"{name} channel {n + 1}" for n in range(len(channels)))
            yield AnalogSamples(AnalogDevice(name, float("nan"), names, len(channels) * ("",)), 0, values)
    part.end()


def _rigid_body(packet: _Packet, version: tuple[int, int]) -> None:
    packet.skip(32)
    if version < (3, 0):
        # Its markers: places, numbers and sizes.
        packet.records(packet.count(20), 20)
    packet.skip(4 + (2 if version >= (2, 6) else 0))
