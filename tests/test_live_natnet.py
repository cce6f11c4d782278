"""Motive's stream, written by the test for each version, damaged, sent by a server of the test's own, and as it was really captured."""

from __future__ import annotations

import re
import socket
import struct
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from asterism import AsterismError
from asterism.live import LiveFrame, open_source
from asterism.live.natnet import frame_of_packet, server_of_packet

VERSIONS = [(2, 3), (2, 5), (2, 6), (2, 7), (2, 9), (2, 10), (2, 11), (3, 0), (3, 1), (4, 0), (4, 1), (4, 2)]
Place = tuple[float, float, float]


def part(version: tuple[int, int], count: int, content: bytes) -> bytes:
    return struct.pack("<i", count) + (struct.pack("<i", len(content)) if version >= (4, 1) else b"") + content


def rigid_body(version: tuple[int, int]) -> bytes:
    body = struct.pack("<i7f", 1, *[0.5] * 7)
    if version < (3, 0):
        body += struct.pack("<i", 2) + struct.pack("<6f2i2f", *[0.1] * 6, 1, 2, 0.01, 0.01)
    return body + struct.pack("<f", 0.001) + (struct.pack("<H", 1) if version >= (2, 6) else b"")


def packet(
    version: tuple[int, int], number: int, at: float, seen: Sequence[Place], hidden: Sequence[Place], others: Sequence[Place]
) -> bytes:
    """A frame as Motive sends it: one marker set, one rigid body, a skeleton, and a force plate where there may be one."""
    data = struct.pack("<i", number)
    data += part(version, 1, b"Rigid Body 1\0" + struct.pack("<i3f", 1, 9.0, 9.0, 9.0))
    data += part(version, len(others), b"".join(struct.pack("<3f", *place) for place in others))
    data += part(version, 1, rigid_body(version))
    data += part(version, 1, struct.pack("<ii", 3, 2) + 2 * rigid_body(version))
    if version >= (4, 1):
        asset = (
            struct.pack("<ii", 5, 1)
            + struct.pack("<i8fH", 1, *[0.5] * 8, 1)
            + struct.pack("<i", 1)
            + struct.pack("<i4fHf", 1, *[8.0] * 4, 0, 0.0)
        )
        data += part(version, 1, asset)
    if version >= (2, 3):
        markers = b""
        for flag, places in ((0, seen), (1, hidden)):
            for n, place in enumerate(places):
                markers += struct.pack("<i4f", n + (2 << 16), *place, 0.014)
                markers += (struct.pack("<H", 2 | flag) if version >= (2, 6) else b"") + (
                    struct.pack("<f", 0.0) if version >= (3, 0) else b""
                )
        data += part(version, len(seen) + len(hidden), markers)
    for since in ((2, 9), (2, 11)):
        if version >= since:
            data += part(version, 1, struct.pack("<ii", 7, 2) + 2 * struct.pack("<i3f", 3, 1.0, 2.0, 3.0))
    data += struct.pack("<II", 0, 0) + struct.pack("<d" if version >= (2, 7) else "<f", at)
    data += struct.pack("<3Q", 1, 2, 3) if version >= (3, 0) else b""
    data += struct.pack("<2I", 4, 5) if version >= (4, 2) else b""
    data += struct.pack("<Hi", 0, 0)
    return struct.pack("<HH", 7, len(data)) + data


def greeting(version: tuple[int, int], group: str = "", port: int = 1511) -> bytes:
    data = b"Motive".ljust(256, b"\0") + bytes([2, 3, 0, 0]) + bytes([*version, 0, 0])
    if version >= (3, 0):
        data += struct.pack("<QHB4B", 10_000_000, port, bool(group), *(int(each) for each in (group or "0.0.0.0").split(".")))
    return struct.pack("<HH", 1, len(data)) + data


SEEN: list[Place] = [(0.1, 1.5, -0.9), (0.2, 1.25, -0.75)]
HIDDEN: list[Place] = [(0.3, 1.0, 0.0)]
OTHERS: list[Place] = [(0.2, 1.25, -0.75), (-0.5, 0.25, 2.0)]


@pytest.mark.parametrize("version", VERSIONS)
def test_each_version_gives_every_seen_marker_once(version: tuple[int, int]) -> None:
    frame = frame_of_packet(packet(version, 1234, 7.25, SEEN, HIDDEN if version >= (2, 6) else [], OTHERS), version, 3.0)
    assert frame is not None
    assert (frame.number, frame.time, frame.arrived) == (1234, 7.25, 3.0)
    np.testing.assert_allclose(frame.points, [*SEEN, OTHERS[1]], atol=1e-6)
    empty = frame_of_packet(packet(version, 0, 0.0, [], [], []), version, 0.0)
    assert empty is not None and empty.points.shape == (0, 3)


@settings(max_examples=200)
@given(st.data())
def test_damaged_packets_give_a_frame_or_none_at_once(data: st.DataObject) -> None:
    version = data.draw(st.sampled_from(VERSIONS))
    damaged = bytearray(packet(version, 5, 1.0, SEEN, HIDDEN, OTHERS))
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(4, len(damaged) - 1))
        kind = data.draw(st.sampled_from(["cut", "large", "negative", "any"]))
        if kind == "cut":
            del damaged[at:]
            damaged += b"\0" * max(0, 5 - len(damaged))
        elif kind == "any":
            damaged[at] = data.draw(st.integers(0, 255))
        else:
            # Numbers of elements that no packet holds.
            damaged[at : at + 4] = struct.pack("<i", 2**31 - 1 if kind == "large" else -1)
    damaged[2:4] = struct.pack("<H", len(damaged) - 4)
    frame = frame_of_packet(bytes(damaged), data.draw(st.sampled_from([version, (3, 0), (4, 1)])), 0.0)
    assert frame is None or (np.isfinite(frame.points).all() and len(frame.points) <= 2000)


@given(st.binary(max_size=600))
def test_noise_is_neither_a_frame_nor_a_server(data: bytes) -> None:
    assert server_of_packet(data) is None or data[:2] == b"\1\0"
    assert frame_of_packet(data, (3, 0), 0.0) is None or data[:2] == b"\7\0"


class Motive(threading.Thread):
    """A server that greets, and then sends what it is given to whoever greeted."""

    def __init__(self, version: tuple[int, int], packets: Sequence[bytes]) -> None:
        super().__init__(daemon=True)
        self.version, self.packets, self.heard = version, packets, list[int]()
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(10)
        self.port = self.socket.getsockname()[1]

    def run(self) -> None:
        data, client = self.socket.recvfrom(2048)
        self.heard.append(struct.unpack_from("<H", data)[0])
        self.socket.sendto(b"\x08\0\1\0x", client)
        self.socket.sendto(greeting(self.version), client)
        for each in self.packets:
            self.socket.sendto(each, client)
        self.socket.close()


@pytest.fixture
def motive() -> Iterator[Motive]:
    version = (3, 1)
    sent = [packet(version, n, n / 120, SEEN, HIDDEN, OTHERS) for n in range(3)]
    server = Motive(version, [sent[0], b"\7\0\4\0bad!", sent[1], sent[2]])
    server.start()
    yield server
    server.join(timeout=10)


def test_a_server_that_sends_to_each_client_is_greeted_and_read(motive: Motive) -> None:
    source = open_source(f"natnet://127.0.0.1:{motive.port}", 120.0)
    frames: list[LiveFrame] = []
    while len(frames) < 3 and (frame := source.read(5.0)) is not None:
        frames.append(frame)
    assert [frame.number for frame in frames] == [0, 1, 2] and source.damaged == 1
    assert motive.heard == [0], "greeted once"
    assert source.about.name == "Motive 2.3 at 127.0.0.1" and source.about.rate == 120.0
    assert source.about.vertical is not None and source.about.vertical.tolist() == [0, 1, 0]
    source.close()
    assert source.read(0.05) is None


def test_nobody_there_is_told_with_what_to_switch_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("asterism.live.natnet._PATIENCE", 0.2)
    silent = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    silent.bind(("127.0.0.1", 0))
    with pytest.raises(AsterismError, match="switch on streaming"):
        open_source(f"natnet://127.0.0.1:{silent.getsockname()[1]}")
    silent.close()
    with pytest.raises(AsterismError, match="cannot be reached"):
        open_source("natnet://no.such.host.invalid")


def captured(path: Path) -> Iterator[bytes]:
    """The UDP payloads of a pcapng file."""
    data, at = path.read_bytes(), 0
    while at + 12 <= len(data):
        kind, size = struct.unpack_from("<II", data, at)
        if kind == 6:
            length = struct.unpack_from("<I", data, at + 20)[0]
            ethernet = data[at + 28 : at + 28 + length]
            if ethernet[12:14] == b"\x08\0" and ethernet[23] == 17:
                udp = ethernet[14 + 4 * (ethernet[14] & 15) :]
                yield udp[8 : struct.unpack_from(">H", udp, 4)[0]]
        at += size


def test_a_real_capture_is_what_the_vendors_own_client_printed(data: Path) -> None:
    folder = data / "live" / "natnet"
    if not folder.is_dir():
        pytest.skip("there is no capture of Motive in ASTERISM_DATA")
    packets = list(captured(folder / "traffic.pcapng"))
    (server,) = {found for each in packets if (found := server_of_packet(each)) is not None}
    assert (server.name, server.stream, server.group) == ("Motive", (3, 0), "239.255.42.99")
    of_frames = [each for each in packets if each[:2] == b"\7\0"]
    frames = {frame.number: frame for each in of_frames if (frame := frame_of_packet(each, server.stream, 0.0)) is not None}
    assert len(frames) == len(of_frames) == 518
    printed = re.split(r"FrameID : ", (folder / "SampleClient_output.txt").read_text("utf-8-sig"))[1:]
    assert len(printed) == 251
    for text in printed:
        frame = frames[int(text.split()[0])]
        markers = re.findall(r"Occluded=0.*?pos=([-\d.]+),([-\d.]+),([-\d.]+)\]", text)
        # Printed with two digits, so that half of the last one may differ.
        np.testing.assert_allclose(frame.points, np.array(markers, dtype=float), atol=0.00501)
