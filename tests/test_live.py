"""Frames that come in one after the other: counted, labelled, passed on and recorded, whatever the sender, the network or a kill does."""

from __future__ import annotations

import errno
import gc
import io
import json
import math
import shlex
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from models import trained
from waiting import LONG, until

import asterism
from asterism import AsterismError
from asterism.cameras.files import write_rig
from asterism.cli import _console, main
from asterism.cli._live_options import LiveOptions
from asterism.cli._live_recordings import leave_recorded, write_recorded
from asterism.cli._live_sessions import ended_by_signals, run_session
from asterism.cli.live import _run
from asterism.files.journal import Journal
from asterism.findings import Finding, Severity
from asterism.formats import analog_channels
from asterism.labelling.live.stream import FrameLabels
from asterism.labelling.live.study_process import make_studies
from asterism.live import (
    AnalysedFrame,
    FrameAnalysis,
    FrameCount,
    Health,
    HostPort,
    JsonDatagrams,
    LabelledFrame,
    LiveFrame,
    LiveRecorder,
    LiveSession,
    SourceAbout,
    SourceClock,
    SourceEnded,
    ToDatagrams,
    ToLines,
    frame_as_json,
    frame_of_json,
    make_labeller,
    open_source,
    recording_of,
    session_findings,
)
from asterism.live import recording as live_recording
from asterism.live.analog import AnalogDevice, AnalogSamples
from asterism.live.chain import LabelChain, Labeller
from asterism.live.clock import StreamTimes
from asterism.live.datagrams import DatagramReader, socket_for
from asterism.live.pauses import short_pauses
from asterism.live.replay import Replay
from asterism.recording import MarkerSet, Recording
from asterism.recording.rates import TO_RATE
from asterism.simulation import simulate_walks
from asterism.simulation.cameras import ring_rig

RATE = 100.0


class Numbers(Labeller):
    """Labels point i as marker i, and keeps what it was given."""

    marker_set = MarkerSet(("A", "B"))

    def __init__(self, seconds: float = 0.0, delay: int = 0) -> None:
        self.pushed: list[int] = []
        self.seconds, self.delay = seconds, delay

    def push(self, points: object) -> FrameLabels | None:
        time.sleep(self.seconds)
        self.pushed.append(len(np.asarray(points)))
        at = len(self.pushed) - 1 - self.delay
        return None if at < 0 else self.labels(at)

    def flush(self) -> list[FrameLabels]:
        return [self.labels(at) for at in range(max(0, len(self.pushed) - self.delay), len(self.pushed))]

    def labels(self, at: int) -> FrameLabels:
        count = self.pushed[at]
        return FrameLabels(at, np.array([0 if count > 0 else -1, 1 if count > 1 else -1]), np.array([0.99, 0.98]))


class Given:
    """A source of the frames given, as fast as they are taken."""

    damaged = 0

    def __init__(self, frames: list[LiveFrame], rate: float = RATE) -> None:
        self.about = SourceAbout("given", rate)
        self._left = iter(frames)
        self.closed = False

    def read(self, timeout: float) -> LiveFrame | None:
        for frame in self._left:
            return frame
        raise SourceEnded

    def close(self) -> None:
        self.closed = True


class Kept:
    def __init__(self) -> None:
        self.frames: list[LabelledFrame] = []

    def send(self, frame: AnalysedFrame) -> None:
        self.frames.append(frame.labelled)

    def close(self) -> None:
        pass


def frames(numbers: list[int], points: int = 2) -> list[LiveFrame]:
    return [LiveFrame(n, n / RATE, 50.0 + n / RATE, np.arange(3.0 * points).reshape(-1, 3) + n) for n in numbers]


def test_frames_that_came_while_the_labelling_was_made_are_told_and_not_labelled_late(monkeypatch: pytest.MonkeyPatch) -> None:
    # whatever a busy machine does, no read of a list counts as waiting
    monkeypatch.setattr("asterism.live.running._AT_ONCE", 60.0)

    def slowly(rate: float, up: object) -> Numbers:
        time.sleep(0.2)
        return Numbers()

    health = LiveSession(Given(frames(list(range(5000)))), slowly, [Kept()]).run()
    # as many as can have come in this time, and twice as many at most
    assert health.before >= 2 * 0.2 * RATE and health.before + health.frames == 5000 and health.lost == 0
    assert "live-before" in {finding.code for finding in session_findings(health, "given")}


def test_who_stops_while_the_labelling_is_made_is_told_that_and_of_no_firewall() -> None:
    def make(rate: float, up: object) -> Numbers:
        session.stop()
        return Numbers()

    session = LiveSession(Given(frames([])), make, [Kept()])
    (told,) = session_findings(session.run(), "given")
    assert told.code == "live-ended" and "labelling was made" in told.mend


def test_a_clock_that_drifts_is_followed_and_one_that_is_set_is_begun_anew() -> None:
    clock, rng = SourceClock(), np.random.default_rng(0)
    # 100 ppm faster than ours, each frame up to 4 ms late
    delays = [
        clock.lateness(t * 1.0001, t + 1000.0 + late) for t, late in zip(np.arange(0, 60, 0.01), rng.uniform(0, 0.004, 6000), strict=True)
    ]
    assert clock.jumps == 0 and max(delays[500:]) < 0.006
    assert clock.lateness(3600.0, 1060.01) == 0.0, "an hour ahead: nothing is known of the new clock"
    assert clock.jumps == 1
    assert clock.lateness(3600.01, 1060.05) == pytest.approx(0.03)


@pytest.mark.parametrize("rate", [RATE, math.nan], ids=["rate known", "by arrival"])
@pytest.mark.parametrize(("tick", "frames_per_second"), [(0.0156, 100.0), (0.0156, 200.0), (1.0, 100.0)])
def test_times_of_a_coarse_clock_go_on_in_steps_of_a_frame(rate: float, tick: float, frames_per_second: float) -> None:
    times = StreamTimes(frames_per_second if rate > 0 else rate)
    true = 1.7e9 + np.arange(1500) / frames_per_second
    told = np.array([times.of(n, float(at // tick * tick), float(at) - 1.7e9) for n, at in enumerate(true)])
    steps = np.diff(told)[5:] * frames_per_second
    assert times.made and steps.min() > 0.94 and steps.max() < 1.06
    assert np.abs(told - true).max() < tick + 0.001


def test_times_that_move_are_those_of_the_sender_and_a_clock_that_is_set_is_followed() -> None:
    times = StreamTimes(RATE)
    assert [times.of(n, at, 0.0) for n, at in ((0, 5.0), (1, 5.01), (1, 5.01), (3, 5.03), (2, 5.02), (4, 5.04))] == [
        5.0,
        5.01,
        5.01,
        5.03,
        5.02,
        5.04,
    ]
    assert not times.made
    assert times.of(5, 5.04, 0.0) == pytest.approx(5.05) and times.of(4, 5.04, 0.0) == pytest.approx(5.04) and times.made
    assert times.of(6, 3605.0, 0.0) == 3605.0 and times.of(0, 7.0, 0.0) == 7.0, "set by an hour; begun anew"


def test_frames_that_come_together_show_how_many_came() -> None:
    session = LiveSession(Given(frames([0, 1])), lambda rate, up: Numbers(), waits=True)
    session._arrivals.extend([time.monotonic() - 0.2] * 90)
    assert session.health().arriving == 90.0


def test_a_name_with_two_addresses_means_the_one_of_four_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    found = [
        (socket.AF_INET6, socket.SOCK_DGRAM, 17, "", ("::1", 5000, 0, 0)),
        (socket.AF_INET, socket.SOCK_DGRAM, 17, "", ("127.0.0.1", 5000)),
    ]
    monkeypatch.setattr("socket.getaddrinfo", lambda *_, **__: found)
    made, address = socket_for(HostPort("localhost", 5000), "udp://127.0.0.1:5000")
    made.close()
    assert made.family == socket.AF_INET and address == ("127.0.0.1", 5000)


@given(st.lists(st.integers(0, 40), max_size=60))
def test_every_number_is_received_lost_or_late(numbers: list[int]) -> None:
    count = FrameCount()
    taken = [number for number in numbers if count.takes(number)]
    assert count.received + count.late == len(numbers)
    if not count.restarts:
        assert taken == sorted(set(taken))
        came = {number for number in numbers if taken and taken[0] <= number <= taken[-1]}
        assert count.lost == (0 if not taken else taken[-1] - taken[0] + 1 - len(came)), "what came late is not lost, too"
    restarts = count.restarts
    assert count.takes(5_000_000) and count.restarts == restarts + (1 if numbers else 0), "numbers that begin anew are no loss"


@pytest.mark.parametrize("before", [3, 60, 5000])
def test_a_sender_that_is_started_again_is_taken_at_once(before: int) -> None:
    count = FrameCount()
    taken = [number for number in [*range(before), *range(100)] if count.takes(number)]
    assert taken[-90:] == list(range(10, 100)), "a few frames at most are held for late ones"
    assert count.restarts == 1 or before < 5
    assert count.lost == 0


@pytest.mark.parametrize("apart", [1500, -1500, 4500, 200_000, -200_000])
def test_two_senders_behind_one_address_lose_nothing_and_are_told(apart: int) -> None:
    """Frame by frame in turns, then the first one ends."""
    first, second = list(range(300_000, 300_200)), list(range(300_000 + apart, 300_210 + apart))
    numbers = [*first[:50], *(number for pair in zip(second, first[50:], strict=False) for number in pair), *second[150:]]
    kept, sent = Kept(), [replace(frame, arrived=0.005 * k) for k, frame in enumerate(frames(numbers))]
    health = LiveSession(Given(sent), lambda rate, up: Numbers(), [kept], waits=True).run()
    # The first of the second sender, before anything showed that there are two; four are held back until the second is alone.
    taken = [found.frame.number for found in kept.frames]
    assert taken == [*first[:50], second[0], *first[50:], *second[154:]]
    assert (health.lost, health.late, health.restarts, health.others) == (0, 0, 1, 154)
    (told,) = [finding for finding in session_findings(health, "x") if finding.code == "live-other-sender"]
    assert "154 frames" in told.sentence


def test_what_a_source_says_came_before_is_passed_over_however_long_it_takes_to_read(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("asterism.live.running._AT_ONCE", -1.0)
    sent = [replace(frame, arrived=time.monotonic() + (60.0 if frame.number >= 7 else -3.0)) for frame in frames(list(range(10)))]
    session = LiveSession(Given(sent), lambda rate, up: Numbers())
    session._rate = RATE
    session._pass_over(1.0)
    waiting = session._next()
    assert session._health.before == 7 and waiting is not None and waiting.number == 7


def test_frames_that_waited_too_long_are_left_out_while_newer_ones_wait() -> None:
    now = time.monotonic()
    session = LiveSession(Given([]), lambda rate, up: Numbers())
    session._rate, session._chain = RATE, LabelChain(Numbers(), RATE)
    for frame, arrived in zip(frames(list(range(6))), [now - 3.0, now - 2.0, now + 60.0, now + 60.0, now - 2.0, now - 1.0], strict=True):
        session._take(replace(frame, arrived=arrived))
    taken = [frame.number for _ in range(3) if (frame := session._next())]
    assert taken == [2, 3, 5] and session._health.dropped == 3, "the newest is never left out"
    # At the end all that wait are labelled.
    for frame in frames([6, 7]):
        session._take(replace(frame, arrived=now - 2.0))
    session.stop()
    taken = [frame.number for _ in range(2) if (frame := session._next())]
    assert taken == [6, 7] and session._health.dropped == 3


class Stamping:
    """A socket whose datagrams came at times (s on the wall clock, or None where that is not said)."""

    def __init__(self, came: list[float | None]) -> None:
        self._came = iter(came)

    def setsockopt(self, *_: object) -> None:
        pass

    def recvmsg(self, *_: object) -> tuple[bytes, list[tuple[int, int, bytes]], int, str]:
        came = next(self._came)
        notes = [] if came is None else [(socket.SOL_SOCKET, 35, struct.pack("@ll", int(came), round(1e9 * (came % 1.0))))]
        return b"data", [(socket.SOL_SOCKET, 1, b"x"), *notes], 0, "sender"


def test_a_datagram_that_waited_is_as_old_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """Or as old as the one before, or new, where the wall clock was set meanwhile."""
    now, wall = 100.0, 5000.0
    monkeypatch.setattr("asterism.live.datagrams.sys.platform", "linux")
    monkeypatch.setattr("asterism.live.datagrams.time.monotonic", lambda: now)
    monkeypatch.setattr("asterism.live.datagrams.time.time_ns", lambda: round(wall * 1e9))
    reader = DatagramReader(Stamping([5001.5, 5002.25, None, 5019.0, 8600.0, 1400.0, 8629.5]))  # type: ignore[arg-type]
    now, wall = 110.0, 5010.0
    assert [reader.read()[2] for _ in range(2)] == pytest.approx([101.5, 102.25])
    assert reader.read()[2] == now, "a datagram without a stamp is new"
    now, wall = 120.0, 5020.0
    assert reader.read()[2] == pytest.approx(119.0)
    # The clock was set back by an hour while one waited that came at its old time: it is no newer than now.
    assert reader.read()[2] == now
    now, wall = 130.0, 8630.0
    # And on: it is no older than the one before.
    assert reader.read()[2] == 120.0
    assert reader.read()[2] == pytest.approx(129.5)


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux says how many datagrams it left out")
def test_frames_that_this_machine_was_too_busy_to_read_are_not_lost_on_the_way() -> None:
    source = JsonDatagrams(HostPort("127.0.0.1", 0), RATE)
    source._socket._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 8192)
    session = LiveSession(source, lambda rate, up: Numbers())
    sent = [frame_as_json(frame) for frame in frames([*range(300), 302])]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for data in sent[:300]:
            sender.sendto(data, ("127.0.0.1", source.port))
        received = 0
        # The room of those that are read is for the last one, behind two that were lost on the way.
        while (frame := source.read(0.0)) is not None:
            session._take(frame)
            received += 1
        sender.sendto(sent[300], ("127.0.0.1", source.port))
        while (frame := source.read(30.0)) is not None:
            session._take(frame)
            if frame.number == 302:
                break
            received += 1
    assert frame is not None, "the last one came"
    (told,) = [finding for finding in source.findings() if finding.code == "live-overflow"]
    assert source.overflowed == 300 - received > 0 and f"{300 - received} packets" in told.sentence
    assert session.health().lost == 2
    # What was left out before its first frame takes no loss from a session.
    later = LiveSession(source, lambda rate, up: Numbers())
    for frame in frames([303, 306]):
        later._take(frame)
    assert later.health().lost == 2
    source.close()


def test_the_system_says_when_a_datagram_came() -> None:
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listening,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
    ):
        listening.bind(("127.0.0.1", 0))
        opened, reader = time.monotonic(), DatagramReader(listening)
        sender.sendto(b"one", listening.getsockname())
        data, address, arrived = reader.read()
        assert (data, address) == (b"one", ("127.0.0.1", sender.getsockname()[1])) and opened <= arrived <= time.monotonic()


def test_a_sender_that_begins_anew_after_a_silence_loses_no_frame() -> None:
    count, kept = FrameCount(), Kept()
    assert [count.takes(number) for number in (0, 1, 2, 0)] == [True, True, True, False]
    assert count.takes(0, silent=True) and count.restarts == 1
    again = [replace(frame, arrived=frame.arrived + 5.0) for frame in frames(list(range(20)))]
    health = LiveSession(Given([*frames(list(range(30))), *again]), lambda rate, up: Numbers(), [kept], waits=True).run()
    assert (health.labelled, health.late, health.lost, health.restarts) == (50, 0, 0, 1)


@given(
    st.lists(st.tuples(*[st.floats(-50, 50)] * 3), max_size=5),
    st.integers(-(2**53), 2**53),
    st.floats(-1e9, 1e9),
)
def test_a_frame_goes_through_a_datagram(points: list[tuple[float, float, float]], number: int, at: float) -> None:
    frame = LiveFrame(number, at, 1.0, np.array(points).reshape(-1, 3), tuple("LASI" for _ in points))
    read = frame_of_json(frame_as_json(frame), 1.0)
    assert read is not None
    assert (read.number, read.time, read.names) == (number, at, frame.names)
    np.testing.assert_allclose(read.points, frame.points, atol=5.1e-7)


GOOD = b'{"frame":3,"time":0.5,"unit":"mm","points":[[1000,0,500],[null,0,0],[NaN,1,2],[1e300,0,0]],"names":["a","b","c","d"]}'


def test_units_are_converted_and_missing_points_left_out() -> None:
    frame = frame_of_json(GOOD, 2.0)
    assert frame is not None
    assert frame.points.tolist() == [[1.0, 0.0, 0.5]] and frame.names == ("a",)


@settings(max_examples=300)
@given(st.data())
def test_damaged_datagrams_give_a_frame_or_none(data: st.DataObject) -> None:
    damaged = bytearray(GOOD)
    for _ in range(data.draw(st.integers(1, 6))):
        at = data.draw(st.integers(0, len(damaged) - 1))
        damaged[at : at + data.draw(st.integers(0, 4))] = data.draw(st.binary(max_size=4))
        if not damaged:
            break
    frame = frame_of_json(bytes(damaged), 0.0)
    assert frame is None or (np.isfinite(frame.points).all() and math.isfinite(frame.time) and len(frame.names) in (0, len(frame.points)))


@pytest.mark.parametrize(
    "data",
    [b"", b"[", b"[]", b"7", b"[" * 50_000, b'{"frame":1}', b'{"frame":true,"time":0,"points":[]}',
     b'{"frame":1,"time":0,"points":[[1,2]]}',
     b'{"frame":1,"time":1e999,"points":[]}',
     b'{"frame":1,"time":0,"points":[[1,2,3]],"names":["a","b"]}',
     b'{"frame":1,"time":0,"unit":"feet","points":[]}', b'{"frame":1,"time":0,"points":{"a":[1,2,3]}}'],
)  # fmt: skip
def test_what_is_no_frame_is_none(data: bytes) -> None:
    assert frame_of_json(data, 0.0) is None


def test_lost_frames_are_empty_pushes_and_never_answers() -> None:
    labeller = Numbers(delay=2)
    chain = LabelChain(labeller, RATE, delay=2)
    found = [chain.push(frame) for frame in frames([0, 1, 4, 5, 6])]
    assert labeller.pushed == [2, 2, 0, 0, 2, 2, 2]
    # frame 4 asks for frame 2, which was lost
    assert [None if each is None else each.frame.number for each in found] == [None, None, None, None, 4]
    chain.push(frames([400])[0])
    assert len(labeller.pushed) == 8, "after a long silence the stream goes on at once"
    assert [each.frame.number for each in chain.flush()] == [6, 400], "those that wait at the end have labels, too"


@pytest.mark.parametrize("rate", [RATE, math.nan])
def test_all_frames_are_labelled_in_their_order_and_counted(rate: float) -> None:
    numbers = [n for n in range(120) if n not in (40, 41)]
    source, kept = Given(frames([*numbers[:60], 30, *numbers[60:]]), rate), Kept()
    health = LiveSession(source, lambda rate, up: Numbers(), [kept], waits=True).run()
    assert [each.frame.number for each in kept.frames] == numbers
    assert (health.frames, health.lost, health.late, health.labelled, health.dropped) == (118, 2, 1, 118, 0)
    assert source.closed
    assert kept.frames[0].names == ("A", "B")


def test_a_labeller_that_is_too_slow_leaves_old_frames_out_and_tells() -> None:
    kept = Kept()
    sent = [replace(frame, arrived=frame.arrived + time.monotonic()) for frame in frames(list(range(400)))]
    health = LiveSession(Given(sent), lambda rate, up: Numbers(seconds=0.002), [kept]).run()
    numbers = [each.frame.number for each in kept.frames]
    assert numbers == sorted(numbers) and numbers[-1] == 399, "the newest frame is labelled"
    assert health.dropped > 0 and health.labelled + health.dropped == health.frames == 400


def test_an_output_or_a_source_that_fails_ends_nothing_else() -> None:
    class Full(Kept):
        def send(self, frame: AnalysedFrame) -> None:
            raise OSError("buffer full")

    class Broken(Given):
        def read(self, timeout: float) -> LiveFrame | None:
            try:
                return super().read(timeout)
            except SourceEnded:
                raise RuntimeError("cable out") from None

    kept = Kept()
    health = LiveSession(Broken(frames([0, 1, 2])), lambda rate, up: Numbers(), [Full(), kept], waits=True).run()
    assert len(kept.frames) == 3 and health.unsent == {"Full": 3}
    assert "cable out" in health.problem


def test_a_session_ends_after_its_seconds_which_begin_when_it_can_label() -> None:
    def slow(rate: float, up: object) -> Numbers:
        time.sleep(0.3)
        return Numbers(seconds=0.001)

    endless = Given(frames(list(range(100_000))))
    health = LiveSession(endless, slow, waits=True).run(0.2)
    assert 0 < health.labelled < 1000 and health.frames == health.labelled


@pytest.mark.parametrize(
    ("rate", "stamp", "enough"),
    [
        (5.0, lambda at: at, 5),
        (5.0, lambda at: math.floor(1000 * at) / 1000, 5),
        (120.0, lambda at: math.floor(1000 * at) / 1000, 30),
        (100.0, lambda at: math.floor(at / 0.0156) * 0.0156, 30),
        (50.0, lambda at: at + (at > 0.1), 30),
    ],
    ids=["slow", "milliseconds", "120 Hz in milliseconds", "clock of Windows", "clock set"],
)
def test_the_rate_is_found_as_soon_as_the_times_tell_it(rate: float, stamp: Callable[[float], float], enough: int) -> None:
    """The source ends when its frames are labelled: who needs more of them waits in vain."""
    kept, found, sought = Kept(), list[float](), list[bool]()

    class Waiting(Given):
        def read(self, timeout: float) -> LiveFrame | None:
            sought.append(session.pending.startswith("its rate is sought"))
            try:
                return super().read(timeout)
            except SourceEnded:
                if len(kept.frames) == enough:
                    raise
                time.sleep(0.001)
                return None

    def made(rate: float, up: object) -> Numbers:
        found.append(rate)
        return Numbers()

    came = [LiveFrame(n, stamp(n / rate), 50.0 + n / rate, np.zeros((1, 3))) for n in range(enough)]
    source = Waiting(came, math.nan)
    session = LiveSession(source, made, [kept])
    health = session.run(30.0)
    assert sought[:3] == [False, True, True], "it can be told while the rate is sought"
    assert health.labelled == enough and not session.pending
    assert found == [pytest.approx(rate, rel=0.01)]


def test_frames_that_waited_while_the_set_was_sought_say_nothing_of_the_latency() -> None:
    """Angles are made when the set is known, which may take seconds: until then ten frames wait, and one is to join them."""

    class Coming(Given):
        given = 0

        def read(self, timeout: float) -> LiveFrame | None:
            if self.given == 2:
                until(lambda: slow.held)
            frame = super().read(timeout)
            self.given += 1
            return None if frame is None else replace(frame, arrived=time.monotonic())

    class Seeking(Numbers):
        marker_set: MarkerSet | None = None

        def push(self, points: object) -> FrameLabels | None:
            self.marker_set = MarkerSet(("A", "B")) if self.pushed else None
            return super().push(points)

    class Slow:
        def push(self, found: LabelledFrame) -> FrameAnalysis:
            if found.markers and not self.held:
                self.held.append(found.frame.number)
                until(lambda: source.given == 2 + 10 + 1)
            return FrameAnalysis()

        def findings(self) -> list[Finding]:
            return []

        def __init__(self) -> None:
            self.held: list[int] = []

    source, slow = Coming(frames(list(range(60)))), Slow()
    session = LiveSession(source, lambda rate, up: Seeking(), waits=True, analysis=slow)
    assert session.run().labelled == 60
    assert len(session._latencies) == 60 - 13


def test_times_that_do_not_grow_need_a_rate() -> None:
    still = [LiveFrame(n, 0.0, 0.0, np.zeros((1, 3))) for n in range(40)]
    with pytest.raises(AsterismError, match="say its rate with --rate"):
        LiveSession(Given(still, math.nan), lambda rate, up: Numbers(), waits=True).run()


def test_numbers_that_stand_still_are_no_wrong_times() -> None:
    """Only frames after a silence are taken then, one a second."""
    still = [LiveFrame(0, n / RATE, n / RATE, np.zeros((1, 3))) for n in range(800)]
    with pytest.raises(AsterismError, match="given: most of its frames have the number of an earlier one; number each frame one higher"):
        LiveSession(Given(still, math.nan), lambda rate, up: Numbers(), waits=True).run()


def test_numbers_that_stand_still_and_times_that_do_not_go_as_a_clock_are_told_while_they_come() -> None:
    for numbers, times, code in (([0] * 40, np.arange(40.0) / RATE, "live-late"), (range(40), 10.0 * np.arange(40.0), "live-times")):
        session = LiveSession(Given([]), lambda rate, up: Numbers())
        session._rate = RATE
        for count, (number, at) in enumerate(zip(numbers, times, strict=True), start=1):
            session._take(LiveFrame(number, at, count / RATE, np.zeros((1, 3))))
            assert [finding.code for finding in session.findings()] == ([code] if count >= TO_RATE else [])
        health = session.health()
        assert [finding.code for finding in session_findings(health, "given", parts=[session])].count(code) == 1


def test_what_came_before_a_session_failed_is_kept_and_said(tmp_path: Path, capsys) -> None:
    still = [LiveFrame(n, 0.0, float(n), np.zeros((1, 3))) for n in range(40)]
    options, kept = LiveOptions(output=tmp_path / "x.c3d"), tmp_path / "x.c3d.live"
    for came in (still, []):
        with suppress(AsterismError):
            _run(LiveSession(Given(came, math.nan), lambda rate, up: Numbers(), waits=True), options, kept)
        assert kept.exists() == ("--finish" in capsys.readouterr().err) == bool(came)
        kept.unlink(missing_ok=True)


def test_a_signal_while_the_recording_is_written_breaks_nothing_off(tmp_path: Path, monkeypatch, capsys) -> None:
    def written(*args: Any) -> None:
        for number in ("SIGTERM", "SIGINT", "SIGHUP"):
            if hasattr(signal, number):
                signal.raise_signal(getattr(signal, number))
        write_recorded(*args)

    session = LiveSession(Given(frames([0, 1, 2])), lambda rate, up: Numbers(), waits=True)
    monkeypatch.setattr("asterism.cli.live.write_recorded", written)
    with ended_by_signals(session):
        _run(session, LiveOptions(output=tmp_path / "x.c3d"), tmp_path / "x.c3d.live")
    assert [path.name for path in tmp_path.iterdir()] == ["x.c3d"]
    assert signal.getsignal(signal.SIGTERM) == signal.SIG_DFL


def test_what_nobody_can_read_ends_no_session(monkeypatch: pytest.MonkeyPatch) -> None:
    class Gone(io.StringIO):
        def write(self, text: str) -> int:
            raise BrokenPipeError

    monkeypatch.setattr("sys.stderr", Gone())
    _console.notice("the disk is full")


def test_the_line_on_a_terminal_is_gone_before_results_are_printed(monkeypatch: pytest.MonkeyPatch) -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    terminal, out = Terminal(), sys.stdout
    monkeypatch.setattr("sys.stderr", terminal)

    class Session(LiveSession):
        def run(self, seconds: float = math.inf) -> Health:
            until(lambda: sys.stderr is not terminal)
            assert sys.stdout is out, "what is piped on is never led to the terminal"
            return self.health()

    run_session(Session(Given([]), lambda rate, up: Numbers()), LiveOptions())
    assert sys.stderr is terminal and "live terminal" not in {thread.name for thread in threading.enumerate()}


def test_a_session_is_over_when_who_reads_its_lines_is_gone() -> None:
    class Gone(io.StringIO):
        def write(self, text: str) -> int:
            raise BrokenPipeError(errno.EPIPE, "Broken pipe")

    endless = Given(frames(list(range(20_000))))
    lines = ToLines(Gone())
    session = LiveSession(endless, lambda rate, up: Numbers(), [lines], waits=True)
    lines.on_left = session.stop
    health = session.run()
    assert health.labelled < 100 and health.unsent == {}, "they want no more"
    # Where others get the frames the session goes on.
    health = LiveSession(Given(frames(list(range(20)))), lambda rate, up: Numbers(), [ToLines(Gone())], waits=True).run()
    assert health.labelled == 20 and health.unsent == {"--lines": 20}


def test_times_in_milliseconds_are_told() -> None:
    came = [LiveFrame(n, 10.0 * n, n / RATE, np.zeros((1, 3))) for n in range(40)]
    with pytest.raises(AsterismError, match=r"grow by 10 from frame to frame, and are read as seconds; send seconds\.$"):
        LiveSession(Given(came, math.nan), lambda rate, up: Numbers()).run()
    health = LiveSession(Given(came), lambda rate, up: Numbers()).run()
    assert "live-times" in {finding.code for finding in session_findings(health, "there")}


def test_numbers_that_stand_still_are_told() -> None:
    health = LiveSession(Given(frames([7] * 10)), lambda rate, up: Numbers()).run()
    (finding,) = [finding for finding in session_findings(health, "there") if finding.code == "live-late"]
    assert finding.severity == Severity.WARNING and "one higher" in finding.mend
    assert not {"live-restarted", "live-no-labels"} & {finding.code for finding in session_findings(health, "there")}


def test_datagrams_go_in_labelled_and_out() -> None:
    came = JsonDatagrams(HostPort("127.0.0.1", 0), RATE)
    sink = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sink.bind(("127.0.0.1", 0))
    sink.settimeout(LONG)
    session = LiveSession(came, lambda rate, up: Numbers(), [ToDatagrams(HostPort("127.0.0.1", sink.getsockname()[1]))])
    running = threading.Thread(target=session.run)
    running.start()
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    answers = []
    for n, data in enumerate([b"nonsense", *(frame_as_json(frame) for frame in frames([7, 8, 9]))]):
        sender.sendto(data, ("127.0.0.1", came.port))
        if n:
            answers.append(json.loads(sink.recv(65_536)))
    session.stop()
    running.join(timeout=LONG)
    sender.close()
    sink.close()
    assert [answer["frame"] for answer in answers] == [7, 8, 9]
    assert answers[0]["names"] == ["A", "B"] and answers[0]["confidence"] == [0.99, 0.98]
    assert session.health().damaged == 1 and not running.is_alive()


@pytest.mark.parametrize("address", ["udp://127.0.0.1", "udp://:5000", "udp://127.0.0.1:99999", "walk.c3d", "http://127.0.0.1:5000"])
def test_an_address_that_is_none_says_what_one_is(address: str) -> None:
    with pytest.raises(AsterismError, match=r"udp://127\.0\.0\.1:5000|begins with"):
        open_source(address)


@pytest.mark.parametrize(
    ("changed", "why"),
    [
        ({"time": "0.1"}, '"time" is no number'),
        ({"frame": 1.5}, '"frame"'),
        ({"unit": "inch"}, "unit"),
        ({"points": {"LASI": [1, 2, 3]}}, "points"),
        ({"points": [[True, 1, 2]]}, "points"),
        ({"points": [[900, 1, 2], [1300, 1, 0], [2, 3, 1100]]}, "unit"),
        ({"names": "LASI"}, "names"),
    ],
)
def test_a_sender_is_told_what_is_wrong_with_its_frames(changed: dict[str, object], why: str) -> None:
    whole = {"frame": 1, "time": 0.1, "points": [[1, 2, 3]]}
    source = JsonDatagrams(HostPort("127.0.0.1", 0), RATE)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for content in ({**whole, **changed}, whole):
            sender.sendto(json.dumps(content).encode(), ("127.0.0.1", source.port))
        assert source.read(10.0) is not None and source.damaged == 1
        (finding,) = source.findings()
    source.close()
    assert finding.code == "live-format" and why in finding.sentence
    assert source.unread == (type({**whole, **changed}["frame"]) is int)


def test_frames_that_could_not_be_read_were_not_lost_on_the_way() -> None:
    came = Given(frames([0, 1, 4, 7]))
    came.damaged, came.unread = 3, 2  # type: ignore[attr-defined]
    health = LiveSession(came, lambda rate, up: Numbers()).run()
    assert (health.damaged, health.lost) == (3, 2), "four numbers are missing, two of them came; the third was no frame"


def test_a_session_says_that_it_gave_no_labels() -> None:
    class Unsure(Numbers):
        def labels(self, at: int) -> FrameLabels:
            return FrameLabels(at, np.full(2, -1), np.zeros(2))

    class Unknown(Unsure):
        marker_set = None

    def found(labeller: Numbers, points: int = 2) -> list[str]:
        frames = [LiveFrame(at, at / RATE, time.monotonic(), np.ones((points, 3))) for at in range(10)]
        session = LiveSession(Given(frames), lambda *_: labeller)
        return [finding.sentence for finding in session_findings(session.run(), "there") if finding.code == "live-no-labels"]

    assert not found(Numbers())
    assert "10 of 10" in found(Unsure())[0]
    assert "no marker set was found" in found(Unknown())[0]
    assert "no frame had a point" in found(Numbers(), 0)[0]


def test_a_port_that_is_taken_is_told() -> None:
    first = JsonDatagrams(HostPort("127.0.0.1", 0))
    with pytest.raises(AsterismError, match="cannot be listened to"):
        JsonDatagrams(HostPort("127.0.0.1", first.port))
    first.close()


def recorded(path: Path, numbers: list[int], *, together: int = 1) -> LiveRecorder:
    """A recording of frames of these numbers, of which so many arrive at the same time."""
    recorder, chain = LiveRecorder(path, "given", None), LabelChain(Numbers(), RATE)
    for n, frame in enumerate(replace(frame, arrived=50.0 + n // together / RATE) for n, frame in enumerate(frames(numbers))):
        recorder.frame(frame)
        found = chain.push(frame)
        assert found is not None
        recorder.labelled(found)
        if n % 20 == 19:
            recorder._flush()
    recorder.close()
    return recorder


def test_a_recording_holds_all_frames_with_their_labels(tmp_path: Path) -> None:
    numbers = [n for n in range(100, 200) if n != 150]
    assert recorded(tmp_path / "walk.live", numbers).kept == 99
    kept = recording_of(tmp_path / "walk.live")
    recording = kept.recording()
    assert len(recording) == 100 and recording.rate == pytest.approx(RATE) and recording.labels == ("A", "B")
    assert np.isnan(recording.positions[50]).all(), "the lost frame is an empty one"
    np.testing.assert_array_equal(recording.positions[51:, 0], np.array([f.points[0] for f in frames(numbers)])[50:])
    with pytest.raises(AsterismError, match="exists"):
        LiveRecorder(tmp_path / "walk.live", "given", None)


def test_labels_stay_with_their_frames_where_numbers_begin_anew(tmp_path: Path) -> None:
    recorded(tmp_path / "walk.live", [*range(30), *range(20)])
    kept = recording_of(tmp_path / "walk.live")
    assert len(kept.clouds) == 50 and kept.labelling is not None
    assert (kept.labelling.indices == [0, 1]).all(), "all frames have their own labels"


def test_frames_that_arrive_at_the_same_time_have_their_own_labels(tmp_path: Path) -> None:
    """As all frames of 15 ms do where the system's clock counts in such steps, and those of one packet."""
    recorded(tmp_path / "walk.live", list(range(30)), together=3)
    kept = recording_of(tmp_path / "walk.live")
    assert kept.labelling is not None and (kept.labelling.indices == [0, 1]).all()


def test_a_recording_that_was_cut_anywhere_keeps_what_was_written_before(tmp_path: Path) -> None:
    recorded(tmp_path / "whole.live", list(range(100)))
    whole = (tmp_path / "whole.live").read_bytes()
    before = 0
    # In the name of the file's kind, in the heads of steps, in their arrays, and between them.
    for end in [0, 5, 17, 30, 49, 52, 60, *np.linspace(100, len(whole), 30).astype(int)]:
        cut = tmp_path / "cut.live"
        cut.write_bytes(whole[:end])
        try:
            kept = len(recording_of(cut).clouds)
        except AsterismError as problem:
            assert "holds no frame" in str(problem) or "no live recording" in str(problem)
            kept = 0
        assert kept >= before and kept % 20 == 0
        assert cut.read_bytes() == whole[:end], "what is read is not changed"
        before = kept
    assert before == 100


def test_a_disk_that_fails_ends_the_recording_and_not_the_session(tmp_path: Path) -> None:
    told = list[str]()
    recorder = LiveRecorder(tmp_path / "walk.live", "given", None, told.append)
    recorder.frame(frames([0])[0])
    recorder._flush()

    class FullDisk:
        def write(self, data: bytes) -> int:
            raise OSError(errno.ENOSPC, "No space left on device")

        def close(self) -> None:
            # a buffer is written first
            raise OSError(errno.ENOSPC, "No space left on device")

    assert recorder._journal._stream is not None
    recorder._journal._stream.close()
    recorder._journal._stream = FullDisk()
    for frame in frames([1, 2]):
        recorder.frame(frame)
    recorder._flush()
    recorder.frame(frames([3])[0])
    recorder.close()
    assert "recording ended" in recorder.problem and recorder.kept == 1
    assert told == [recorder.problem], "it is said while the session goes on, once"
    assert len(recording_of(tmp_path / "walk.live").clouds) == 1


@pytest.mark.skipif(sys.platform == "win32", reason="Windows removes no file that is open")
@pytest.mark.parametrize("at_the_end", [False, True])
def test_a_recording_that_is_removed_while_it_is_written_is_not_said_to_be_there(tmp_path: Path, at_the_end: bool) -> None:
    told = list[str]()
    recorder = LiveRecorder(tmp_path / "walk.live", "given", None, told.append)
    first, last = frames([0, 1])
    recorder.frame(first)
    recorder._flush()
    if at_the_end:
        # Nothing is written any more.
        recorder._thread.close()
    recorder.path.unlink()
    if not at_the_end:
        recorder.frame(last)
        recorder._flush()
        assert len(told) == 1, "it is told at once"
    recorder.close()
    assert told == [recorder.problem] and "removed or moved" in recorder.problem and recorder.kept == 0
    (finding,) = [each for each in session_findings(Health(labelled=2, shown=2), "given", recorder) if each.code == "live-not-recorded"]
    assert finding.mend.startswith("Leave walk.live and its folder in their place until the session ends")
    # What was moved away and back is somebody's.
    recorder.path.write_bytes(b"frames")
    write_recorded(recorder, tmp_path / "walk.c3d", None)
    leave_recorded(recorder, tmp_path / "walk.c3d")
    assert recorder.path.exists()


def test_a_network_that_does_not_answer_for_a_moment_ends_no_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recorder = LiveRecorder(tmp_path / "walk.live", "given", None)
    with monkeypatch.context() as patched:
        patched.setattr(Path, "stat", lambda *_, **__: (_ for _ in ()).throw(OSError(errno.EIO, "Input/output error")))
        recorder.frame(frames([0])[0])
        recorder._flush()
    recorder.close()
    assert recorder.problem == "" and recorder.kept == 1


def test_how_an_unfinished_recording_is_written_can_be_copied_into_a_terminal(tmp_path: Path, capsys) -> None:
    output = tmp_path / "left and right.c3d"
    recorder = LiveRecorder(tmp_path / "left and right.c3d.live", "given", None)
    recorder.frame(frames([0])[0])
    recorder.close()
    leave_recorded(recorder, output)
    said = capsys.readouterr().err.replace("\n", " ")
    words = shlex.split(said[said.index("asterism live") : said.index(" writes it")])
    assert words == ["asterism", "live", "--finish", str(recorder.path), "-o", str(output)]


def test_labels_that_a_busy_disk_leaves_out_are_counted_and_told(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(live_recording, "_MOST", 2)
    monkeypatch.setattr(live_recording, "WritingThread", lambda *_: SimpleNamespace(close=lambda: None))
    recorder, chain = LiveRecorder(tmp_path / "walk.live", "given", None), LabelChain(Numbers(), RATE)
    for frame in frames(range(5)):
        recorder.frame(frame)
        labelled = chain.push(frame)
        assert labelled is not None
        recorder.labelled(labelled)
    recorder.close()
    assert (recorder.lost, recorder.unlabelled) == (3, 3)
    finding = next(each for each in session_findings(Health(labelled=5, shown=5), "given", recorder) if each.code == "live-not-recorded")
    assert "3 frames and the labels of 3 frames not recorded, since the disk was busy" in finding.sentence


@pytest.fixture(scope="module")
def walks() -> list[Recording]:
    return simulate_walks(subjects=6, frames=200, seed=11)


@pytest.fixture(scope="module")
def model(walks: list[Recording]) -> asterism.MarkerModel:
    return trained(walks[:5], miner=None, subjects=list("abcde"))


def test_played_frames_have_the_labels_of_the_stream(tmp_path: Path, walks: list[Recording], model: asterism.MarkerModel) -> None:
    path, kept = tmp_path / "walk.c3d", Kept()
    asterism.write(path, walks[5].frames(slice(60)))
    source = Replay(path, speed=1000.0)
    # A body that is played faster is labelled as it moved.
    assert source.about.rate == RATE
    health = LiveSession(source, make_labeller(model, None, 5, "push"), [kept], 5, waits=True).run()
    assert health.labelled == 60 and health.dropped == 0 and health.jumps == 0
    clouds, stream = asterism.read(path).clouds(), model.stream(RATE, 5, studies=make_studies("push", RATE, model))
    expected = [*[labels for points in clouds if (labels := stream.push(points)) is not None], *stream.flush()]
    for got, want in zip(kept.frames, expected, strict=True):
        assert got.frame.number == want.frame
        np.testing.assert_array_equal(got.indices, want.indices)


def test_the_command_records_what_it_plays(tmp_path: Path, walks: list[Recording], model: asterism.MarkerModel, capsys) -> None:
    asterism.write(tmp_path / "walk.c3d", walks[5].frames(slice(60)))
    model.save(tmp_path / "walkers.model")
    words = ["live", "--replay", str(tmp_path / "walk.c3d"), "--model", str(tmp_path / "walkers.model"), "--speed", "inf"]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sink:
        sink.bind(("127.0.0.1", 0))
        sink.settimeout(10)
        to = ["--to", f"udp://127.0.0.1:{sink.getsockname()[1]}", "--to", "natnet://127.0.0.1:0?unicast=1"]
        assert main([*words, "-o", str(tmp_path / "out.c3d"), "--json", "-", *to]) == 0
        assert json.loads(sink.recv(65_536))["frame"] == 0
    assert main([*words, "--to", "smoke://127.0.0.1:1"]) == 2
    told = json.loads(capsys.readouterr().out)
    assert told["frames"] == told["labelled"] == 60 and told["lost"] == told["dropped"] == 0
    written = asterism.read(tmp_path / "out.c3d")
    assert len(written) == 60 and set(walks[5].labels) <= set(written.labels)
    assert not (tmp_path / "out.c3d.live").exists()


@pytest.mark.usefixtures("without_studies")
def test_what_a_killed_session_left_is_written_once_and_is_then_in_nobodys_way(tmp_path: Path, capsys) -> None:
    output, left = tmp_path / "next.c3d", tmp_path / "next.c3d.live"
    begin = ["live", "udp://127.0.0.1:0", "--rate", "100", "--markers", "helen-hayes", "--seconds", "0.1", "-o", str(output)]
    write = ["live", "--finish", str(left), "-o", str(output), "--json", "-"]
    assert main(write) == 2 and "next.c3d.live does not exist" in capsys.readouterr().err
    recorded(left, list(range(40)))
    assert main(begin) == 2 and f"--finish {left}" in capsys.readouterr().err and left.exists()
    # A session that still runs writes to it: what there is can be written, and the file stays.
    running = Journal(left, "asterism live 1")
    assert main(begin) == 2 and "now" in capsys.readouterr().err
    assert main(write) == 0 and left.exists()
    assert [finding["code"] for finding in json.loads(capsys.readouterr().out)["findings"]] == ["live-not-finished"]
    running.close()
    assert main(write) == 2 and "--overwrite" in capsys.readouterr().err and left.exists(), "the recording is there"
    assert main([*write, "--overwrite"]) == 0
    assert json.loads(capsys.readouterr().out)["frames"] == len(asterism.read(output)) == 40 and not left.exists()
    # Bytes that cannot be read are kept under another name.
    for name in ("next.c3d.live.damaged", "next.c3d.live.damaged1"):
        recorded(left, list(range(40)))
        left.write_bytes(left.read_bytes()[:-9])
        assert main([*write, "--overwrite"]) == 1 and "live-cut-off" in capsys.readouterr().out
        assert len(asterism.read(output)) == 20 and not left.exists() and (tmp_path / name).exists()
    output.unlink()
    # A session that was killed before its first frame keeps nobody from the next.
    recorded(left, [])
    assert main(begin) == 1 and not left.exists()


def test_analog_channels_are_in_the_recording_where_their_rates_are_whole_multiples(tmp_path: Path, capsys) -> None:
    """Ten samples of one device and five of another in each frame, of which one are lost; 3.3 of a third; a fourth with another clock."""
    numbers = [n for n in range(100, 200) if n != 150]
    devices = [AnalogDevice("EMG", 1000.0, ("soleus", ""), ("V", "V")), AnalogDevice("plate", 500.0, ("soleus",), ("N",))]
    devices += [AnalogDevice("odd", 330.0, ("a",), ("V",)), AnalogDevice("away", 1000.0, ("b",), ("V",))]
    recorder, left, output = (
        LiveRecorder(tmp_path / "walk.c3d.live", "QTM", None, rate=RATE),
        tmp_path / "walk.c3d.live",
        tmp_path / "walk.c3d",
    )

    def samples(device: AnalogDevice, number: int) -> AnalogSamples:
        first, end = (round(at * device.rate / RATE) for at in (number, number + 1))
        first, end = (first + 10**6, end + 10**6) if device.name == "away" else (first, end)
        return AnalogSamples(device, first, np.add.outer(np.arange(first, end), 0.5 * np.arange(len(device.channels))))

    for n, frame in zip(numbers, frames(numbers), strict=True):
        recorder.frame(replace(frame, analog=tuple(samples(device, n) for device in devices)))
    recorder.close()
    assert main(["live", "--finish", str(left), "-o", str(output)]) == 0
    told = capsys.readouterr().err
    for why in ("odd: its 330 Hz", "away: its samples are not numbered", "EMG: 10 samples of 1,000 were lost", "plate: 5 samples of 500"):
        assert why in told
    assert (tmp_path / "walk.analog.npz").exists()
    emg, second, plate = analog_channels(asterism.read(output))
    assert [(each.name, each.unit, each.rate) for each in (emg, second, plate)] == [
        ("soleus", "V", 1000.0),
        ("EMG 2", "V", 1000.0),
        ("plate soleus", "N", 1000.0),
    ]
    expected = np.where(np.arange(1000) // 10 == 50, 0.0, np.arange(1000, 2000))
    np.testing.assert_array_equal(emg.samples, expected)
    np.testing.assert_array_equal(second.samples, np.where(expected > 0, expected + 0.5, 0.0))
    np.testing.assert_array_equal(plate.samples, np.repeat(np.where(np.arange(500) // 5 == 50, 0.0, np.arange(500, 1000)), 2))
    ezc3d = pytest.importorskip("ezc3d")
    theirs = ezc3d.c3d(str(output))
    np.testing.assert_array_equal(theirs["data"]["analogs"][0], np.stack([emg.samples, second.samples, plate.samples]))
    assert theirs["parameters"]["ANALOG"]["RATE"]["value"] == [1000.0] and theirs["data"]["points"].shape[2] == 100
    # Where nothing is left out, nothing is beside; a format without channels says so.
    (tmp_path / "walk.analog.npz").unlink()
    recorder = LiveRecorder(left, "QTM", None, rate=RATE)
    for n, frame in zip(range(40), frames(list(range(40))), strict=True):
        recorder.frame(replace(frame, analog=(samples(devices[0], n),)))
    recorder.close()
    assert main(["live", "--finish", str(left), "-o", str(output), "--overwrite"]) == 0 and not capsys.readouterr().err
    assert not (tmp_path / "walk.analog.npz").exists()


@pytest.mark.parametrize("words", [["udp://127.0.0.1:0"], ["--model", "gait.model"], ["--lines"], ["--lower-body", "plug-in-gait"]])
def test_what_begins_no_session_takes_no_options_of_one(tmp_path: Path, words: list[str], capsys) -> None:
    recorded(tmp_path / "walk.live", list(range(20)))
    assert main(["live", "--finish", str(tmp_path / "walk.live"), "-o", str(tmp_path / "walk.c3d"), *words]) == 2
    assert "begins none" in capsys.readouterr().err and not (tmp_path / "walk.c3d").exists()


@pytest.mark.usefixtures("without_studies")
def test_a_source_that_sends_nothing_is_told(tmp_path: Path, capsys) -> None:
    assert (
        main(["live", "udp://127.0.0.1:0", "--rate", "100", "--markers", "helen-hayes", "--seconds", "0.1", "-o", str(tmp_path / "x.c3d")])
        == 1
    )
    assert "live-silent" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
    words = ["live", "udp://127.0.0.1:0", "--markers", "helen-hayes", "--seconds", "0.1", "-o", str(tmp_path / "x.c3d"), "--json", "-"]
    assert main(words) == 1
    content = json.loads(capsys.readouterr().out)
    assert content["output"] is None and content["rate"] is None and content["arriving"] == 0, "nothing came, and no rate is known"
    assert main(["live"]) == 2 and "give one source" in capsys.readouterr().err


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=["Ctrl-C", "SIGTERM"])
def test_a_signal_ends_a_session_with_all_that_came(
    tmp_path: Path, walks: list[Recording], model: asterism.MarkerModel, number: signal.Signals
) -> None:
    asterism.write(tmp_path / "walk.c3d", walks[5].frames(slice(60)))
    model.save(tmp_path / "walkers.model")
    words = ["--replay", "walk.c3d", "--loop", "--model", "walkers.model", "--lines", "-o", "out.c3d", "--json", "out.json"]
    # Where the tests themselves run in the background, their children would ignore Ctrl-C.
    program = "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); from asterism.cli import main; "
    if number == signal.SIGTERM:
        # See `without_studies`: Ctrl-C ends a session that has a process of studies.
        program += "from asterism.live import chain; chain.make_studies = lambda place, rate, model: None; "
    program += "sys.exit(main())"
    process = subprocess.Popen([sys.executable, "-c", program, "live", *words], stdout=subprocess.PIPE, text=True, cwd=tmp_path)
    try:
        assert process.stdout is not None
        for line in process.stdout:
            if '"frame":70' in line:
                process.send_signal(number)
                process.send_signal(number)
                break
        process.communicate(timeout=60)
        assert process.returncode == 0
    finally:
        process.kill()
        process.communicate()
    told = json.loads((tmp_path / "out.json").read_text())
    assert told["frames"] == told["labelled"] >= 71
    assert len(asterism.read(tmp_path / "out.c3d")) == told["frames"]
    assert not (tmp_path / "out.c3d.live").exists()


def test_a_format_that_cannot_be_written_is_refused_before_a_session_begins(tmp_path: Path, capsys) -> None:
    assert main(["live", "udp://127.0.0.1:0", "--rate", "100", "-o", str(tmp_path / "x.txt")]) == 2
    assert "no format has the suffix .txt" in capsys.readouterr().err and not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["udp://127.0.0.1:0", "-o", "."], "suffix"),
        (["udp://127.0.0.1:0", "--rate", "0"], "no rate"),
        (["udp://127.0.0.1:0", "--host", "0.0.0.0"], "--page"),
        (["udp://127.0.0.1:0", "--replay", "walk.c3d"], "two sources"),
        (["--replay", "walk.c3d", "--rate", "50"], "--speed"),
        (["udp://127.0.0.1:0", "--speed", "2"], "its own time"),
        (["udp://127.0.0.1:0", "--loop"], "its own time"),
        (["--replay", "walk.c3d", "--empty", "2"], "--empty is of images"),
        (["--replay", "walk.c3d", "--no-analysis", "--hip", "bell"], "--no-analysis leaves out"),
        (["--replay", "blobs.csv"], "add --rig FILE"),
        (["--replay", "walk.trc", "walk.c3d"], "one recording is played at a time"),
        (["--replay", "video.avi"], "videos of the other cameras"),
        (["--replay", "walk.trc", "--rig", "rig.toml"], "leave --rig out"),
        (["udp://127.0.0.1:0?together=1"], "add --rig FILE"),
        (["udp://127.0.0.1:0/points"], "points means nothing behind"),
        (["natnet://127.0.0.1?lokal=127.0.0.1"], "lokal means nothing there; choose from local"),
        (["qtm://127.0.0.1?udp=1"], "no options"),
        (["vicon://127.0.0.1?udp=1"], "no options"),
        (["lsl://?colour=red"], "choose from host, name, source_id, type, uid"),
        (["ws-listen://127.0.0.1:0?tokn=SECRET"], "choose from origin, token"),
        (["udp://127.0.0.1:0?togeter=1", "--rig", "rig.toml"], "choose from together"),
        (["udp://127.0.0.1:0?together=maybe", "--rig", "rig.toml"], "neither 1 nor 0"),
        (["natnet://127.0.0.1", "--rig", "rig.toml"], "leave --rig out"),
        *(
            (["--replay", "walk.trc", "--markers", "helen-hayes", "--to", address], told)
            for address, told in (
                ("udp://127.0.0.1:1?x=SECRET", "no options"),
                ("osc://127.0.0.1:1/joint", "joint means nothing"),
                ("lsl://A?x=1", "no options"),
                ("natnet://127.0.0.1?x=1", "choose from data, multicast, unicast"),
            )
        ),
    ],
)
def test_what_cannot_be_meant_is_refused(words: list[str], told: str, tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    write_rig(ring_rig(cameras=2, rng=np.random.default_rng(0)), Path("rig.toml"))
    Path("blobs.csv").write_text("frame,camera,x,y\n0,c1,1,2\n1,c1,1,2\n")
    Path("video.avi").write_bytes(b"RIFF")
    asterism.write("walk.trc", Recording(np.zeros((3, 1, 3)), ("A",), rate=RATE))
    assert main(["live", *words, "--seconds", "0.1"]) == 2
    said = capsys.readouterr().err
    assert told in said and "SECRET" not in said


@pytest.mark.parametrize("frozen", [False, True])
def test_a_session_leaves_python_as_it_was(frozen: bool) -> None:
    """Objects that were frozen before, as those of these tests are, stay so."""
    count, interval = gc.get_freeze_count(), sys.getswitchinterval()
    gc.unfreeze()
    if frozen:
        gc.freeze()
    try:
        with short_pauses():
            assert sys.getswitchinterval() < interval and gc.get_freeze_count()
        assert bool(gc.get_freeze_count()) == frozen and sys.getswitchinterval() == pytest.approx(interval)
    finally:
        if count:
            gc.freeze()
