"""Qualisys Track Manager's stream: packets against the vendor's own parser, and a server that speaks the protocol as it is documented."""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tcp_server import TcpServer
from waiting import LONG, taken

from asterism import AsterismError
from asterism.cameras.files.qualisys import read_qualisys, write_qualisys
from asterism.live import HostPort, LiveRecorder, open_source, recording_of
from asterism.live.analog import write_analog
from asterism.live.blobs import RigSource
from asterism.live.qtm_packets import QtmSettings, blobs_of_packet, points_of_packet, settings_of_xml
from asterism.live.sources import blobs_of
from asterism.simulation.cameras.rigs import ring_rig

qtm_rt = pytest.importorskip("qtm_rt", reason="the vendor's package qtm-rt is the judge of these packets")

Place = tuple[float, float, float]
NAN = (float("nan"),) * 3
XML = """<QTM_Parameters_Ver_1.20>
 <General><Frequency>{rate}</Frequency>
  <Camera><ID>1</ID><Model>Miqus M3</Model><Serial>21001</Serial></Camera>
  <Camera><ID>2</ID><Model>Miqus M3</Model><Serial>21002</Serial></Camera>
 </General>
 <The_3D><AxisUpwards>{up}</AxisUpwards><Labels>3</Labels>
  <Label><Name>H\u00f6ft</Name><Trajectory_Type>Measured</Trajectory_Type></Label>
  <Label><Name>knee</Name><Trajectory_Type>Measured</Trajectory_Type></Label>
  <Label><Name>joint</Name><Trajectory_Type>Virtual</Trajectory_Type></Label>
 </The_3D>
 <Analog><Device><Device_ID>1</Device_ID><Device_Name>EMG</Device_Name><Channels>2</Channels><Frequency>1000</Frequency>
  <Channel><Label>soleus</Label><Unit>V</Unit></Channel><Channel><Label>tibialis</Label><Unit>V</Unit></Channel>
 </Device></Analog>
</QTM_Parameters_Ver_1.20>"""


def component(kind: int, content: bytes) -> bytes:
    return struct.pack("<II", len(content) + 8, kind) + content


def points_component(kind: int, places: Sequence[Place]) -> bytes:
    tail = {1: b"", 9: struct.pack("<f", 0.5), 2: struct.pack("<I", 7), 10: struct.pack("<If", 7, 0.5)}[kind]
    return component(kind, struct.pack("<IHH", len(places), 3, 4) + b"".join(struct.pack("<3f", *place) + tail for place in places))


def blobs_component(kind: int, cameras: Sequence[Sequence[tuple[int, int, int, int]]]) -> bytes:
    content = struct.pack("<IHH", len(cameras), 0, 0)
    for blobs in cameras:
        content += struct.pack("<IB", len(blobs), 1) + b"".join(struct.pack("<iiHH", *blob) for blob in blobs)
    return component(kind, content)


def analog_component(first: int, values: Sequence[Sequence[float]], device: int = 1) -> bytes:
    """A device without samples, and one whose channels come one after the other."""
    count = len(values[0])
    samples = struct.pack("<IIII", device, len(values), count, first) + b"".join(struct.pack(f"<{count}f", *channel) for channel in values)
    return component(3, struct.pack("<I", 2) + struct.pack("<III", 9, 6, 0) + samples)


def data_packet(number: int, *components: bytes, stamp: int | None = None) -> bytes:
    return struct.pack("<qII", 10_000 * number if stamp is None else stamp, number, len(components)) + b"".join(components)


LABELLED: list[Place] = [(100.0, 200.0, 900.0), NAN, (55.0, 66.0, 77.0)]
OTHERS: list[Place] = [(100.0, 200.0, 900.0), (-400.0, 5.0, 1200.0)]


@pytest.mark.parametrize(("labels", "no_labels"), [(1, 2), (9, 10), (None, 2), (None, 10), (1, None)])
def test_points_are_those_that_the_vendors_parser_reads(labels: int | None, no_labels: int | None) -> None:
    parts = [] if labels is None else [points_component(labels, LABELLED)]
    parts += [] if no_labels is None else [points_component(no_labels, OTHERS)]
    # A part of another kind in between, and one that no version knows yet.
    packet = data_packet(12, component(5, bytes(8)), *parts)
    theirs = qtm_rt.QRTPacket(packet)
    read = {1: "get_3d_markers", 9: "get_3d_markers_residual", 2: "get_3d_markers_no_label", 10: "get_3d_markers_no_label_residual"}
    expected = {
        tuple(round(value / 1000, 6) for value in marker[:3])
        for kind in (labels, no_labels)
        if kind is not None
        for marker in getattr(theirs, read[kind])()[1]
        if marker[0] == marker[0]
    }
    for more in (b"", component(77, b"later")):
        whole = data_packet(12, component(5, bytes(8)), *parts, *([more] if more else []))
        ours = points_of_packet(whole, 3.0)
        assert ours is not None and ours.frame is not None
        assert (ours.frame.number, ours.frame.time, ours.frame.arrived) == (12, 0.12, 3.0)
        assert {tuple(point) for point in np.round(ours.frame.points, 6).tolist()} == expected
        assert len(ours.frame.points) == len(expected), "a point that both lists have is one point"
        assert ours.labelled == (2 if labels else 0)


def test_virtual_markers_are_left_out_where_the_settings_are_of_these_labels() -> None:
    packet = data_packet(1, points_component(1, LABELLED))
    seen = points_of_packet(packet, 0.0, QtmSettings(computed=(False, False, True)))
    other = points_of_packet(packet, 0.0, QtmSettings(computed=(False, True)))
    assert seen is not None and seen.frame is not None and other is not None and other.frame is not None
    np.testing.assert_allclose(seen.frame.points, [(0.1, 0.2, 0.9)], atol=1e-6)
    assert len(other.frame.points) == 2


def test_blobs_are_those_that_the_vendors_parser_reads_in_pixels() -> None:
    cameras = [[(64, 128, 320, 192), (82_943, 65_535, 64, 64)], [], [(-1, 0, 0, 0)]]
    packet = data_packet(8, blobs_component(8, [[(1, 1, 1, 1)]]), blobs_component(7, cameras))
    theirs = qtm_rt.QRTPacket(packet).get_2d_markers()[1]
    assert [[tuple(marker) for marker in camera] for camera in theirs] == cameras
    ours = blobs_of_packet(packet, 2.0, ("21001", "21002"))
    assert ours is not None
    assert [(blobs.camera, blobs.number, blobs.time) for blobs in ours] == [("21001", 8, 0.08), ("21002", 8, 0.08), ("3", 8, 0.08)]
    # 64 sub-pixels are a pixel: 1,296 x 1,024 of them end at 82,943 and 65,535.
    np.testing.assert_allclose(ours[0].xy, [(1.0, 2.0), (1295.984375, 1023.984375)])
    np.testing.assert_allclose(ours[0].sizes, [4.0, 1.0])
    assert ours[1].xy.shape == (0, 2)
    assert blobs_of_packet(data_packet(1, points_component(1, LABELLED)), 0.0, ()) is None


def test_analog_samples_are_those_that_the_vendors_parser_reads_and_are_recorded(tmp_path: Path) -> None:
    parts = [points_component(2, OTHERS), analog_component(500, [[0.5, 1.5, 2.5], [-1.0, -2.0, -3.0]])]
    packet = data_packet(50, *parts)
    theirs = qtm_rt.QRTPacket(packet).get_analog()[1]
    ours = points_of_packet(packet, 0.0, settings_of_xml(XML.format(rate=100, up="+Z").encode()))
    assert ours is not None and ours.frame is not None
    (emg,) = ours.analog
    assert [(sample.sample_number, channel.samples) for _, sample, channel in theirs] == [(emg.first, tuple(row)) for row in emg.values.T]
    assert (emg.device.name, emg.device.rate, emg.device.channels, emg.device.units) == ("EMG", 1000.0, ("soleus", "tibialis"), ("V", "V"))
    # A packet of samples only is no frame, and none that is damaged.
    alone = points_of_packet(data_packet(51, parts[1]), 0.0)
    assert alone is not None and alone.frame is None and alone.analog[0].device.name == "device 1"
    recorder = LiveRecorder(tmp_path / "walk.live", "QTM", None)
    for n in range(3):
        recorder.frame(replace(ours.frame, number=50 + n, time=0.5 + 0.01 * n, analog=(replace(emg, first=500 + 10 * n),)))
    recorder.close()
    kept = recording_of(tmp_path / "walk.live")
    (device,) = kept.analog
    assert device.samples.tolist() == [500, 501, 502, 510, 511, 512, 520, 521, 522] and device.device == emg.device
    write_analog(tmp_path / "walk.analog.npz", kept.analog, kept.times)
    with np.load(tmp_path / "walk.analog.npz") as written:
        np.testing.assert_allclose(written["EMG.values"], np.tile(emg.values, (3, 1)))
        np.testing.assert_allclose(written["frame_times"], [0.5, 0.51, 0.52])
        assert written["EMG.channels"].tolist() == ["soleus", "tibialis"] and written["EMG.rate"] == 1000


@settings(max_examples=150)
@given(st.data())
def test_damaged_packets_give_a_frame_or_none_at_once(data: st.DataObject) -> None:
    parts = [points_component(9, LABELLED), points_component(2, OTHERS), analog_component(3, [[1.0], [2.0]])]
    packet = bytearray(data_packet(5, *parts, blobs_component(7, [[(1, 2, 3, 4)]] * 3)))
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, max(0, len(packet) - 1)))
        kind = data.draw(st.sampled_from(["cut", "zero", "large", "any"]))
        if kind == "cut":
            del packet[at:]
        elif kind == "any":
            packet[at : at + 1] = bytes([data.draw(st.integers(0, 255))])
        else:
            packet[at : at + 4] = struct.pack("<I", 0 if kind == "zero" else 2**32 - 1)
    points = points_of_packet(bytes(packet), 0.0, settings_of_xml(XML.format(rate=100, up="+Z").encode()))
    assert points is None or points.frame is None or np.isfinite(points.frame.points).all()
    blobs = blobs_of_packet(bytes(packet), 0.0, ("a",))
    assert blobs is None or all(np.isfinite(each.xy).all() for each in blobs)


def test_settings_that_are_damaged_stay_unknown() -> None:
    known = settings_of_xml(XML.format(rate=200, up="-Y").encode("latin-1"))
    assert (known.rate, known.computed, known.cameras) == (200.0, (False, False, True), ("21001", "21002"))
    assert known.vertical is not None and known.vertical.tolist() == [0, -1, 0]
    bomb = '<!DOCTYPE a [<!ENTITY b "c">]><a><General><Frequency>9</Frequency></General></a>'
    for text in ("", "Parameters not available", XML[:200], bomb, XML.format(rate="fast", up="up"), XML.format(rate="-1", up="")):
        unknown = settings_of_xml(text.encode())
        assert unknown.rate != unknown.rate and unknown.vertical is None


class QtmServer(TcpServer):
    """Speaks the protocol: a welcome, then answers to commands, and frames when they are asked for.

    versions  of the protocol that it knows
    xml       its settings
    frames    called with what is to be streamed; its packets (type and content) are sent one after the other
    """

    def __init__(self, frames: Callable[[str], Iterator[tuple[int, bytes]]], xml: str, versions: Sequence[str] = ("1.20",)) -> None:
        self.frames, self.xml, self.versions = frames, xml, versions
        self.heard, self.mute = list[str](), False
        super().__init__()

    def serve(self, client: socket.socket) -> None:
        guard, self.mute = threading.Lock(), False

        def say(kind: int, content: bytes) -> None:
            with guard:
                client.sendall(struct.pack("<II", 8 + len(content), kind) + content)

        def stream(components: str) -> None:
            with contextlib.suppress(OSError):
                for each in self.frames(components):
                    say(*each)
                client.shutdown(socket.SHUT_RDWR)

        say(1, b"QTM RT Interface connected\0")
        while head := client.recv(8, socket.MSG_WAITALL):
            size, kind = struct.unpack("<II", head)
            text = client.recv(size - 8, socket.MSG_WAITALL).rstrip(b"\0").decode()
            assert kind == 1
            self.heard.append(text)
            if self.mute:
                continue
            words = text.lower().split()
            if words[0] == "version":
                say(1, f"Version set to {words[1]}\0".encode()) if words[1] in self.versions else say(0, b"Version NOT supported\0")
            elif words[0] == "qtmversion":
                say(1, b"QTM Version is 2023.1 (build 9000)\0")
            elif words[0] == "getparameters":
                say(2, self.xml.encode("latin-1") + b"\0")
            elif words[0] == "streamframes":
                threading.Thread(target=stream, args=(" ".join(words[2:]),), daemon=True).start()
            else:
                say(0, b"Parse error\0")


def test_a_stream_is_read_and_taken_up_again_when_qtm_closes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("asterism.live.qtm._AGAIN", 0.01)
    begin, ended = iter((100, 400)), threading.Event()

    def frames(components: str) -> Iterator[tuple[int, bytes]]:
        assert components == "3d 3dnolabels analog"
        first = next(begin)
        for number in range(first, first + 30, 2):
            yield 3, data_packet(number, analog_component(10 * number, [[1.0], [2.0]]))
            yield 3, data_packet(number, points_component(1, LABELLED), points_component(2, OTHERS))
            yield 6, b"\x0b"
            if number == first + 20:
                yield 3, b"too short"
        if first == 400:
            yield 4, b""
            ended.wait(LONG)

    server = QtmServer(frames, XML.format(rate=200, up="+Y"), versions=("1.8", "1.13"))
    source = open_source(f"qtm://127.0.0.1:{server.port}")
    try:
        got = taken(source, 30)
        # QTM was asked for all frames and sends each second one: 100 per second, numbered without gaps.
        assert [frame.number for frame in got] == [*range(50, 65), *range(200, 215)]
        np.testing.assert_allclose(np.diff([frame.time for frame in got[:15]]), 0.02)
        np.testing.assert_allclose(got[0].points, [(0.1, 0.2, 0.9), (-0.4, 0.005, 1.2)], atol=1e-6)
        # Samples that came in a packet of their own are those of the next frame.
        assert [[part.first for part in frame.analog] for frame in got[:2]] == [[1000], [1020]]
        assert source.about.rate == 100.0 and source.about.vertical is not None
        assert source.about.vertical.tolist() == [0, 1, 0] and source.about.name == "QTM 2023.1 (build 9000) at 127.0.0.1"
        assert source.damaged == 2
        codes = {finding.code for finding in source.findings()}  # type: ignore[attr-defined]
        assert {"live-reconnected", "live-labels-given", "live-rate-divided"} <= codes and "live-axis-unknown" not in codes
        assert server.heard[:3] == ["version 1.20", "version 1.13", "qtmversion"]
    finally:
        ended.set()
        source.close()
        server.socket.close()
    assert not [thread for thread in threading.enumerate() if thread.name == "live qtm"]
    assert source.read(0.01) is None


def test_a_qtm_without_a_measurement_is_told_what_to_press_and_read_when_it_begins() -> None:
    pressed = threading.Event()

    def frames(components: str) -> Iterator[tuple[int, bytes]]:
        yield 4, b""
        pressed.wait(LONG)
        # Settings are there with the measurement, and asked for again.
        server.xml = XML.format(rate=50, up="-Z")
        # Nor timestamps, which some recordings lack.
        for number in range(1, 5):
            yield 3, data_packet(number, points_component(2, OTHERS), stamp=0)
        pressed.clear()
        pressed.wait(LONG)

    server = QtmServer(frames, "Parameters not available")
    source = open_source(f"qtm://127.0.0.1:{server.port}", 50.0)
    try:
        told = {finding.code: finding for finding in source.findings()}  # type: ignore[attr-defined]
        assert set(told) == {"live-idle"} and "Ctrl+N" in told["live-idle"].mend
        assert source.about.vertical is None and source.about.rate == 50.0
        pressed.set()
        got = taken(source, 4)
        np.testing.assert_allclose([frame.time for frame in got], [0.0, 0.02, 0.04, 0.06])
        codes = {finding.code for finding in source.findings()}  # type: ignore[attr-defined]
        assert "live-no-times" in codes and "live-idle" not in codes
        until = time.monotonic() + LONG
        while source.about.vertical is None and time.monotonic() < until:
            time.sleep(0.01)
        assert source.about.vertical is not None and source.about.vertical.tolist() == [0, 0, -1]
    finally:
        source.close()
        server.socket.close()
        pressed.set()


def test_a_qtm_that_says_nothing_any_more_is_connected_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """A cable that is out ends no connection: only asking shows it."""
    monkeypatch.setattr("asterism.live.qtm._QUIET", 0.1)
    monkeypatch.setattr("asterism.live.qtm._PATIENCE", 0.3)
    monkeypatch.setattr("asterism.live.qtm._AGAIN", 0.01)
    begin, ended = iter((1, 100)), threading.Event()

    def frames(components: str) -> Iterator[tuple[int, bytes]]:
        first = next(begin, None)
        if first is not None:
            for number in range(first, first + 3):
                yield 3, data_packet(number, points_component(2, OTHERS))
            server.mute = first == 1
        ended.wait(LONG)

    server = QtmServer(frames, XML.format(rate=100, up="+Z"))
    source = open_source(f"qtm://127.0.0.1:{server.port}")
    try:
        got = taken(source, 3)
        assert [frame.number for frame in (*got, *taken(source, 3))] == [1, 2, 3, 100, 101, 102]
        assert "live-reconnected" in {finding.code for finding in source.findings()}  # type: ignore[attr-defined]
    finally:
        source.close()
        server.socket.close()
        ended.set()


def test_blobs_of_all_cameras_come_with_their_names() -> None:
    from asterism.live.qtm import QtmBlobs

    ended = threading.Event()

    def frames(components: str) -> Iterator[tuple[int, bytes]]:
        assert components == "2d"
        for number in (7, 8):
            yield 3, data_packet(number, blobs_component(7, [[(64, 64, 64, 64)], [(128, 0, 64, 64)] * 2]))
        ended.wait(LONG)

    server = QtmServer(frames, XML.format(rate=120, up="+Z"))
    source = QtmBlobs(HostPort("127.0.0.1", server.port))
    try:
        blobs = [source.read(10.0) for _ in range(4)]
        assert [(each.camera, each.number, len(each.xy)) for each in blobs if each is not None] == [
            ("21001", 7, 1),
            ("21002", 7, 2),
            ("21001", 8, 1),
            ("21002", 8, 2),
        ]
        assert source.cameras == ("21001", "21002") and source.rate == 120.0 and source.damaged == 0
    finally:
        ended.set()
        source.close()
        server.socket.close()


@pytest.mark.parametrize(
    "said", [b"\0\0\0\x23\0\0\0\1QTM RT Interface connected\0", b"HTTP/1.1 400 Bad Request\r\n\r\n", struct.pack("<II", 0, 2), b""]
)
def test_something_else_at_the_port_is_told(said: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("asterism.live.qtm._PATIENCE", 0.3)
    other = socket.create_server(("127.0.0.1", 0))
    kept = list[socket.socket]()

    def answer() -> None:
        client, _ = other.accept()
        kept.append(client)
        client.sendall(said)

    thread = threading.Thread(target=answer, daemon=True)
    thread.start()
    with pytest.raises(AsterismError, match="base port and 1"):
        open_source(f"qtm://127.0.0.1:{other.getsockname()[1]}")
    thread.join(10)
    for each in (*kept, other):
        each.close()
    assert not [thread for thread in threading.enumerate() if thread.name == "live qtm"]


def test_nobody_there_is_told_with_what_to_look_at() -> None:
    free = socket.create_server(("127.0.0.1", 0))
    port = free.getsockname()[1]
    free.close()
    with pytest.raises(AsterismError, match=r"does not answer.*Real-Time Output"):
        open_source(f"qtm://127.0.0.1:{port}")


def test_qtms_blobs_and_its_calibration_give_points_in_metres(tmp_path: Path) -> None:
    """The rig that QTM exports and the blobs that it streams fit together: the same names, pixels and lens."""
    written, marker = ring_rig(4), np.array([[0.1, -0.2, 1.1], [-0.3, 0.2, 0.8]])
    write_qualisys(tmp_path / "rig.qca.txt", written)
    rig = read_qualisys(tmp_path / "rig.qca.txt")
    serials = "".join(f"<Camera><ID>{n + 1}</ID><Serial>{name}</Serial></Camera>" for n, name in enumerate(rig.names))
    xml = f"<QTM_Parameters_Ver_1.20><General><Frequency>100</Frequency>{serials}</General></QTM_Parameters_Ver_1.20>"
    seen = [[(*(64 * blob).round().astype(int).tolist(), 256, 256) for blob in camera.project(marker)] for camera in written]

    def frames(components: str) -> Iterator[tuple[int, bytes]]:
        for number in range(1, 40):
            yield 3, data_packet(number, blobs_component(7, seen))
            time.sleep(0.01)

    server = QtmServer(frames, xml)
    source = RigSource(blobs_of(f"qtm://127.0.0.1:{server.port}", rig.names)(), rig)
    try:
        frame = next(frame for frame in taken(source, 20) if len(frame.points) == 2)
        np.testing.assert_allclose(frame.points[np.argsort(-frame.points[:, 0])], marker, atol=5e-4)
    finally:
        source.close()
        server.socket.close()
