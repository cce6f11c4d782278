"""Frames as a NatNet server sends them, read by the package `natnet`, by our own source, and by what a real Motive sent."""

from __future__ import annotations

import os
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_live_natnet import captured
from waiting import LONG, until

from asterism import AsterismError
from asterism.live import AnalysedFrame, HostPort, LabelledFrame, LiveFrame, SourceAbout, open_output
from asterism.live.natnet import FromNatNet, server_of_packet
from asterism.live.natnet_server import ToNatNet

ABOUT = SourceAbout("given", 120.0, np.array([0.0, 1.0, 0.0]))
POINTS = np.array([[0.5, 1.5, -1.0], [0.25, 0.75, 2.0], [9.0, 8.0, 7.0]])


def frame(number: int) -> AnalysedFrame:
    """LASI is the second point, RASI is hidden, SACR the first; the third is nobody's."""
    labelled = LabelledFrame(
        LiveFrame(number, number / 120, time.monotonic(), POINTS), ("LASI", "RASI", "SACR"), np.array([1, -1, 0]), np.full(3, 0.9), 0.0
    )
    return AnalysedFrame(labelled)


@pytest.fixture
def single() -> Iterator[ToNatNet]:
    """A server that sends to each client alone."""
    output = open_output("natnet://127.0.0.1:0?unicast=1", ABOUT)
    assert isinstance(output, ToNatNet)
    yield output
    output.close()
    assert not output._thread.is_alive()


def check(came: object) -> None:
    (markers,) = came.marker_sets  # type: ignore[attr-defined]
    assert markers.model_name == "Asterism"
    np.testing.assert_array_equal(markers.marker_pos_list, [POINTS[1], [np.nan] * 3, POINTS[0]])
    assert came.unlabeled_marker_pos == (tuple(POINTS[2]),)  # type: ignore[attr-defined]
    listed = {each.marker_id: each for each in came.labeled_markers}  # type: ignore[attr-defined]
    assert {(number, each.model_id, each.unlabeled) for number, each in listed.items()} == {(1, 1, False), (3, 1, False), (50000, 0, True)}
    assert listed[3].pos == tuple(POINTS[0]) and not any(each.occluded for each in listed.values())


@pytest.mark.parametrize("multicast", [False, True], ids=["unicast", "multicast"])
def test_the_public_client_reads_names_and_places(multicast: bool) -> None:
    natnet = pytest.importorskip("natnet", reason="the package natnet is not installed")
    # Other processes of the tests have another port.
    group, data = "239.255.42.98", 20_000 + os.getpid() % 20_000
    output = open_output(f"natnet://127.0.0.1:0?{f'multicast={group}&data={data}' if multicast else 'unicast=1'}", ABOUT)
    assert isinstance(output, ToNatNet)
    client = natnet.NatNetClient("127.0.0.1", "127.0.0.1", group, output.port, data, multicast)
    frames, models = list[object](), list[object]()
    client.on_data_frame_received_event.handlers.append(frames.append)
    client.on_data_description_received_event.handlers.append(models.append)
    try:
        client.connect(LONG)
        assert client.server_info.application_name == "Asterism" and str(client.server_info.nat_net_protocol_version) == "3.1.0.0"
        number = 0

        def both() -> bool:
            nonlocal number
            number += 1
            output.send(frame(number))
            client.request_modeldef()
            client.update_sync()
            return len(frames) > 1 and any(model.marker_sets for model in models)  # type: ignore[attr-defined]

        if multicast:
            output.send(frame(0))
            limit = time.monotonic() + 2.0
            while not frames and time.monotonic() < limit:
                time.sleep(0.005)
                client.update_sync()
            if not frames:
                pytest.skip("this machine passes no multicast on over its loopback address")
        until(both)
    finally:
        client.shutdown()
        output.close()
    check(frames[-1])
    model = next(model for model in models if model.marker_sets)  # type: ignore[attr-defined]
    assert model.marker_sets[0].marker_names == ("LASI", "RASI", "SACR")  # type: ignore[attr-defined]
    suffix = frames[-1].suffix  # type: ignore[attr-defined]
    assert suffix.stamp_camera_mid_exposure <= suffix.stamp_data_received <= suffix.stamp_transmit
    assert [each.suffix.tracked_models_changed for each in frames[:2]] == [True, False]  # type: ignore[attr-defined]


_OTHER_CLIENT = """
import sys, motioncapture
client = motioncapture.connect("optitrack", {"hostname": "127.0.0.1", "interface_ip": "127.0.0.1", "port_command": sys.argv[1]})
for _ in range(20):
    client.waitForNextFrame()
print("20 frames", len(client.rigidBodies))
"""


def test_a_client_in_another_language_follows_the_group() -> None:
    pytest.importorskip("motioncapture", reason="the package motioncapture is not installed")
    output = open_output(f"natnet://127.0.0.1:0?multicast=239.255.42.97&data={20_000 + os.getpid() % 20_000}", ABOUT)
    assert isinstance(output, ToNatNet)
    # It holds the interpreter while it waits, so that it needs one of its own.
    client = subprocess.Popen([sys.executable, "-c", _OTHER_CLIENT, str(output.port)], stdout=subprocess.PIPE, text=True)
    number = 0

    def ended() -> bool:
        nonlocal number
        number += 1
        output.send(frame(number))
        # Frames that came in vain: this machine passes no multicast on over its loopback address.
        return client.poll() is not None or number > 5000

    try:
        until(ended)
        if client.poll() is None:
            pytest.skip("this machine passes no multicast on over its loopback address")
        assert client.communicate(timeout=LONG)[0] == "20 frames 0\n"
    finally:
        client.kill()
        client.communicate()
        output.close()


def test_our_own_source_reads_it_and_goodbye_ends_it(single: ToNatNet) -> None:
    source = FromNatNet(HostPort("127.0.0.1", single.port), rate=120.0)
    single.send(frame(41))
    read = source.read(LONG)
    assert read is not None and read.number == 41 and read.time == pytest.approx(41 / 120)
    assert {tuple(point) for point in read.points} == {tuple(point) for point in POINTS}
    source.close()


def asked(server: ToNatNet, kind: int, content: bytes = b"") -> bytes:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
        client.settimeout(LONG)
        client.sendto(struct.pack("<HH", kind, len(content)) + content, ("127.0.0.1", server.port))
        return client.recv(65_536)


def test_questions_are_answered_as_the_vendors_client_asks_them(single: ToNatNet) -> None:
    assert asked(single, 4) == struct.pack("<HHi", 5, 4, 0), "no model before there are markers"
    single.send(frame(1))
    assert asked(single, 6)[:8] == struct.pack("<HH", 7, len(asked(single, 6)) - 4) + struct.pack("<i", 1)
    assert asked(single, 2, b"FrameRate\0") == struct.pack("<HHf", 3, 4, 120.0)
    assert asked(single, 2, b"UnitsToMillimeters\0") == struct.pack("<HHf", 3, 4, 1000.0)
    assert asked(single, 2, b"UpAxis\0") == struct.pack("<HHi", 3, 4, 1)
    assert asked(single, 2, b"StartRecording\0")[:2] == struct.pack("<H", 100)
    echo = asked(single, 12, struct.pack("<Q", 77))
    assert echo[:12] == struct.pack("<HHQ", 13, 16, 77)
    assert abs(struct.unpack("<Q", echo[12:])[0] - time.monotonic_ns()) < 1e9 * LONG


@pytest.fixture(scope="module")
def server() -> Iterator[ToNatNet]:
    output = ToNatNet("natnet://127.0.0.1:0?unicast=1", ABOUT)
    yield output
    output.close()


@given(st.binary(max_size=40), st.integers(1, 9999))
def test_noise_is_answered_by_a_greeting_at_most_and_fills_no_memory(server: ToNatNet, data: bytes, port: int) -> None:
    assert len(server.answer(data, ("127.0.0.1", port))) <= 300
    server.answer(struct.pack("<HH", 0, 0), ("127.0.0.1", port))
    assert len(server._clients) <= 16 and (not server.findings() or server.findings()[0].code == "live-refused")


def test_a_client_that_says_nothing_more_is_forgotten(single: ToNatNet, monkeypatch: pytest.MonkeyPatch) -> None:
    asked(single, 0, b"Ping\0")
    assert len(single._clients) == 1
    monkeypatch.setattr("asterism.live.natnet_server._GONE", -1.0)
    single.send(frame(1))
    assert not single._clients


@pytest.mark.parametrize("address", ["natnet://", "natnet://127.0.0.1?multicast=10.0.0.1", "natnet://127.0.0.1?data=0"])
def test_an_address_that_is_none_says_what_one_is(address: str) -> None:
    with pytest.raises(AsterismError, match=r"natnet://192\.168\.1\.20"):
        open_output(address, ABOUT)


def test_a_port_that_motive_has_is_told(single: ToNatNet) -> None:
    with pytest.raises(AsterismError, match="as Motive does"):
        open_output(f"natnet://127.0.0.1:{single.port}", ABOUT)


def test_a_real_motive_greets_with_as_many_bytes(data: Path, single: ToNatNet) -> None:
    folder = data / "live" / "natnet"
    if not folder.is_dir():
        pytest.skip("there is no capture of Motive in ASTERISM_DATA")
    real = next(each for each in captured(folder / "traffic.pcapng") if server_of_packet(each) is not None)
    own = asked(single, 0, b"Ping\0")
    assert len(own) == len(real) and own[:4] == real[:4]
