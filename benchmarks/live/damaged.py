"""Messages of the network with bytes changed, cut off, put in and exchanged in; exceptions, times and memory out."""

from __future__ import annotations

import resource
import struct
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from asterism.formats.mocap_channels import layout_of_channels
from asterism.live import LiveFrame, SourceAbout, frame_as_json, frame_of_json
from asterism.live.blobs.sources import blobs_as_json, blobs_of_json
from asterism.live.camera_frames import LiveBlobs
from asterism.live.frames import DamagedPacket
from asterism.live.natnet_packets import NatNetFrames, server_of_packet
from asterism.live.natnet_server import ToNatNet
from asterism.live.qtm_packets import blobs_of_packet, points_of_packet, settings_of_xml
from asterism.live.vicon import ViconState
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.figures import Figure


@dataclass(frozen=True)
class _Message:
    """A message that is whole, and what reads it: gives None, or raises `DamagedPacket`, where it does not take it.

    head  bytes in front that are not damaged, since most damage to them is refused at once
    """

    whole: bytes
    read: Callable[[bytes], object]
    head: int = 0


def damaged(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Every kind of message in turn, each with up to seven places damaged."""
    rng, count = np.random.default_rng(0), 2_000 if benchmark.quick else 100_000
    messages = _messages(rng)
    failed, longest, read = 0, 0.0, 0
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for n in range(count):
        message = messages[n % len(messages)]
        data = bytearray(message.whole)
        for _ in range(int(rng.integers(1, 8))):
            at = int(rng.integers(message.head, max(message.head + 1, len(data))))
            end = at + int(rng.integers(0, 9)) if rng.random() < 0.9 else len(data)
            data[at:end] = rng.bytes(int(rng.integers(0, 9)))
        if message.head:
            data[2:4] = struct.pack("<H", len(data) - 4 & 0xFFFF)
        begin = time.thread_time()
        try:
            read += message.read(bytes(data)) is not None
        except DamagedPacket:
            pass
        except Exception:
            failed += 1
        longest = max(longest, time.thread_time() - begin)
    # Of Linux in kB, of macOS in bytes.
    grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * (1 if sys.platform == "darwin" else 1024)
    row = f"live, damaged messages of {len(messages)} kinds"
    yield Figure(f"{row}: exceptions", "== 0", failed, "messages", count)
    yield Figure(f"{row}: longest processor time of one", "none", 1000 * longest, "ms", count)
    yield Figure(f"{row}: growth of the most memory", "< 20", grown / 1e6, "MB", count)
    yield Figure(f"{row}: read all the same", "none", read / count, "fraction", count)


def _messages(rng: np.random.Generator) -> list[_Message]:
    """One of each kind, of 59 points or of four cameras, as its sender sends it."""
    points = rng.normal(size=(59, 3))
    frame = LiveFrame(1, 0.5, 0.0, points, tuple(f"M{n}" for n in range(59)))
    blobs = LiveBlobs("c1", 1, 0.5, 0.0, rng.uniform(0, 1000, size=(50, 2)), np.full(50, 4.0))
    natnet = {version: NatNetFrames(version) for version in ((2, 9), (3, 0), (4, 1), (5, 0))}
    vicon = ViconState()
    return [
        _Message(frame_as_json(frame), lambda data: frame_of_json(data, 0.0)),
        _Message(blobs_as_json(blobs), lambda data: blobs_of_json(data, 0.0)),
        *(
            _Message(_natnet(points, version), lambda data, reader=reader: reader.frame(data, 0.0), head=4)  # type: ignore[misc]
            for version, reader in natnet.items()
        ),
        _Message(struct.pack("<HH", 1, 279) + bytes(264) + struct.pack("<QHB4B", 1, 1511, 1, 239, 255, 42, 99), server_of_packet, head=4),
        _Message(_qtm(1, 12, points), lambda data: points_of_packet(data, 0.0)),
        _Message(_qtm(10, 20, points), lambda data: points_of_packet(data, 0.0)),
        _Message(_qtm_analog(rng), lambda data: points_of_packet(data, 0.0)),
        _Message(_qtm_blobs(rng), lambda data: blobs_of_packet(data, 0.0, ("1", "2"))),
        _Message(_QTM_SETTINGS, settings_of_xml),
        *(_Message(struct.pack("<HH", kind, len(text)) + text, _NatNetCommands(), head=3) for kind, text in _COMMANDS),
        _Message("\n".join(f"{name}|||Position{axis}|mm" for name in ("LASI", "RASI", "SACR") for axis in "XYZ").encode(), _channels),
        _Message(_vicon(points), lambda data: vicon.frame(data, 0.0)),
    ]


_COMMANDS = ((0, b"Ping\0"), (2, b"FrameRate\0"), (12, struct.pack("<Q", 7)))


class _NatNetCommands:
    """What our own server of NatNet answers to clients, each of which is another one."""

    def __init__(self) -> None:
        self._server, self._port = ToNatNet("natnet://127.0.0.1:0?unicast=1", SourceAbout("benchmark", 200.0)), 0
        self._server.close()

    def __call__(self, data: bytes) -> bytes | None:
        self._port += 1
        return self._server.answer(data, ("127.0.0.1", self._port)) or None


def _channels(data: bytes) -> object:
    """The layout of a stream of LSL whose channels are described so, a line each."""
    keys = ("label", "marker", "object", "type", "unit")
    channels = [dict(zip(keys, line.split("|"), strict=False)) for line in data.decode("latin-1").splitlines()]
    return layout_of_channels(channels, len(channels))


def _natnet(points: np.ndarray, version: tuple[int, int]) -> bytes:
    """A frame of labelled markers and nothing else."""
    size = struct.pack("<i", 0) if version >= (4, 1) else b""
    empty = struct.pack("<i", 0) + size
    residual = bytes(4) if version >= (3, 0) else b""
    markers = b"".join(struct.pack("<i4fH", n, *point, 0.01, 2) + residual for n, point in enumerate(points))
    data = struct.pack("<i", 1) + empty * (5 if size else 4)
    data += struct.pack("<i", len(points)) + (struct.pack("<i", len(markers)) if size else b"") + markers
    data += empty * (2 if version >= (2, 11) else 1) + struct.pack("<2Id", 0, 0, 1.0)
    data += bytes((24 if version >= (3, 0) else 0) + (8 if size else 0) + 6)
    return struct.pack("<HH", 7, len(data)) + data


def _qtm(kind: int, size: int, points: np.ndarray) -> bytes:
    rows = b"".join(struct.pack("<3f", *(1000 * point)) + bytes(size - 12) for point in points)
    return struct.pack("<qIIIIIHH", 5, 1, 1, 16 + len(rows), kind, len(points), 0, 0) + rows


def _qtm_analog(rng: np.random.Generator) -> bytes:
    devices = 3 * (struct.pack("<4I", 1, 8, 10, 500) + rng.normal(size=80).astype("<f4").tobytes())
    return struct.pack("<qIIIII", 5, 1, 1, 12 + len(devices), 3, 3) + devices


def _qtm_blobs(rng: np.random.Generator) -> bytes:
    blobs = b"".join(struct.pack("<iiHH", *rng.integers(0, 60_000, 4).tolist()) for _ in range(50))
    rows = 4 * (struct.pack("<IB", 50, 0) + blobs)
    return struct.pack("<qIIIIIHH", 5, 1, 1, 16 + len(rows), 7, 4, 0, 0) + rows


_QTM_SETTINGS = b"""<QTM_Parameters_Ver_1.20><General><Frequency>100</Frequency><Camera><ID>1</ID><Serial>7</Serial></Camera></General>
<The_3D><AxisUpwards>+Z</AxisUpwards><Label><Name>LASI</Name><Trajectory_Type>Measured</Trajectory_Type></Label></The_3D></QTM_Parameters_Ver_1.20>"""


def _vicon(points: np.ndarray) -> bytes:
    rows = b"".join(struct.pack("<d3d9dI", 7.0, *(1000 * point), *np.eye(3).ravel(), 1) for point in points)
    objects = [(100004, struct.pack("<4I", 1, 5, 1, 0)), (1, struct.pack("<q", 1_350_000)), (5, struct.pack("<I", 1)), (37, b"\0")]
    objects.append((7, struct.pack("<I", len(points)) + rows))
    return b"".join(struct.pack("<II", kind, len(content)) + content for kind, content in objects)
