"""Frames as JSON over WebSocket, both ways, against the package's own clients and servers over loopback sockets."""

from __future__ import annotations

import json
import socket
import threading

import numpy as np
import pytest
from waiting import LONG, until

from asterism import AsterismError
from asterism.live import (
    AnalysedFrame,
    FrameAnalysis,
    InOwnThread,
    LabelledFrame,
    LiveEvent,
    LiveFrame,
    SourceAbout,
    frame_as_json,
    frame_of_json,
    open_output,
    open_source,
)
from asterism.live.outputs import WAITING
from asterism.live.websocket import FromWebSocket, ToWebSocket

client = pytest.importorskip("websockets.sync.client", reason="websockets is not installed")
server = pytest.importorskip("websockets.sync.server")
exceptions = pytest.importorskip("websockets.exceptions")
ABOUT = SourceAbout("given", 100.0)


def frame(number: int, points: int = 2) -> LiveFrame:
    return LiveFrame(number, number / 100, 0.0, np.arange(3.0 * points).reshape(-1, 3))


def analysed(number: int, points: int = 2) -> AnalysedFrame:
    names = tuple(f"M{n}" for n in range(points))
    return AnalysedFrame(LabelledFrame(frame(number, points), names, np.arange(points), np.full(points, 0.9), 0.1))


def taken(source: FromWebSocket) -> LiveFrame:
    came: list[LiveFrame] = []

    def one() -> bool:
        read = source.read(0.05)
        came.extend([] if read is None else [read])
        return bool(came)

    until(one)
    return came[0]


def test_a_sender_that_comes_is_heard_and_a_second_one_is_sent_away() -> None:
    source = open_source("ws-listen://127.0.0.1:0", 100.0)
    assert isinstance(source, FromWebSocket)
    with client.connect(f"ws://127.0.0.1:{source.port}", proxy=None) as sender:
        sender.send(frame_as_json(frame(7)).decode())
        assert taken(source).number == 7
        sender.send(b"\xff\xfe nonsense")
        sender.send(frame_as_json(frame(8)))
        read = taken(source)
        assert read.number == 8 and read.points.tolist() == [[0, 1, 2], [3, 4, 5]] and source.damaged == 1
        with client.connect(f"ws://127.0.0.1:{source.port}", proxy=None) as other, pytest.raises(exceptions.ConnectionClosed, match="1013"):
            other.recv(LONG)
    assert [finding.code for finding in source.findings()] == ["live-refused", "live-format"]
    # The next one may come when the first is gone, and one that sends too much at once is cut off.
    until(lambda: source._endpoint.connected == 0)
    with client.connect(f"ws://127.0.0.1:{source.port}", proxy=None, max_size=None) as sender:
        sender.send(frame_as_json(frame(9)))
        assert taken(source).number == 9
        with pytest.raises(exceptions.ConnectionClosed, match="1009"):
            sender.send("[" * 300_000)
            sender.recv(LONG)
    source.close()
    assert source.read(0.0) is None
    assert not any("ws-listen" in thread.name for thread in threading.enumerate())


def test_frames_that_waited_too_long_here_were_not_lost_on_the_way() -> None:
    source = open_source("ws-listen://127.0.0.1:0", 100.0)
    assert isinstance(source, FromWebSocket)
    with client.connect(f"ws://127.0.0.1:{source.port}", proxy=None) as sender:
        for number in range(WAITING + 5):
            sender.send(frame_as_json(frame(number)))
        until(lambda: source.overflowed == 5)
        assert taken(source).number == 5
    (finding,) = source.findings()
    assert finding.code == "live-overflow" and "5 packets came while this machine was too busy" in finding.sentence
    source.close()


def test_pages_of_a_browser_may_not_come_unless_named() -> None:
    output = open_output("ws-listen://127.0.0.1:0?origin=http://stage.example&token=a+b", ABOUT)
    assert isinstance(output, ToWebSocket)
    for wrong in ("", "?token=", "?token=b", "?token=%ff"):
        with pytest.raises(exceptions.InvalidStatus, match="401"):
            client.connect(f"ws://127.0.0.1:{output.port}{wrong}", proxy=None).recv()
    with pytest.raises(exceptions.InvalidStatus, match="403"):
        client.connect(f"ws://127.0.0.1:{output.port}?token=a+b", origin="http://other.example", proxy=None).recv()
    with client.connect(f"ws://127.0.0.1:{output.port}?token=a+b", origin="http://stage.example", proxy=None) as page:
        until(lambda: output.receivers == 1)
        output.send(analysed(3))
        told = json.loads(page.recv(LONG))
    assert told["frame"] == 3 and told["names"] == ["M0", "M1"] and told["confidence"] == [0.9, 0.9]
    output.close()


def test_a_server_that_goes_and_comes_back_is_connected_to_again() -> None:
    came: list[LiveFrame] = []
    sent = threading.Event()

    def talk(link: object) -> None:
        link.send(frame_as_json(frame(len(came) + 5)))  # type: ignore[attr-defined]
        sent.wait(LONG)

    first = server.serve(talk, "127.0.0.1", 0)
    port = first.socket.getsockname()[1]
    thread = threading.Thread(target=first.serve_forever)
    thread.start()
    source = open_source(f"ws://127.0.0.1:{port}/frames")
    assert isinstance(source, FromWebSocket) and source.findings() == []
    came.append(taken(source))
    sent.set()
    first.shutdown()
    thread.join()
    second = server.serve(talk, "127.0.0.1", port)
    thread = threading.Thread(target=second.serve_forever)
    thread.start()
    came.append(taken(source))
    source.close()
    second.shutdown()
    thread.join()
    assert [each.number for each in came] == [5, 6]
    assert [(finding.code, "once" in finding.sentence) for finding in source.findings()] == [("live-reconnected", True)]


def test_a_receiver_that_sleeps_loses_frames_and_holds_nobody_back() -> None:
    output = open_output("ws-listen://127.0.0.1:0", ABOUT)
    assert isinstance(output, ToWebSocket)
    address = f"ws://127.0.0.1:{output.port}"
    with client.connect(address, proxy=None, max_queue=1, close_timeout=0.1) as sleeper, client.connect(address, proxy=None) as awake:
        until(lambda: output.receivers == 2)
        sleeper.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        got: list[int] = []
        for number in range(3000):
            output.send(analysed(number, 60))
            got.append(json.loads(awake.recv(LONG))["frame"])
            if output.dropped:
                break
        assert got == list(range(len(got))), "who keeps up gets each frame"
        assert output.dropped > 0 and len(output._receivers[0].waiting) <= 32
        # Nor does it hold back the end: it takes no goodbye.
        output.close()
        assert not output._endpoint._thread.is_alive()


def test_an_output_that_waits_for_ever_loses_frames_and_holds_nobody_back() -> None:
    begun, free = threading.Event(), threading.Event()

    class Stuck:
        name = "stuck"

        def __init__(self) -> None:
            self.got: list[int] = []

        def send(self, given: AnalysedFrame) -> None:
            begun.set()
            free.wait(LONG)
            self.got.append(given.labelled.frame.number)

        def close(self) -> None:
            self.got.append(-1)

    stuck = Stuck()
    output = InOwnThread(stuck)
    output.send(analysed(0))
    assert begun.wait(LONG)
    step = FrameAnalysis(events=(LiveEvent("heel strike", "left", 0.05, 0.01),))
    for number in range(1, 100):
        output.send(AnalysedFrame(analysed(number).labelled, step) if number == 5 else analysed(number))
    assert output.name == "stuck" and output.dropped == 67
    free.set()
    output.close()
    assert stuck.got == [0, 5, *range(69, 100), -1], "an event is not lost"
    assert output.dropped == 67


def test_frames_go_from_one_session_to_another() -> None:
    source = open_source("ws-listen://127.0.0.1:0")
    assert isinstance(source, FromWebSocket)
    output = open_output(f"ws://127.0.0.1:{source.port}", ABOUT)
    assert isinstance(output, ToWebSocket)
    until(lambda: output.receivers == 1)
    output.send(analysed(11))
    read = taken(source)
    assert (read.number, read.names) == (11, ("M0", "M1"))
    source.close()
    until(lambda: output.receivers == 0)
    output.send(analysed(12))
    assert output.dropped >= 1, "a frame for nobody is lost where somebody was named"
    output.close()


def test_nobody_there_is_told_at_once() -> None:
    with socket.socket() as deaf:
        # a port that is taken and does not listen
        deaf.bind(("127.0.0.1", 0))
        source = open_source(f"ws://name:secret@127.0.0.1:{deaf.getsockname()[1]}/x?token=secret")
        source.close()
    (finding,) = source.findings()  # type: ignore[attr-defined]
    assert finding.code == "live-unconnected" and "secret" not in str(finding)
    with pytest.raises(AsterismError, match="cannot be listened to"):
        open_source("ws-listen://192.0.2.1:8765")


@pytest.mark.parametrize("address", ["ws://", "ws-listen://127.0.0.1", "ws://127.0.0.1:99999", "wss://:8765"])
def test_an_address_that_is_none_says_what_one_is(address: str) -> None:
    for opened in (open_source, lambda given: open_output(given, ABOUT)):
        with pytest.raises(AsterismError, match=r"ws://192\.168\.1\.5:8765"):
            opened(address)


def test_a_message_of_the_most_points_is_believed() -> None:
    names = tuple("a name of twenty ch." for _ in range(2000))
    data = frame_as_json(LiveFrame(1, 1.0, 0.0, np.full((2000, 3), -123.456789), names))
    assert len(data) < 1 << 18 and frame_of_json(data, 0.0) is not None
