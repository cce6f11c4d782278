"""Vicon's stream: a server of the test's own, which Vicon's own client understands, read by ours; damaged; gone and come back."""

from __future__ import annotations

import contextlib
import importlib.util
import socket
import struct
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tcp_server import TcpServer
from waiting import taken

from asterism import AsterismError
from asterism.live import open_source
from asterism.live.frames import DamagedPacket
from asterism.live.vicon import ViconState

Place = tuple[float, float, float]
CONTENTS, SUBJECT, SEGMENTS, STREAM, FRAME, LABELLED, UNLABELLED, APPLICATION = 100004, 2, 9, 1, 5, 6, 7, 37
KINDS, REQUEST = 100001, 100002


def text(word: str) -> bytes:
    return struct.pack("<I", len(word)) + word.encode()


def thing(kind: int, content: bytes) -> bytes:
    return struct.pack("<II", kind, len(content)) + content


def packet(*objects: bytes) -> bytes:
    content = b"".join(objects)
    return struct.pack("<II", 0x1A2B0001, len(content)) + content


def labelled(places: Sequence[Place]) -> bytes:
    rows = (struct.pack("<IId3d9dI", 1, n, 7.0, *place, *np.eye(3).ravel(), n) for n, place in enumerate(places))
    return thing(LABELLED, struct.pack("<I", len(places)) + b"".join(rows))


def unlabelled(places: Sequence[Place], *, old: bool = False) -> bytes:
    """Earlier versions told no number of the trajectory."""
    rows = (struct.pack("<d3d9d", 7.0, *place, *np.eye(3).ravel()) + (b"" if old else struct.pack("<I", 9)) for place in places)
    return thing(UNLABELLED, struct.pack("<I", len(places)) + b"".join(rows))


def contents(unchanged: Sequence[int] = ()) -> bytes:
    return thing(CONTENTS, struct.pack("<III", 1, FRAME, 1) + struct.pack(f"<I{len(unchanged)}I", len(unchanged), *unchanged))


def described(period: int, axis: int) -> list[bytes]:
    return [thing(STREAM, struct.pack("<q", period)), thing(APPLICATION, struct.pack("<b", axis))]


SUBJECT_WAND = thing(
    SUBJECT,
    struct.pack("<I", 1) + text("wand") + struct.pack("<III6f", 1, 0, 1, *[0.0] * 6) + text("wand") + struct.pack("<II", 0, 0),
)
SEGMENTS_WAND = thing(SEGMENTS, struct.pack("<III3d9d", 1, 1, 1, 1000.0, 250.0, -500.0, *np.eye(3).ravel()))


class DataStream(TcpServer):
    """A server: tells what it has, and sends to whoever asks for frames as long as there are some.

    frames  called again and again with what the client asked for, and how often one connected; gives packets
    """

    def __init__(self, frames: Callable[[set[int], int], Sequence[bytes]], offers: Sequence[int] = ()) -> None:
        self.frames, self.asked, self.requests, self.connections = frames, set[int](), list[bytes](), 0
        self.offers = offers or (CONTENTS, SUBJECT, 8, SEGMENTS, STREAM, FRAME, LABELLED, UNLABELLED, APPLICATION)
        super().__init__()

    def serve(self, client: socket.socket) -> None:
        client.sendall(packet(thing(KINDS, struct.pack(f"<I{len(self.offers)}I", len(self.offers), *self.offers))))
        streams, self.asked, self.connections = False, set(), self.connections + 1
        while True:
            client.settimeout(0.01 if streams else 20.0)
            with contextlib.suppress(TimeoutError):
                streams = self.heard(client) or streams
            if streams:
                for each in self.frames(self.asked, self.connections):
                    client.sendall(each)

    def heard(self, client: socket.socket) -> bool:
        """Whether the client asks for frames now."""
        head = client.recv(8, socket.MSG_WAITALL)
        kind, size = struct.unpack("<II", head)
        assert kind == 0x1A2B0001
        content, at, asks = client.recv(size, socket.MSG_WAITALL), 0, False
        while at < size:
            kind, length = struct.unpack_from("<II", content, at)
            own = content[at + 8 : at + 8 + length]
            if kind == KINDS:
                self.asked = set(struct.unpack_from(f"<{struct.unpack_from('<I', own)[0]}I", own, 4))
            if kind == REQUEST:
                self.requests.append(own)
                asks = asks or own == b"\1"
            at += 8 + length
        return asks


SEEN: list[Place] = [(100.0, 200.0, 900.0), (55.0, 66.0, 77.0)]
OTHERS: list[Place] = [(100.0, 200.0, 900.0), (-400.0, 5.0, 1200.0)]


VENDORS_CLIENT = """
import sys, motioncapture
client = motioncapture.connect("vicon", {"hostname": "127.0.0.1:" + sys.argv[1]})
for _ in range(200):
    client.waitForNextFrame()
    if client.rigidBodies:
        print(*(round(float(value), 6) for value in client.rigidBodies["wand"].position), flush=True)
        break
"""


@pytest.mark.skipif(importlib.util.find_spec("motioncapture") is None, reason="motioncapture has Vicon's own client in it")
def test_vicons_own_client_understands_the_server_of_these_tests() -> None:
    """What follows is worth something only if the server speaks as Vicon's do."""
    number = iter(range(1, 100_000))

    def frames(asked: set[int], connection: int) -> list[bytes]:
        objects = [contents(), *described(1_350_000, 0), SUBJECT_WAND, thing(FRAME, struct.pack("<I", next(number))), SEGMENTS_WAND]
        objects += [labelled(SEEN), unlabelled(OTHERS)]
        return [packet(*(each for each in objects if struct.unpack_from("<I", each)[0] in asked))]

    server = DataStream(frames)
    try:
        words = [sys.executable, "-c", VENDORS_CLIENT, str(server.port)]
        done = subprocess.run(words, capture_output=True, text=True, timeout=60, check=False)
    finally:
        server.socket.close()
    assert done.stdout.split() == ["1.0", "0.25", "-0.5"], done.stderr
    assert {SUBJECT, FRAME, STREAM, UNLABELLED, SEGMENTS, CONTENTS} <= server.asked and b"\1" in server.requests


def test_markers_with_and_without_labels_are_read_and_taken_up_again() -> None:
    begin = {1: 500, 2: 3}

    def frames(asked: set[int], connection: int) -> list[bytes]:
        first = begin.pop(connection, 0)
        if not first:
            return []
        head = packet(contents(), *described(675_000, 1), thing(FRAME, struct.pack("<I", first)), labelled(SEEN), unlabelled(OTHERS))
        # What is as in the frame before is not sent again.
        same = packet(contents([LABELLED, STREAM]), thing(FRAME, struct.pack("<I", first + 1)), unlabelled([(1.0, 2.0, 3.0)], old=True))
        damaged = packet(contents(), thing(FRAME, b"\0\0"), labelled(SEEN))
        gone = packet(contents(), thing(FRAME, struct.pack("<I", first + 3)))
        if first == 500:
            # A head that is none: nobody knows where the next packet begins.
            return [head, same, damaged, gone, b"\0" * 64]
        return [head, same]

    server = DataStream(frames)
    source = open_source(f"vicon://127.0.0.1:{server.port}")
    try:
        got = taken(source, 5)
        assert [frame.number for frame in got] == [500, 501, 503, 3, 4]
        np.testing.assert_allclose([frame.time for frame in got], [0.0, 0.005, 0.015, 0.0, 0.005])
        np.testing.assert_allclose(got[0].points, [(0.1, 0.2, 0.9), (0.055, 0.066, 0.077), (-0.4, 0.005, 1.2)], atol=1e-9)
        np.testing.assert_allclose(got[1].points, [(0.1, 0.2, 0.9), (0.055, 0.066, 0.077), (0.001, 0.002, 0.003)], atol=1e-9)
        assert got[2].points.shape == (0, 3)
        assert source.about.rate == 200.0 and source.damaged == 2
        assert source.about.vertical is not None and source.about.vertical.tolist() == [0, 1, 0]
        codes = {finding.code for finding in source.findings()}  # type: ignore[attr-defined]
        assert codes == {"live-reconnected", "live-labels-given"}
        assert server.asked == {CONTENTS, STREAM, FRAME, LABELLED, UNLABELLED, APPLICATION}
    finally:
        source.close()
        server.socket.close()
    assert source.read(0.01) is None


def test_a_server_without_frames_or_markers_is_told() -> None:
    silent = DataStream(lambda asked, connection: [], (CONTENTS, FRAME, LABELLED))
    source = open_source(f"vicon://127.0.0.1:{silent.port}", 100.0)
    told = {finding.code: finding for finding in source.findings()}  # type: ignore[attr-defined]
    assert set(told) == {"live-idle", "live-not-streamed"} and source.about.rate == 100.0
    source.close()
    silent.socket.close()
    bare = DataStream(lambda asked, connection: [], (CONTENTS, FRAME, SEGMENTS))
    with pytest.raises(AsterismError, match="offers no markers"):
        open_source(f"vicon://127.0.0.1:{bare.port}")
    bare.socket.close()


def test_nobody_and_something_else_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    other = socket.create_server(("127.0.0.1", 0))
    port = other.getsockname()[1]

    def answer() -> None:
        client, _ = other.accept()
        with client:
            client.sendall(b"HTTP/1.1 400 Bad Request\r\n\r\n")

    threading.Thread(target=answer, daemon=True).start()
    with pytest.raises(AsterismError, match="is not Vicon's DataStream"):
        open_source(f"vicon://127.0.0.1:{port}")
    other.close()
    with pytest.raises(AsterismError, match="no Vicon program answers"):
        open_source(f"vicon://127.0.0.1:{port}")


@settings(max_examples=150)
@given(st.data())
def test_damaged_packets_give_a_frame_or_are_refused_at_once(data: st.DataObject) -> None:
    whole = packet(contents([LABELLED]), *described(1_350_000, 0), thing(FRAME, struct.pack("<I", 5)), labelled(SEEN), unlabelled(OTHERS))[
        8:
    ]
    state = ViconState()
    state.frame(whole, 0.0)
    damaged = bytearray(whole)
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, max(0, len(damaged) - 1)))
        kind = data.draw(st.sampled_from(["cut", "zero", "large", "any"]))
        if kind == "cut":
            del damaged[at:]
        elif kind == "any":
            damaged[at : at + 1] = bytes([data.draw(st.integers(0, 255))])
        else:
            damaged[at : at + 4] = struct.pack("<I", 0 if kind == "zero" else 2**32 - 1)
    with contextlib.suppress(DamagedPacket):
        found = state.frame(bytes(damaged), 0.0)
        assert found is None or np.isfinite(found[0].points).all()
