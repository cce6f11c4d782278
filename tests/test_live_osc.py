"""Labelled frames to Open Sound Control, read by python-osc's own server over a loopback socket."""

from __future__ import annotations

import math
import sys
import threading
from collections.abc import Iterator

import numpy as np
import pytest

from asterism import AsterismError
from asterism.live import (
    AnalysedFrame,
    Cue,
    FeedbackRule,
    FrameAnalysis,
    HostPort,
    LabelledFrame,
    LiveEvent,
    LiveFrame,
    SourceAbout,
    open_output,
    open_outputs,
)
from asterism.live.osc import ToOsc

server_of = pytest.importorskip("pythonosc.osc_server", reason="python-osc is not installed").BlockingOSCUDPServer
dispatcher = pytest.importorskip("pythonosc.dispatcher")
ABOUT = SourceAbout("given", 100.0)


def labelled(number: int, at: float, markers: int, hidden: tuple[int, ...] = ()) -> LabelledFrame:
    indices = np.array([-1 if n in hidden else n for n in range(markers)])
    points = np.arange(3.0 * markers).reshape(-1, 3) / 64
    return LabelledFrame(
        LiveFrame(number, at, 1.0, points), tuple(f"M{n}" for n in range(markers)), indices, np.full(markers, 0.75), done=1.001
    )


class Artist:
    """What arrives, message by message."""

    def __init__(self) -> None:
        known = dispatcher.Dispatcher()
        known.set_default_handler(lambda address, *numbers: self.came.append((address, numbers)))
        self.came: list[tuple[str, tuple[float, ...]]] = []
        self.server = server_of(("127.0.0.1", 0), known)
        self.server.timeout = 10.0
        self.port = self.server.server_address[1]

    def take(self, until: str) -> list[tuple[str, tuple[float, ...]]]:
        """All messages up to one of that address."""
        limit = threading.Event()
        timer = threading.Timer(30.0, limit.set)
        timer.start()
        while not any(address == until for address, _ in self.came) and not limit.is_set():
            self.server.handle_request()
        timer.cancel()
        came, self.came = self.came, []
        return came


@pytest.fixture
def artist() -> Iterator[Artist]:
    made = Artist()
    yield made
    made.server.server_close()


def test_markers_values_events_and_cues_arrive_by_their_names(artist: Artist) -> None:
    rule = FeedbackRule("squat depth", "height", ("M0",), below=0.4, sound="tone")
    output = open_output(f"osc://127.0.0.1:{artist.port}", ABOUT)
    output.send(AnalysedFrame(labelled(7, 5000.5, 3)))
    analysis = FrameAnalysis(
        {"left knee flexion": 61.5, "right knee flexion": math.nan, "odd": 1e300, "left/knee#flexion": 2.0},
        {},
        (LiveEvent("heel strike", "left", 5000.75, 0.04),),
    )
    output.send(AnalysedFrame(labelled(8, 5001.0, 3, hidden=(1,)), analysis, (Cue(rule, math.nan, True, True, math.nan),)))
    output.close()
    came = artist.take("/asterism/cue/squat_depth/began")
    assert came[0] == ("/asterism/frame", (7, 0.0)), "times begin with 0, which 32 bits hold well"
    assert came[2] == ("/asterism/marker/M1", (3 / 64, 4 / 64, 5 / 64, 0.75))
    second = dict(came[4:])
    assert second["/asterism/frame"] == (8, 0.5)
    assert "/asterism/marker/M1" not in second and second["/asterism/marker/M2"][0] == 6 / 64
    assert second["/asterism/value/left_knee_flexion"] == (61.5,)
    assert second["/asterism/value/left_knee_flexion_2"] == (2.0,), "two names never share an address"
    assert "/asterism/value/right_knee_flexion" not in second and "/asterism/value/odd" not in second
    assert second["/asterism/event/heel_strike/left"] == pytest.approx((0.25, 0.04))
    assert second["/asterism/cue/squat_depth"] == (1, -1.0) and "/asterism/cue/squat_depth/value" not in second


def test_no_datagram_is_larger_than_networks_take_and_each_says_its_frame(artist: Artist) -> None:
    output = ToOsc(HostPort("127.0.0.1", artist.port))
    frame = AnalysedFrame(labelled(2**32 - 5, 0.0, 200))
    bundles = list(output.bundles(frame))
    assert len(bundles) > 5 and max(map(len, bundles)) <= 1400
    output.send(frame)
    output.close()
    came = artist.take("/asterism/marker/M199")
    assert [numbers for address, numbers in came if address == "/asterism/frame"] == [(2**31 - 5, 0.0)] * len(bundles)
    assert sum(address.startswith("/asterism/marker/") for address, _ in came) == 200


@pytest.mark.parametrize("at", [1e300, -1e300])
def test_a_time_that_32_bits_do_not_hold_ends_no_session(artist: Artist, at: float) -> None:
    output = ToOsc(HostPort("127.0.0.1", artist.port))
    event = LiveEvent("heel strike", "left", at, 0.04)
    for frame in (labelled(0, 0.0, 1), labelled(1, at, 1)):
        output.send(AnalysedFrame(frame, FrameAnalysis(events=(event,))))
    output.send(AnalysedFrame(labelled(2, 0.5, 2)))
    output.close()
    came = artist.take("/asterism/marker/M1")
    assert dict(came)["/asterism/frame"] == (2, 0.5) and [numbers[0] for name, numbers in came if "frame" in name] == [0, 1, 2]


@pytest.mark.parametrize(
    "address", ["osc://127.0.0.1", "osc:9000", "http://127.0.0.1:5000", "osc://127.0.0.1:99999", "osc://127.0.0.1:0", "natnet"]
)
def test_an_address_that_is_none_leaves_no_output_open(address: str) -> None:
    with pytest.raises(AsterismError, match=r"osc://127\.0\.0\.1:9000|begins with"):
        open_outputs(["udp://127.0.0.1:5001", address], ABOUT)


@pytest.mark.parametrize(
    ("address", "package"), [("osc://127.0.0.1:9000", "pythonosc"), ("lsl://Test", "pylsl"), ("ws-listen://127.0.0.1:0", "websockets")]
)
def test_a_package_that_is_missing_is_named_with_what_to_install(address: str, package: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.partition(".")[0] == package]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(AsterismError, match=rf'needs {package}, which is not installed; .*pip install "asterism\[live\]"'):
        open_output(address, ABOUT)
