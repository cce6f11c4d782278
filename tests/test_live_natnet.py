"""Motive's stream, written by the test for each version, damaged, sent by a server of the test's own, and as it was really captured."""

from __future__ import annotations

import os
import re
import socket
import struct
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from waiting import taken

from asterism import AsterismError
from asterism.live import LiveRecorder, open_source, recording_of
from asterism.live.analog import AnalogDevice, AnalogSamples, channels_of_frames
from asterism.live.natnet import AnalogNumbers
from asterism.live.natnet_packets import NatNetFrames, server_of_packet

VERSIONS = [(2, 5), (2, 6), (2, 7), (2, 9), (2, 10), (2, 11), (3, 0), (3, 1), (4, 0), (4, 1), (4, 2), (4, 5)]
Place = tuple[float, float, float]
Version = tuple[int, int]
OCCLUDED, BY_CAMERAS, BY_MODEL, HAS_MODEL, UNLABELLED = 1, 2, 4, 8, 16


def part(version: Version, count: int, content: bytes) -> bytes:
    return struct.pack("<i", count) + (struct.pack("<i", len(content)) if version >= (4, 1) else b"") + content


def rigid_body(version: Version, more: bytes = b"") -> bytes:
    body = struct.pack("<i7f", 1, *[0.5] * 7)
    if version < (3, 0):
        body += struct.pack("<i", 2) + struct.pack("<6f2i2f", *[0.1] * 6, 1, 2, 0.01, 0.01)
    return body + struct.pack("<f", 0.001) + (struct.pack("<H", 1) if version >= (2, 6) else b"") + more


def marker(version: Version, number: int, place: Place, flags: int, more: bytes = b"") -> bytes:
    content = struct.pack("<i4f", number, *place, 0.014) + (struct.pack("<H", flags) if version >= (2, 6) else b"")
    return content + (struct.pack("<f", 0.0) if version >= (3, 0) else b"") + more


def packet(
    version: Version,
    number: int,
    at: float,
    seen: Sequence[Place],
    hidden: Sequence[Place],
    others: Sequence[Place],
    *,
    latency: bool = False,
    more: bytes = b"",
) -> bytes:
    """A frame as Motive sends it: one marker set, one rigid body, a skeleton, and a force plate where there may be one.

    latency  whether a latency stands before the time code, as the vendor's C++ example of versions before 3 has it
    more     what a later version has behind each body and marker
    """
    data = struct.pack("<i", number)
    data += part(version, 1, b"Rigid Body 1\0" + struct.pack("<i3f", 1, 9.0, 9.0, 9.0))
    data += part(version, len(others), b"".join(struct.pack("<3f", *place) for place in others))
    data += part(version, 1, rigid_body(version, more))
    data += part(version, 1, struct.pack("<ii", 3, 2) + 2 * rigid_body(version, more))
    if version >= (4, 1):
        asset = struct.pack("<ii", 5, 1) + struct.pack("<i8fH", 1, *[0.5] * 8, 1) + more
        data += part(version, 1, asset + struct.pack("<i", 1) + struct.pack("<i4fHf", 1, *[8.0] * 4, 0, 0.0) + more)
    markers = [marker(version, n + (2 << 16), place, BY_CAMERAS | HAS_MODEL, more) for n, place in enumerate(seen)]
    markers += [marker(version, 9 + (2 << 16), place, OCCLUDED | BY_MODEL | HAS_MODEL, more) for place in hidden]
    data += part(version, len(markers), b"".join(markers))
    for since in ((2, 9), (2, 11)):
        if version >= since:
            data += part(version, 1, struct.pack("<ii", 7, 2) + 2 * struct.pack("<i3f", 3, 1.0, 2.0, 3.0) + more)
    data += struct.pack("<f", 0.004) if latency else b""
    data += struct.pack("<II", 0, 0) + struct.pack("<d" if version >= (2, 7) else "<f", at)
    data += struct.pack("<3Q", 1, 2, 3) if version >= (3, 0) else b""
    data += struct.pack("<2I", 4, 5) if version >= (4, 1) else b""
    data += struct.pack("<Hi", 0, 0)
    return struct.pack("<HH", 7, len(data)) + data


def greeting(version: Version, group: str = "", port: int = 1511) -> bytes:
    data = b"Motive".ljust(256, b"\0") + bytes([2, 3, 0, 0]) + bytes([*version, 0, 0])
    if version >= (3, 0):
        data += struct.pack("<QHB4B", 10_000_000, port, bool(group), *(int(each) for each in (group or "0.0.0.0").split(".")))
    return struct.pack("<HH", 1, len(data)) + data


SEEN: list[Place] = [(0.1, 1.5, -0.9), (0.2, 1.25, -0.75)]
HIDDEN: list[Place] = [(0.3, 1.0, 0.0)]
OTHERS: list[Place] = [(0.2, 1.25, -0.75), (-0.5, 0.25, 2.0)]


@pytest.mark.parametrize("version", VERSIONS)
def test_each_version_gives_every_seen_marker_once(version: Version) -> None:
    for latency in (False, True) if version < (3, 0) else (False,):
        frames = NatNetFrames(version)
        sent = packet(version, 1234, 7.25, SEEN, HIDDEN if version >= (2, 6) else [], OTHERS, latency=latency)
        frame = frames.frame(sent, 3.0)
        assert frame is not None
        assert (frame.number, frame.time, frame.arrived) == (1234, 7.25, 3.0)
        np.testing.assert_allclose(frame.points, [*SEEN, OTHERS[1]], atol=1e-6)
        assert (frames.used, frames.sure, frames.labelled, frames.contradiction) == (version, True, True, "")
        names = [name for name, since in (("force plate 7", (2, 9)), ("device 7", (2, 11))) if version >= since]
        assert [part.device.name for part in frame.analog] == names
        assert all(part.values.tolist() == [[1.0, 1.0], [2.0, 2.0], [3.0, 3.0]] for part in frame.analog)
        empty = NatNetFrames(version).frame(packet(version, 0, 0.0, [], [], [], latency=latency), 0.0)
        assert empty is not None and empty.points.shape == (0, 3)


@pytest.mark.parametrize("version", VERSIONS)
def test_another_client_reads_the_packets_of_these_tests_alike(version: Version) -> None:
    """It knows no latency, and no version before 3 with one."""
    data_frame = pytest.importorskip("natnet.data_frame", reason="the package natnet is the judge of these packets")
    packet_buffer, versions = pytest.importorskip("natnet.packet_buffer"), pytest.importorskip("natnet.version")
    sent = packet(version, 1234, 7.25, SEEN, HIDDEN if version >= (2, 6) else [], OTHERS)
    theirs = data_frame.DataFrame.read_from_buffer(packet_buffer.PacketBuffer(sent[4:]), versions.Version(*version))
    ours = NatNetFrames(version).frame(sent, 0.0)
    assert ours is not None and (theirs.prefix.frame_number, theirs.suffix.timestamp) == (ours.number, ours.time)
    markers = [each.pos for each in theirs.labeled_markers if version < (2, 6) or not each.occluded]
    assert {tuple(np.round(place, 5)) for place in (*markers, *theirs.unlabeled_marker_pos)} == {
        tuple(row) for row in np.round(ours.points, 5)
    }


def test_a_marker_that_only_the_model_gives_is_no_point() -> None:
    places: list[Place] = [(0.1 * n, 1.0, 0.0) for n in range(1, 6)]
    flags = [BY_CAMERAS, BY_CAMERAS | BY_MODEL, BY_MODEL, OCCLUDED | BY_CAMERAS, UNLABELLED]
    markers = b"".join(marker((3, 0), n, place, flag) for n, (place, flag) in enumerate(zip(places, flags, strict=True)))
    data = struct.pack("<5i", 1, 0, 0, 0, 0) + struct.pack("<i", 5) + markers + struct.pack("<2i2Id3QHi", 0, 0, 0, 0, 1.0, 1, 2, 3, 0, 0)
    frames = NatNetFrames((3, 0))
    frame = frames.frame(struct.pack("<HH", 7, len(data)) + data, 0.0)
    assert frame is not None and not frames.labelled
    np.testing.assert_allclose(frame.points, [places[0], places[1], places[4]], atol=1e-6)
    # Nor where the older list tells it, too.
    twice = NatNetFrames((2, 11)).frame(packet((2, 11), 1, 1.0, SEEN, HIDDEN, [*OTHERS, *HIDDEN]), 0.0)
    assert twice is not None
    np.testing.assert_allclose(twice.points, [*SEEN, OTHERS[1]], atol=1e-6)


@pytest.mark.parametrize(("told", "sent", "latency"), [((3, 0), (2, 10), True), ((2, 9), (4, 1), False), ((4, 2), (3, 1), False)])
def test_a_server_that_says_another_version_than_it_sends_is_read_and_told(told: Version, sent: Version, latency: bool) -> None:
    frames = NatNetFrames(told)
    for number in range(3):
        frame = frames.frame(packet(sent, number, 1.0 + number, SEEN, HIDDEN, OTHERS, latency=latency), 0.0)
        assert frame is not None and (frame.number, frame.time) == (number, 1.0 + number)
        np.testing.assert_allclose(frame.points, [*SEEN, OTHERS[1]], atol=1e-6)
    assert frames.used is not None and frames.used != told and "but its packets are those of" in frames.contradiction
    # Damaged ones are not tried as other versions, and a server of another one that takes over is read after a few frames.
    assert frames.frame(packet(sent, 4, 1.0, SEEN, HIDDEN, OTHERS)[:-9], 0.0) is None
    other = (3, 0) if sent != (3, 1) else (4, 1)
    got = [frames.frame(packet(other, number, 1.0, SEEN, HIDDEN, OTHERS), 0.0) for number in range(8)]
    assert got[0] is None and got[-1] is not None and got[-1].number == 7


def test_a_later_version_is_read_by_the_sizes_of_its_parts_and_told() -> None:
    frames = NatNetFrames((5, 0))
    frame = frames.frame(packet((5, 0), 7, 2.5, SEEN, HIDDEN, OTHERS, more=b"new!"), 0.0)
    assert frame is not None and (frame.number, frame.time) == (7, 2.5)
    np.testing.assert_allclose(frame.points, [*SEEN, OTHERS[1]], atol=1e-6)
    assert "later than" in frames.contradiction
    # One that has changed nothing is read as the last known.
    assert NatNetFrames((4, 9)).frame(packet((4, 9), 7, 2.5, SEEN, HIDDEN, OTHERS), 0.0) is not None


@settings(max_examples=200)
@given(st.data())
def test_damaged_packets_give_a_frame_or_none_at_once(data: st.DataObject) -> None:
    version = data.draw(st.sampled_from(VERSIONS))
    reader = NatNetFrames(data.draw(st.sampled_from([version, (3, 0), (4, 1), (5, 1)])))
    reader.frame(packet(version, 4, 1.0, SEEN, HIDDEN, OTHERS), 0.0)
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
    frame = reader.frame(bytes(damaged), 0.0)
    assert frame is None or (np.isfinite(frame.points).all() and len(frame.points) <= 2000)


@given(st.binary(max_size=600))
def test_noise_is_neither_a_frame_nor_a_server(data: bytes) -> None:
    assert server_of_packet(data) is None or data[:2] == b"\1\0"
    assert NatNetFrames((3, 0)).frame(data, 0.0) is None or data[:2] == b"\7\0"


class Motive(threading.Thread):
    """A server: answers greetings and questions, and sends what it is given to whoever greeted.

    packets  after each greeting the next list is sent
    answers  to questions; others are not known to it
    group    to which it says that it sends, and the port there
    """

    group: tuple[str, int] = ("", 1511)

    def __init__(self, version: Version, packets: Sequence[Sequence[bytes]], answers: dict[bytes, bytes] | None = None) -> None:
        super().__init__(daemon=True)
        self.version, self.packets, self.answers, self.heard = version, list(packets), answers, list[int]()
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.port = self.socket.getsockname()[1]
        self.client = ("", 0)
        self.start()

    def run(self) -> None:
        while True:
            try:
                data, self.client = self.socket.recvfrom(2048)
            except OSError:
                return
            kind, _ = struct.unpack_from("<HH", data)
            self.heard.append(kind)
            if kind == 0:
                self.socket.sendto(b"\x08\0\1\0x", self.client)
                self.socket.sendto(greeting(self.version, *self.group), self.client)
                for each in self.packets.pop(0) if self.packets else ():
                    self.socket.sendto(each, self.client)
            elif kind == 2 and self.answers is not None:
                answer = self.answers.get(data[4:].rstrip(b"\0"))
                self.socket.sendto(struct.pack("<HH", 100, 0) if answer is None else struct.pack("<HH", 3, 4) + answer, self.client)


@pytest.fixture
def stranger() -> Iterator[socket.socket]:
    """Another machine, by address."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        try:
            other.bind(("127.0.0.2", 0))
        except OSError:
            pytest.skip("this system has one loopback address only")
        yield other


@pytest.fixture(autouse=True)
def _short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("asterism.live.natnet._ANSWER", 0.05)


def test_a_server_that_sends_to_each_client_is_greeted_and_read() -> None:
    version = (3, 1)
    sent = [packet(version, n, n / 120, SEEN, HIDDEN, OTHERS) for n in range(3)]
    server = Motive(version, [[sent[0], b"\7\0\4\0bad!", sent[1], sent[2]]])
    source = open_source(f"natnet://127.0.0.1:{server.port}", 120.0)
    assert [frame.number for frame in taken(source, 3)] == [0, 1, 2] and source.damaged == 1
    assert server.heard.count(0) == 1, "greeted once"
    assert source.about.name == "Motive 2.3 at 127.0.0.1" and source.about.rate == 120.0
    assert source.about.vertical is not None and source.about.vertical.tolist() == [0, 1, 0]
    codes = {finding.code for finding in source.findings()}  # type: ignore[attr-defined]
    assert codes == {"live-axis-unknown", "live-unit-unknown", "live-labels-given"}
    source.close()
    server.socket.close()
    assert source.read(0.05) is None


def test_a_group_is_joined_on_the_network_that_leads_to_the_server_and_others_in_it_are_told(stranger: socket.socket) -> None:
    server = Motive((3, 1), [])
    # Other processes of the tests have another port.
    server.group = ("239.255.42.97", 20_000 + os.getpid() % 20_000)
    source = open_source(f"natnet://127.0.0.1:{server.port}", 100.0)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.bind(("127.0.0.1", 0))
        for each in (stranger, sender):
            each.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
        for number in range(3):
            stranger.sendto(packet((3, 1), 90 + number, 0.0, OTHERS, [], []), server.group)
            sender.sendto(packet((3, 1), number, number / 100, SEEN, [], []), server.group)
        first = source.read(1.0)
        if first is None:
            source.close()
            server.socket.close()
            pytest.skip("this machine passes no multicast on over its loopback address")
        assert [frame.number for frame in (first, *taken(source, 2))] == [0, 1, 2]
    codes = {finding.code for finding in source.findings()}  # type: ignore[attr-defined]
    assert "live-other-server" in codes
    source.close()
    server.socket.close()


def test_a_server_that_answers_and_sends_by_two_interfaces_is_heard(monkeypatch: pytest.MonkeyPatch, stranger: socket.socket) -> None:
    monkeypatch.setattr("asterism.live.natnet._SILENT", 0.0)
    server = Motive((3, 1), [])
    source = open_source(f"natnet://127.0.0.1:{server.port}", 100.0)
    for number in range(3):
        stranger.sendto(packet((3, 1), number, number / 100, SEEN, [], []), server.client)
    assert [frame.number for frame in taken(source, 3)] == [0, 1, 2]
    server.socket.sendto(packet((3, 1), 3, 0.03, SEEN, [], []), server.client)
    assert [frame.number for frame in taken(source, 1)] == [3]
    stranger.sendto(packet((3, 1), 4, 0.04, SEEN, [], []), server.client)
    assert source.read(0.1) is None, "the server itself sends, too"
    source.close()
    server.socket.close()


def test_force_plates_and_devices_of_motive_are_recorded(tmp_path: Path) -> None:
    server = Motive((4, 1), [[packet((4, 1), n, 50 + n / 120, SEEN, [], []) for n in (9, 10, 12)]])
    source = open_source(f"natnet://127.0.0.1:{server.port}", 120.0)
    recorder = LiveRecorder(tmp_path / "x.live", "Motive", None, rate=120.0)
    for frame in taken(source, 3):
        recorder.frame(frame)
    recorder.close()
    source.close()
    server.socket.close()
    kept = recording_of(tmp_path / "x.live")
    found = channels_of_frames(kept.analog, kept.times, 120.0)
    assert [channel.name for channel in found.channels][1:3] == ["force plate 7 channel 2", "device 7 channel 1"]
    assert {channel.rate for channel in found.channels} == {360.0}
    assert found.channels[0].samples.tolist() == [1, 2, 3, 1, 2, 3, 0, 0, 0, 1, 2, 3], "of a frame that was lost the samples are, too"
    assert len(found.beside) == 2, "which is told"


def test_samples_that_have_no_steady_rate_are_counted_as_they_come() -> None:
    plate = AnalogDevice("plate", float("nan"), ("Fz",), ("",))
    numbers = AnalogNumbers(120.0)
    told = [numbers.numbered(AnalogSamples(plate, 0, np.zeros((count, 1))), n, n / 120) for n, count in enumerate((8, 8, 9, 8))]
    assert [(part.first, np.isnan(part.device.rate)) for part in told] == [(0, False), (8, False), (16, True), (25, True)]
    # A take that is played again begins anew.
    again, ten = AnalogNumbers(100.0), AnalogSamples(plate, 0, np.zeros((10, 1)))
    assert [again.numbered(ten, n, at).first for n, at in ((5, 1.0), (6, 1.01), (0, 9.0))] == [1000, 1010, 9000]


def test_motive_is_asked_for_its_rate_unit_and_axis() -> None:
    millimetres = [(1000 * x, 1000 * y, 1000 * z) for x, y, z in SEEN]
    answers = {b"FrameRate": struct.pack("<f", 240.0), b"UnitsToMillimeters": struct.pack("<f", 1.0), b"UpAxis": struct.pack("<i", 2)}
    # Times are 0 in some edited takes.
    server = Motive((3, 0), [[packet((3, 0), n, 0.0, millimetres, [], []) for n in range(5, 8)]], answers)
    source = open_source(f"natnet://127.0.0.1:{server.port}")
    assert source.about.rate == 240.0 and source.about.vertical is not None and source.about.vertical.tolist() == [0, 0, 1]
    frames = taken(source, 3)
    np.testing.assert_allclose(frames[0].points, SEEN, atol=1e-6)
    np.testing.assert_allclose([frame.time for frame in frames], [0.0, 1 / 240, 2 / 240])
    codes = {finding.code for finding in source.findings()}  # type: ignore[attr-defined]
    assert codes == {"live-labels-given", "live-no-times"}
    source.close()
    server.socket.close()


def test_a_motive_that_was_started_again_is_greeted_again_and_others_are_not_heard(
    monkeypatch: pytest.MonkeyPatch, stranger: socket.socket
) -> None:
    monkeypatch.setattr("asterism.live.natnet._SILENT", 0.1)
    monkeypatch.setattr("asterism.live.natnet._ALIVE", 0.1)
    first = [packet((3, 0), n, n / 100, SEEN, [], []) for n in range(2)]
    second = [packet((4, 1), n, n / 100, SEEN, [], []) for n in range(3)]
    server = Motive((3, 0), [first])
    source = open_source(f"natnet://127.0.0.1:{server.port}", 100.0)
    while server.client == ("", 0):
        time.sleep(0.01)
    stranger.sendto(packet((3, 0), 99, 0.99, OTHERS, [], []), server.client)
    frames = taken(source, 2)
    server.version, server.packets = (4, 1), [second]
    frames += taken(source, 3)
    assert [frame.number for frame in frames] == [0, 1, 0, 1, 2]
    codes = {finding.code for finding in source.findings()}  # type: ignore[attr-defined]
    assert "live-reconnected" in codes and "live-version" not in codes
    assert source.others == 1  # type: ignore[attr-defined]
    source.close()
    server.socket.close()


def test_nobody_there_is_told_with_what_to_switch_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("asterism.live.natnet._PATIENCE", 0.2)
    silent = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    silent.bind(("127.0.0.1", 0))
    with pytest.raises(AsterismError, match="switch on streaming"):
        open_source(f"natnet://127.0.0.1:{silent.getsockname()[1]}")
    silent.close()
    with pytest.raises(AsterismError, match="cannot be reached"):
        open_source("natnet://no.such.host.invalid")
    with pytest.raises(AsterismError, match=r"192.0.2.1 is no address of this machine"):
        open_source("natnet://127.0.0.1?local=192.0.2.1")


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
    frames = {frame.number: frame for each in of_frames if (frame := NatNetFrames(server.stream).frame(each, 0.0)) is not None}
    assert len(frames) == len(of_frames) == 518
    printed = re.split(r"FrameID : ", (folder / "SampleClient_output.txt").read_text("utf-8-sig"))[1:]
    assert len(printed) == 251
    for text in printed:
        frame = frames[int(text.split()[0])]
        markers = re.findall(r"Occluded=0.*?pos=([-\d.]+),([-\d.]+),([-\d.]+)\]", text)
        # Printed with two digits, so that half of the last one may differ.
        np.testing.assert_allclose(frame.points, np.array(markers, dtype=float), atol=0.00501)
